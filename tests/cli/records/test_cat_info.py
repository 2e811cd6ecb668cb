"""`mdm record info`: what is in a record, and what is no record."""

from __future__ import annotations

import json
import re

import pytest
from records import Writing, decision, official, tiger, written

from mdm.recording import Record


def test_a_record_is_described(mdm, tmp_path):
    path = tiger(tmp_path / "run.mcap")
    status, output, errors = mdm("record", "info", path)
    assert (status, errors) == (0, "")
    words = [line.split() for line in output]
    assert ["complete", "yes"] in words
    assert ["end", "of", "the", "run", "in", "order"] in words
    assert ["clock", "virtual"] in words
    assert ["tiger:", "states", "2:", "tiger-left,", "tiger-right"] in words
    assert ["tiger:", "actions", "3:", "listen,", "open-left,", "open-right"] in words
    assert ["decisions", "mdm.Decision", "20"] in words


def test_it_is_one_json_object(mdm, tmp_path):
    path = tiger(tmp_path / "run.mcap")
    (line,) = mdm("record", "info", path, "--json")[1]
    facts = json.loads(line)
    assert facts["files"] == [str(path)]
    assert facts["bytes"] == path.stat().st_size
    assert (facts["complete"], facts["torn"], facts["ended_in_order"], facts["lost"]) == (True, None, True, 0)
    assert facts["seconds"] == 9.5
    assert facts["messages"] == sum(topic["messages"] for topic in facts["topics"]) == len(official(path))
    assert facts["head"]["format"] == "1"
    assert json.loads(facts["metadata"]["ensemble tiger"]["states"]) == ["tiger-left", "tiger-right"]


def test_a_torn_record_says_where(mdm, tmp_path):
    path = written(tmp_path / "run.mcap", [("decisions", decision(number)) for number in range(3000)])
    path.write_bytes(path.read_bytes()[:-9000])
    status, output, _ = mdm("record", "info", path)
    assert status == 0
    (torn,) = [line for line in output if line.startswith("torn ")]
    assert f" of {path.stat().st_size:,}" in torn
    assert "complete                no" in output


def test_files_of_one_run_are_described_together(mdm, tmp_path):
    pairs = [("decisions", decision(1000 * number)) for number in range(10)]
    path = written(tmp_path / "run.mcap", pairs, split_seconds=4)
    output = mdm("record", "info", path)[1]
    assert [line.split()[1] for line in output if line.startswith("file ")] == [
        str(tmp_path / name) for name in ("run.mcap", "run-1.mcap", "run-2.mcap")
    ]


def test_a_missing_file_of_a_run_is_told_by_each_verb(mdm, tmp_path):
    pairs = [("decisions", decision(1000 * number)) for number in range(10)]
    path = written(tmp_path / "run.mcap", pairs, split_seconds=4)
    (tmp_path / "run-1.mcap").unlink()
    told = f"{tmp_path}/run-1.mcap: this file of the record is missing, or is of another record"
    output = mdm("record", "info", path)[1]
    assert "complete                no" in output
    assert f"torn                    {told}" in output
    assert mdm("record", "cat", path)[2] == f"mdm record cat: {told}: what follows is not there\n"
    output = mdm("record", "repair", path, "-o", tmp_path / "whole.mcap")[1]
    assert output == [f"{tmp_path}/whole.mcap: 4 messages written", f"{told}: what follows is not there"]
    assert "complete                yes" in mdm("record", "info", tmp_path / "whole.mcap")[1]
    assert told in mdm("record", "export", path, "-o", tmp_path / "run.csv")[1][1]


def test_damage_is_told_by_each_verb(mdm, tmp_path):
    path = written(tmp_path / "run.mcap", [("decisions", decision(number)) for number in range(5000)])
    content = bytearray(path.read_bytes())
    place = content.index(b"zstd", content.index(b"zstd") + 1) + 500
    content[place] ^= 1
    path.write_bytes(content)
    lost = 5000 - Record(path).counts["decisions"]
    assert 0 < lost < 5000
    output = mdm("record", "info", path)[1]
    assert "complete                no" in output
    assert ["lost", "messages", f"{lost:,}"] in [line.split() for line in output]
    (told,) = [line.removeprefix("damaged").strip() for line in output if line.startswith("damaged")]
    assert re.fullmatch(
        rf"{path}: a chunk is damaged, [\d,]+ bytes at byte [\d,]+: {lost:,} messages are lost, "
        r"between \d\.\d{6} s and \d\.\d{6} s",
        told,
    )
    (line,) = mdm("record", "info", path, "--json")[1]
    facts = json.loads(line)
    assert (facts["complete"], facts["torn"], facts["damage"], facts["lost"]) == (False, None, [told], lost)
    assert mdm("record", "cat", path)[2] == f"mdm record cat: {told}\n"
    output = mdm("record", "repair", path, "-o", tmp_path / "whole.mcap")[1]
    assert output == [f"{tmp_path}/whole.mcap: {5000 - lost:,} messages written", told]
    assert len(official(tmp_path / "whole.mcap")) == 5000 - lost
    whole = Record(tmp_path / "whole.mcap")
    assert (whole.torn, whole.damage, whole.lost) == (None, (), lost)
    assert whole.metadata["mdm.repaired"]["damage"] == told
    assert told in mdm("record", "export", path, "-o", tmp_path / "run.csv")[1]


def test_more_is_told_where_there_is_more(mdm, tmp_path):
    record = Writing(tmp_path / "run.mcap", bound=3000)
    record.writer.metadata("seeds", {"patrol": "7"})
    facts = {"states": '["a","b","c","d","e"]', "state_factors": '{"lamp":["off","on"],"door":["shut","open"]}'}
    record.writer.metadata("ensemble patrol", facts)
    record.writer.attach("files/robot.toml", "application/toml", b"[ensembles]")
    for number in range(100):
        record.write("decisions", decision(number))
    words = [line.split() for line in mdm("record", "info", record.close())[1]]
    assert ["seeds:", "patrol", "7"] in words
    assert ["patrol:", "states", "5:", "a,", "b,", "c,", "d,", "…"] in words
    assert ["patrol:", "state_factors", "lamp:", "off,", "on;", "door:", "shut,", "open"] in words
    assert ["files/robot.toml", "application/toml", "11"] in words
    lost = record.writer.statistics().dropped
    assert ["lost", "messages", str(lost)] in words


@pytest.mark.parametrize("verb", [["info"], ["cat"], ["export", "-o", "x.csv"], ["repair", "-o", "x.mcap"]])
@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "there is no such file"),
        (b"", "is empty"),
        (b"discount: 0.9", "is not an MCAP file"),
        (b"\x89MCAP0\r\n", "head"),
    ],
)
def test_what_is_no_record_is_a_sentence(mdm, tmp_path, monkeypatch, verb, content, words):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "run.mcap"
    if content is not None:
        path.write_bytes(content)
    status, output, errors = mdm("record", verb[0], path, *verb[1:])
    assert (status, output) == (1, [])
    assert errors.startswith(f"mdm record {verb[0]}: {path}: ")
    assert words in errors
    assert errors.count("\n") == 1
    assert {each.name for each in tmp_path.iterdir()} <= {"run.mcap"}
