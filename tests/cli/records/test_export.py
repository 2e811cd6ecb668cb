"""`mdm record export`: the decisions of a record as a table, read by other programs."""

from __future__ import annotations

import csv
import importlib
import json

import numpy as np
import pytest
from records import Writing, decision, tiger, written

from mdm.messages import Reward, State


def exported(mdm, record, table, *arguments):
    status, output, errors = mdm("record", "export", record, "-o", table, *arguments)
    assert (status, errors) == (0, "")
    assert output[0].startswith(f"{table}: ")
    if table.suffix == ".parquet":
        return importlib.import_module("pyarrow.parquet").read_table(table).to_pylist()
    with table.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_a_table_has_the_decisions_with_names(mdm, tmp_path):
    path = tiger(tmp_path / "run.mcap")
    messages = [json.loads(line)["message"] for line in mdm("record", "cat", path, "--topic", "decisions")[1]]
    table = exported(mdm, path, tmp_path / "run.csv")
    assert len(table) == len(messages)
    for row, message in zip(table, messages, strict=True):
        assert (row["time"], row["ensemble"], row["epoch"]) == (str(message["time"]), "tiger", str(message["epoch"]))
        assert row["action_name"] == message["action_name"]
        assert [float(row[name]) for name in ("belief[tiger-left]", "belief[tiger-right]")] == message["belief"]
        assert float(row["reward"]) == message["reward"]
        seen = message["observation"]
        assert row["observation_name"] == ("" if seen is None else ("hear-left", "hear-right")[seen])
        assert (row["end"], float(row["end_seconds"])) == ("succeeded", message["time"] / 1e9)


def test_parquet_has_the_same_with_types(mdm, tmp_path):
    pytest.importorskip("pyarrow")
    path = tiger(tmp_path / "run.mcap")
    table = exported(mdm, path, tmp_path / "run.parquet")
    text = exported(mdm, path, tmp_path / "run.csv")
    for row, line in zip(table, text, strict=True):
        assert {name: "" if value is None else str(value) for name, value in row.items()} == line
    assert type(table[0]["time"]) is int
    assert type(table[0]["belief[tiger-left]"]) is float
    schema = importlib.import_module("pyarrow.parquet").read_schema(tmp_path / "run.parquet")
    assert str(schema.field("state").type) == "int64"  # where none has a value, too
    assert str(schema.field("end_detail").type) == "string"


def test_several_ensembles_have_columns_of_their_own(mdm, tmp_path):
    pairs = [
        ("decisions", decision(1, ensemble="a", belief=np.array([0.25, 0.75]))),
        ("decisions", decision(2, ensemble="b", belief=np.array([1.0]), observation=(1, None))),
        ("decisions", decision(3, ensemble="c")),
    ]
    path = written(tmp_path / "run.mcap", pairs)
    table = exported(mdm, path, tmp_path / "run.csv")
    assert [[row[f"belief[{name}]"] for name in ("a: 0", "a: 1", "b: 0")] for row in table] == [
        ["0.25", "0.75", ""],
        ["", "", "1.0"],
        ["", "", ""],
    ]
    assert [row["observation"] for row in table] == ["", "[1, null]", ""]
    assert [row["ensemble"] for row in exported(mdm, path, tmp_path / "b.csv", "--ensemble", "b")] == ["b"]
    assert "belief[a: 0]" not in exported(mdm, path, tmp_path / "c.csv", "--no-beliefs")[0]


def test_names_with_commas_and_quotes_stay_whole(mdm, tmp_path):
    path = written(tmp_path / "run.mcap", [("decisions", decision(1, name='Go, "now"'))])
    assert exported(mdm, path, tmp_path / "run.csv")[0]["action_name"] == 'Go, "now"'


def test_the_true_state_is_there_where_it_was_told(mdm, tmp_path):
    record = Writing(tmp_path / "run.mcap")
    record.write("decisions", decision(1))
    record.write("patrol/true_state", State(1, 2, (2,)))
    record.write("decisions", decision(2))
    record.write("patrol/true_reward", Reward(2, 2, -1.5))
    table = exported(mdm, record.close(), tmp_path / "run.csv")
    assert [row["true_state"] for row in table] == ["", "2"]
    assert [row["true_reward"] for row in table] == ["", "-1.5"]


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["-o", "run.txt"], 2, "ends in .csv or .parquet, not 'run.txt'"),
        (["-o", "nowhere/run.csv"], 1, "nowhere/run.csv"),
        (["-o", "run.csv", "--ensemble", "nobody"], 1, "no decisions of 'nobody'; there are of patrol"),
        ([], 2, "-o"),
    ],
)
def test_what_cannot_be_exported(mdm, tmp_path, monkeypatch, arguments, status, words):
    monkeypatch.chdir(tmp_path)
    path = written(tmp_path / "run.mcap", [("decisions", decision(1))])
    found, output, errors = mdm("record", "export", path, *arguments)
    assert (found, output) == (status, [])
    assert words in errors
    assert [each.name for each in tmp_path.iterdir()] == ["run.mcap"]


def test_a_record_without_decisions_or_with_huge_beliefs_is_told(mdm, tmp_path):
    path = written(tmp_path / "run.mcap", [("patrol/state", State(1, 2, (2,)))])
    assert "there are no decisions in this record" in mdm("record", "export", path, "-o", tmp_path / "x.csv")[2]
    path = written(tmp_path / "run.mcap", [("decisions", decision(1, belief=np.full(6000, 1 / 6000)))])
    status, _, errors = mdm("record", "export", path, "-o", tmp_path / "x.csv")
    assert status == 1
    assert "6,000 states" in errors
    assert "--no-beliefs" in errors
    assert not (tmp_path / "x.csv").exists()
    assert len(exported(mdm, path, tmp_path / "x.csv", "--no-beliefs")) == 1


def test_a_torn_record_is_exported_to_the_tear(mdm, tmp_path):
    path = written(tmp_path / "run.mcap", [("decisions", decision(number)) for number in range(3000)])
    path.write_bytes(path.read_bytes()[:-100])
    status, output, _ = mdm("record", "export", path, "-o", tmp_path / "run.csv")
    assert (status, output[0]) == (0, f"{tmp_path}/run.csv: 3,000 decisions written")
    assert output[1].endswith(": what follows is not there")


def test_without_pyarrow_the_way_out_is_told(mdm, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    path = written(tmp_path / "run.mcap", [("decisions", decision(1))])
    status, _, errors = mdm("record", "export", path, "-o", tmp_path / "run.parquet")
    assert status == 1
    assert "pip install pyarrow" in errors
