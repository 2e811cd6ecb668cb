"""`mdm check` of a TOML file: what is allowed, and hardly meant."""

from __future__ import annotations

import re

import pytest
from places import EXAMPLES

FILE = """
[predicates]
A = {{}}
B = {{}}
C = {{}}
{predicates}

[ensembles.robot]
policy = [0, 1]
[ensembles.robot.states]
s = {factor}
[ensembles.robot.actions]
Go = {go}
Stop = "builtins:print"

[ensembles.other]
policy = [0, 0, 0]
[ensembles.other.states]
t = ["A", "B", "C"]
[ensembles.other.actions]
Rest = {rest}
"""
USED = 'X = "A and B and C"'


def notes(mdm, path, *, factor='["A", "B"]', predicates="", go='"builtins:print"', rest='"builtins:print"', text=None):
    """Return the notes on a file; there are no problems."""
    path.write_text(text or FILE.format(factor=factor, predicates=predicates, go=go, rest=rest), encoding="utf-8")
    status, output, errors = mdm("check", path)
    assert (status, errors) == (0, "")
    assert output[-1] == f"{path}: ensembles, no problems found"
    matches = [re.fullmatch(rf"{re.escape(str(path))}:\d+:\d+: note: (.*)", line) for line in output[:-1]]
    return [match[1] for match in matches]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "robot.toml"


