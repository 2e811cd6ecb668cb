"""`mdm sweep`: its tables, what it says of points that fail and of sweeps that end early, and real kills."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys

import pytest
from places import ROOT

from mdm.problems import grid_world

SWEEP = """
problem = "grid_world"
[vary]
discount = 0.9
slip = [0.1, 0.3]
goal_reward = { from = 1, to = 2 }
[solve]
solver = "value-iteration"
"""


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sweep.toml").write_text(SWEEP)
    return tmp_path / "sweep.toml"


def rows_of(path):
    with path.open(newline="") as file:
        return [*csv.DictReader(file)]


def without_run(rows):
    return [{name: value for name, value in row.items() if not name.startswith("run.")} for row in rows]


def test_a_row_is_what_the_other_verbs_print(mdm, facts, file, tmp_path):
    file.write_text(f"{SWEEP}[evaluate]\nepisodes = 40\nseed = 3\n")
    assert mdm("sweep", file, "-o", "r.csv") == (0, ["r.csv: 4 points written"], "")
    rows = rows_of(tmp_path / "r.csv")
    assert [(row["slip"], row["goal_reward"]) for row in rows] == [
        *(("0.1", "1"), ("0.1", "2"), ("0.3", "1"), ("0.3", "2"))
    ]
    from mdm import save_model

    save_model(grid_world(slip=0.3, goal_reward=2, discount=0.9), tmp_path / "grid.npz")
    solved = facts("solve", "grid.npz", "-o", "policy.npz", "--solver", "value-iteration")
    valued = facts("evaluate", "grid.npz", "policy.npz", "--episodes", 40, "--seed", 3)
    for column, fact in (("lower", solved["lower"]), ("value", valued["mean"])):
        assert float(rows[3][column]) == fact
    assert float(rows[3]["standard_error"]) == valued["standard_error"]


def test_a_table_in_parquet_has_the_same_rows_with_their_kinds(mdm, file, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    assert mdm("sweep", file, "-o", "r.csv")[0] == mdm("sweep", file, "-o", "s.parquet")[0] == 0
    table = parquet.read_table(tmp_path / "s.parquet")
    kinds = {field.name: str(field.type) for field in table.schema}
    assert (kinds["point"], kinds["goal_reward"], kinds["slip"], kinds["value"]) == (
        "int64",
        "int64",
        "double",
        "double",
    )
    texts = [{name: "" if value is None else str(value) for name, value in row.items()} for row in table.to_pylist()]
    assert without_run(texts) == without_run(rows_of(tmp_path / "r.csv"))
    assert (kinds["failure"], kinds["episodes"], kinds["solver"]) == ("string", "int64", "string")
    file.write_text('model = "swept:walk"\n[vary]\nslip = 0.5\ngoal = [true, 2]\n"solve.gap" = [0.1, 1]\n')
    assert mdm("sweep", file, "-o", "t.parquet")[0] == 0
    rows = parquet.read_table(tmp_path / "t.parquet").to_pylist()
    assert [(row["goal"], row["solve.gap"]) for row in rows] == [("true", 0.1), ("true", 1.0), ("2", 0.1), ("2", 1.0)]


def test_a_result_that_is_there_is_kept(mdm, file, tmp_path):
    (tmp_path / "r.csv").write_text("mine")
    for more in ((), ("--resume",)):
        status, _, errors = mdm("sweep", file, "-o", "r.csv", *more)
        assert (status, (tmp_path / "r.csv").read_text()) == (1, "mine")
        assert "this file is here already" in errors
    assert mdm("sweep", file, "-o", "s.csv")[0] == 0
    (tmp_path / "s.csv").unlink()
    assert "4 points ended in an earlier run: --resume" in mdm("sweep", file, "-o", "s.csv")[2]
    assert mdm("sweep", file, "-o", "s.csv", "--resume") == (0, ["s.csv: 4 points written"], "")
    file.write_text(SWEEP.replace("0.3", "0.4"))
    assert "another sweep" in mdm("sweep", file, "-o", "s.csv", "--resume")[2]
    for name, words in {"r.txt": ".csv or .parquet", "no/r.csv": "cannot be written", "sweep.toml": ".csv"}.items():
        assert words in mdm("sweep", file, "-o", name)[2]


def test_points_that_fail_are_counted_and_the_others_end(mdm, file, tmp_path):
    file.write_text('problem = "rock_sample"\n[vary]\nsize = 2\nrocks = [1, 5]\n[solve]\nsolver = "qmdp"\n')
    status, output, errors = mdm("sweep", file, "-o", "r.csv")
    assert (status, output) == (1, ["r.csv: 2 points written"])
    assert "1 of 2 points failed, and --resume tries them once more; the first, size 2, rocks 5: a field of" in errors
    assert [bool(row["failure"]) for row in rows_of(tmp_path / "r.csv")] == [False, True]
    (tmp_path / "r.csv").unlink()
    file.write_text('problem = "rock_sample"\n[vary]\nsize = 2\nrocks = [5]\n')
    status, output, errors = mdm("sweep", file, "-o", "s.csv", "--json")
    assert (status, errors, (tmp_path / "s.csv").exists()) == (1, "", False)
    told = json.loads(output[0])
    assert (told["result"], told["ended"], told["points"], told["failures"][0]["point"]) == (None, 0, 1, 0)


def test_what_has_ended_by_a_signal_is_kept(mdm, file, tmp_path, monkeypatch):
    from mdm.config import sweep

    solve = sweep.solve

    def first(*given, **options):
        monkeypatch.setattr(sweep, "solve", second)
        return solve(*given, **options)

    def second(*given, **options):
        monkeypatch.setattr(sweep, "solve", solve)
        os.kill(os.getpid(), signal.SIGINT)
        return solve(*given, **options)

    monkeypatch.setattr(sweep, "solve", first)
    assert mdm("sweep", file, "-o", "r.csv")[:2] == (130, ["interrupted: r.jsonl has 1 of 4 points, --resume goes on"])
    assert not (tmp_path / "r.csv").exists()
    assert mdm("sweep", file, "-o", "r.csv", "--resume")[0] == 0
    assert mdm("sweep", file, "-o", "s.csv")[0] == 0
    assert without_run(rows_of(tmp_path / "r.csv")) == without_run(rows_of(tmp_path / "s.csv"))


@pytest.mark.slow
def test_a_sweep_that_is_killed_three_times_equals_one_that_ran_through(tmp_path):
    (tmp_path / "sweep.toml").write_text(
        'model = "swept:walk"\n[vary]\nslip = { from = 0.0, to = 0.99, step = 0.01 }\n'
        '[evaluate]\nmetrics = ["swept:perishing"]\n'
    )
    marks = tmp_path / "marks"
    marks.mkdir()
    place = os.pathsep.join(map(str, (ROOT, ROOT / "tests")))
    environment = {**os.environ, "PYTHONPATH": place, "MDM_TEST_MARKS": str(marks)}
    command = [sys.executable, "-m", "mdm", "sweep", str(tmp_path / "sweep.toml")]

    def run(name, *more):
        given = [*command, "-o", str(tmp_path / name), *more]
        return subprocess.run(given, env=environment, capture_output=True, text=True, timeout=300).returncode

    assert [run("r.csv", "--resume") for _ in range(4)] == [-signal.SIGKILL] * 3 + [0]
    assert run("s.csv", "--workers", "2") == 0
    rows = rows_of(tmp_path / "r.csv")
    assert len(rows) == 100
    assert without_run(rows) == without_run(rows_of(tmp_path / "s.csv"))
    lines = (tmp_path / "r.jsonl").read_text().splitlines()
    assert [json.loads(line)["point"] for line in lines[1:]] == [*range(100)]  # none was done again
