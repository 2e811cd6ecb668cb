"""`mdm run --decisions`: each decision is a line of JSON."""

from __future__ import annotations

import json

import pytest
from places import EXAMPLES

TIGER = EXAMPLES / "tiger.toml"


def test_each_decision_is_a_line_and_a_second_run_adds_its_own(mdm, tmp_path):
    path = tmp_path / "decided.jsonl"
    for epochs in (3, 2):
        assert mdm("run", TIGER, "--virtual", "--epochs", str(epochs), "--decisions", path)[0] == 0
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [line["epoch"] for line in lines] == [0, 1, 2, 0, 1]
    assert [line["time"] for line in lines] == [0, 500_000_000, 1_000_000_000, 0, 500_000_000]
    assert all(line["ensemble"] == "tiger" and line["belief"] == [0.5, 0.5] for line in lines)


def test_a_file_of_another_kind_is_refused(mdm, tmp_path):
    status, _, errors = mdm("run", TIGER, "--virtual", "--epochs", "1", "--decisions", tmp_path / "decided.csv")
    assert status == 1
    assert f"decisions are lines of JSON: name a file that ends in .jsonl, not {tmp_path}/decided.csv" in errors


def test_what_is_refused_leaves_no_record(mdm, tmp_path):
    path = tmp_path / "run.mcap"
    for decisions in (path, tmp_path / "none" / "d.jsonl"):
        assert mdm("run", TIGER, "--virtual", "--epochs", "1", "--record", path, "--decisions", decisions)[0] == 1
    assert not list(tmp_path.iterdir())


def test_a_path_that_cannot_be_written_is_told(mdm, tmp_path):
    status, _, errors = mdm("run", TIGER, "--virtual", "--epochs", "1", "--decisions", tmp_path / "none" / "d.jsonl")
    assert status == 1
    assert f"decisions cannot be written to {tmp_path}/none/d.jsonl: No such file or directory" in errors


def test_a_full_disk_is_a_fault_and_ends_nothing(mdm, tmp_path):
    path = tmp_path / "decided.jsonl"
    path.symlink_to("/dev/full")
    if not path.exists():
        pytest.skip("needs /dev/full")
    status, _, errors = mdm("run", TIGER, "--virtual", "--epochs", "3", "--decisions", path)
    assert status == 0
    assert errors.count(f"lines cannot be written to {path}: No space left on device") == 1