def test_nothing_is_odd_about_a_plain_file_even_with_a_byte_order_mark(mdm, path):
    assert notes(mdm, path) == []
    assert notes(mdm, path, text="\ufeff" + path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(("seconds", "odd"), [(299, False), (300, True)])
def test_times_that_are_likely_in_milliseconds(mdm, path, seconds, odd):
    found = notes(mdm, path, predicates=f"D = {{ max_age = {seconds} }}\nE = 'D'", factor='["E", "B"]')
    told = "predicates.D.max_age = 300 are seconds, 5 min: 0.3 would be as many milliseconds"
    assert (told in found) is odd
    (found,) = notes(mdm, path, go='{ call = "builtins:print", timeout = 20000 }')
    assert found.startswith("ensembles.robot.actions.Go.timeout = 20000 are seconds, 333 min")


def test_sensors_that_nothing_uses_and_names_that_differ_by_case(mdm, path):
    found = notes(mdm, path, predicates="Never = {}\na = {}\nNor = {}")
    assert found == [
        "predicates and events: 'A' and 'a' differ by capital letters alone",
        *(
            f"nothing in this file uses {name!r}: what code tells there leads to no decision"
            for name in ("Never", "a", "Nor")
        ),
    ]
    text = path.read_text(encoding="utf-8").replace("Stop =", "go =")
    assert "actions of 'robot': 'Go' and 'go' differ by capital letters alone" in notes(mdm, path, text=text)


@pytest.mark.parametrize(
    ("one", "other", "where"),
    [
        ("A and C", "A", "A and C are"),
        ("A or B", "B or C", "B is"),
        ("not A", "not A and not B", "none of A, B is"),
        ("A and B", "A and C", None),  # B and C may well exclude each other
        ("A and not B", "A and B", None),
        ("A", "B", None),
    ],
)
def test_formulas_of_a_factor_that_hold_together(mdm, path, one, other, where):
    found = notes(mdm, path, predicates=f'D = "{one}"\nE = "{other}"', factor='["D", "E"]')
    told = "ensemble 'robot': 'D' and 'E' of the state factor 's' are both true where"
    assert [note for note in found if note.startswith(told)] == ([] if where is None else [f"{told} {where}"])


def test_one_ensemble_that_two_actions_start(mdm, path):
    text = FILE.format(factor='["A", "B"]', predicates="", go='{ ensemble = "other" }', rest='"builtins:print"')
    twice = text.replace('Stop = "builtins:print"', 'Stop = { ensemble = "other" }')
    told = "ensemble 'robot': the actions Go and Stop start the same ensemble 'other'"
    assert notes(mdm, path, text=twice) == [told]
    third = '[ensembles.third]\npolicy = [0]\nstates = { u = ["A", "B"] }\nactions = { Wait = "builtins:print" }\n'
    (found,) = [note for note in notes(mdm, path, text=twice + third.replace("[0]", "[0, 0]")) if "start" in note]
    assert found == f"{told}; no action starts 'third', which decides by itself"


def test_a_team_s_file_is_looked_at_once(mdm, tmp_path):
    for file in (EXAMPLES / "team").iterdir():
        if file.is_file():
            (tmp_path / file.name).write_bytes(file.read_bytes())
    path = tmp_path / "meeting.toml"
    path.write_text(path.read_text().replace("[predicates]", "[predicates]\nNever = {}", 1))
    assert "Never" in path.read_text()
    assert str(mdm("check", path)[1]).count("nothing in this file uses 'Never'") == 1


def test_ensembles_that_can_be_built_are_noted_on_beside_the_problems_of_a_team_s_file(mdm, tmp_path):
    for file in (EXAMPLES / "team").iterdir():
        if file.is_file():
            (tmp_path / file.name).write_bytes(file.read_bytes())
    path = tmp_path / "carriers.toml"
    path.write_text(path.read_text().replace('"carriers:d.unload"', '"carrierz:d.unload"'))
    status, output, errors = mdm("team", "check", path)
    assert status == 1
    assert "carrierz" in errors
    (note,) = [line for line in output if "note: ensemble 'unloading' has a safe action" in line]
    assert "IsLoaded is no longer sensed" in note


def test_each_note_has_its_line_and_column_also_as_json(facts, path):
    text = FILE.format(
        factor='["A", "B"]', predicates="D = { max_age = 500 }", go='"builtins:print"', rest='"builtins:print"'
    )
    path.write_text(text, encoding="utf-8")
    found = facts("check", path)["notes"]
    line = text.split("\n").index("D = { max_age = 500 }") + 1
    assert f"{path}:{line}:1: nothing in this file uses 'D': what code tells there leads to no decision" in found
    assert any(note.startswith(f"{path}:{line}:7: predicates.D.max_age = 500 are seconds") for note in found)


@pytest.mark.parametrize(
    ("key", "value", "odd"),
    [
        *(("drive", 2000, "are decisions a second"), ("drive", 0.02, "is a decision each 50 s"), ("drive", 10.0, None)),
        *(("deadline", 0.0005, "are seconds, 0.5 ms"), ("deadline", 0.05, None)),
        *(("safe_timeout", 5000, "are seconds, 83.3 min"), ("safe_timeout", 600, None)),
    ],
)
def test_units_that_are_unlikely(mdm, path, key, value, odd):
    text = FILE.format(factor='["A", "B"]', predicates="", go='"builtins:print"', rest='"builtins:print"')
    found = notes(mdm, path, text=text.replace("policy = [0, 1]", f"policy = [0, 1]\n{key} = {value}"))
    told = [note for note in found if note.startswith(f"ensembles.robot.{key} = {value:g} {odd or ''}")]
    assert len(told) == (odd is not None)


@pytest.mark.parametrize(
    ("one", "other", "told"),
    [
        ("< 0.3", "> 0.2", ["'D' and 'E' both hold at 0.25"]),
        ("< 0.2", "> 0.3", ["none of 'D', 'E' holds at 0.2"]),
        ("< 0.2", ">= 0.2", []),
        ("< 0.2 until > 0.3", "> 0.3 until < 0.2", []),
        ("< 0.2 until > 0.3", ">= 0.2", ["'D' and 'E' both hold at 0.2"]),
    ],
)
def test_thresholds_that_overlap_or_leave_a_gap(mdm, path, one, other, told):
    found = notes(mdm, path, predicates=f"D = {{ when = '{one}' }}\nE = {{ when = '{other}' }}", factor='["D", "E"]')
    end = " of the state factor 's', if all are told the same number"
    assert [note for note in found if note.endswith(end)] == [f"ensemble 'robot': {each}{end}" for each in told]


def test_actions_that_the_policy_never_chooses(mdm, path):
    text = FILE.format(factor='["A", "B"]', predicates="", go='"builtins:print"', rest='"builtins:print"')
    assert not notes(mdm, path, text=text)
    (told,) = notes(mdm, path, text=text.replace("policy = [0, 1]", "policy = [0, 0]"))
    assert told == "ensemble 'robot': the policy never chooses the action 'Stop'"
