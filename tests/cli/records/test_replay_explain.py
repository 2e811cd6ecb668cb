"""``mdm explain``: why a decision in a record was made."""

from __future__ import annotations

import msgspec
import pytest
from places import EXAMPLES

from mdm.explanation import Explanation
from mdm.recording import Record

TIGER = EXAMPLES / "tiger.toml"
PATROL = EXAMPLES / "patrol" / "patrol.toml"


@pytest.fixture
def record(mdm, tmp_path):
    """Run a file in virtual time, and return the record."""

    def run(file, epochs):
        path = tmp_path / "run.mcap"
        mdm("run", file, "--virtual", "--epochs", epochs, "--record", path)
        return path

    return run


def test_in_words(mdm, record):
    path = record(TIGER, 3)
    status, output, errors = mdm("explain", path)
    assert (status, errors) == (0, "")
    assert output[0] == "tiger at 1 s, because of: tick."
    assert output[1] == "Decision 2: 'listen', by alpha vectors."
    assert output[2] == "The most probable states were tiger-left (0.5), tiger-right (0.5)."
    assert mdm("explain", path, "--at", "1")[1][1].startswith("Decision 1:")
    assert mdm("explain", path, "--at", "0.6s", "--ensemble", "tiger")[1][0] == "tiger at 0.5 s, because of: tick."


def test_as_json(facts, record):
    found = facts("explain", record(TIGER, 2), "--at", "0")
    assert (found.pop("ensemble"), found.pop("time"), found.pop("cause")) == ("tiger", 0.0, "tick")
    assert msgspec.convert(found, Explanation).action_name == "listen"


def test_states_of_a_hierarchy(mdm, record):
    path = record(PATROL, 4)
    status, output, _ = mdm("explain", path, "--ensemble", "top/patrol")
    assert status == 0
    assert [line for line in output if line.startswith("The state was position=")]
    assert [line for line in output if line.startswith("The smallest change")]


def test_another_configuration_explains_what_it_would_decide(mdm, facts, record, tmp_path):
    path = record(TIGER, 2)
    other = tmp_path / "other.toml"
    text = TIGER.read_text().replace("drive = 2.0", "drive = 2.0\ndiscount = 0.5")
    for name in ("tiger.pomdp", "tiger.vf"):
        text = text.replace(f'"{name}"', f'"{EXAMPLES / name}"')
    other.write_text(text)
    status, output, errors = mdm("explain", path, "--config", other)
    assert (status, errors) == (0, "")
    assert output[1].startswith("By another configuration, as it would decide now (")
    told = facts("explain", path, "--config", other)
    assert (told["action_name"], told["decided"]) == ("listen", "listen")
    assert "configuration" not in facts("explain", path)


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (("--at", "9"), 1, "there is no decision 9; the last of an episode is 1"),
        (("--at", "soon"), 2, "a decision's number such as 12"),
        (("--at", "-3.0"), 2, "--at"),
        (("--at", "1e300"), 2, "a second such as 12.0 or 12s was expected, not '1e300'"),
        (("--at", "nan"), 2, "a second such as 12.0 or 12s was expected, not 'nan'"),
        (("--ensemble", "lion"), 1, "'lion' decided nothing; there is tiger"),
        (("--last", "0"), 2, "a whole number of 1 or more"),
    ],
)
def test_what_is_wrong_is_said(mdm, record, arguments, status, words):
    found, output, errors = mdm("explain", record(TIGER, 2), *arguments)
    assert (found, output) == (status, [])
    assert words in errors
    assert "Traceback" not in errors


def test_files_that_are_no_record(mdm, tmp_path):
    for path in (TIGER, tmp_path, tmp_path / "nothing.mcap"):
        status, output, errors = mdm("explain", path)
        assert (status, output) == (1, [])
        assert errors.startswith("mdm explain: ")


def test_a_decision_of_a_recorded_simulation_is_explained(mdm, tmp_path):
    model, policy, file = EXAMPLES / "tiger.pomdp", EXAMPLES / "tiger.vf", tmp_path / "run.mcap"
    mdm("simulate", "--model", model, "--policy", policy, "--episodes", "1", "--steps", "5", "--record", file)
    status, lines, _ = mdm("explain", file, "--at", "0")
    assert status == 0
    assert lines[1] == "Decision 0: 'listen', by alpha vectors."


def test_what_the_record_lacks_is_told_as_by_the_other_verbs(mdm, facts, record, tmp_path):
    path = record(TIGER, 12)
    path.write_bytes(path.read_bytes()[:-2000])
    (flaw,) = Record(path).flaws
    assert flaw.endswith(": what follows is not there")
    assert mdm("explain", path)[1][-1] == flaw
    assert facts("explain", path)["flaws"] == [flaw]
    assert mdm("plot", "run", path, "-o", tmp_path / "run.svg")[1] == [f"{tmp_path}/run.svg: drawn", flaw]
    assert mdm("record", "export", path, "-o", tmp_path / "run.csv")[1][-1] == flaw


def test_a_damaged_attached_file_is_named_before_and_after_repair(mdm, record, tmp_path):
    path = record(TIGER, 2)
    content = bytearray(path.read_bytes())
    content[content.index(b"tiger.vf", content.index(b"files/tiger.vf")) + 60] ^= 1
    path.write_bytes(content)
    damage = [
        line for line in mdm("record", "info", path)[1] if "the attached file 'files/tiger.vf' is damaged" in line
    ]
    assert damage
    whole = tmp_path / "whole.mcap"
    assert "the attached file 'files/tiger.vf' is damaged" in mdm("record", "repair", path, "-o", whole)[1][1]
    assert "complete                no" in mdm("record", "info", whole)[1]
    again = tmp_path / "again.mcap"
    output = mdm("record", "repair", whole, "-o", again)[1]
    assert output[1:] == [f"{whole}: the attached file 'files/tiger.vf' was damaged, and is not there"]
    for each in (path, whole, again):
        status, _, errors = mdm("explain", each)
        assert status == 1
        assert "the attached file 'tiger.vf' of the record is damaged: give the file of the run with --config" in errors
        assert mdm("explain", each, "--config", TIGER)[0] == 0
