"""`mdm simulate`: returns, their errors, and what is refused."""

from __future__ import annotations

import json

import pytest
from places import DATA, EXAMPLES

TIGER = ["--model", str(EXAMPLES / "tiger.pomdp"), "--policy", str(EXAMPLES / "tiger.vf")]


def test_simulate(mdm):
    status, output, _ = mdm("simulate", *TIGER, "--episodes", "200", "--seed", "2", "--json")
    result = json.loads(output[0])
    assert status == 0
    assert abs(result["mean"] - 19.3713) < 4 * result["standard_error"]  # the corpus' optimum
    arguments = ("simulate", *TIGER, "--episodes", "20", "--seed", "2", "--json")
    status, output, _ = mdm(*arguments)
    assert mdm(*arguments)[1] == output
    assert mdm("simulate", TIGER[1], TIGER[3], *arguments[5:])[1] == output
    assert mdm("simulate", EXAMPLES / "patrol" / "patrol.toml", "--ensemble", "patrol", "--episodes", "5")[0] == 0
    assert "no ensemble 'x'" in mdm("simulate", EXAMPLES / "tiger.toml", "--ensemble", "x")[2]
    assert mdm("simulate", *TIGER, "--steps", "0")[0] == 2
    assert mdm("simulate")[0] == 2


def test_simulate_of_events_with_false_negatives(mdm):
    """Ends are told; a false negative leads to no decision, and to no end of the loop."""
    data = DATA
    arguments = ["--model", data / "models" / "guard.pgmx", "--policy", data / "policies" / "guard.vf"]
    status, output, _ = mdm("simulate", *arguments, "--episodes", "3", "--discount", "0.5", "--seed", "1", "--json")
    assert status == 0
    assert json.loads(output[0])["steps"] == 14
    missing = ["--false-negative", "nothing", "--discount", "0.5", "--seed", "1", "--json"]
    status, output, _ = mdm("simulate", *arguments, "--episodes", "3", *missing)
    assert status == 0
    assert json.loads(output[0])["mean"] < 0
    status, _, errors = mdm("simulate", EXAMPLES / "tiger.toml", "--discount", "0.5")
    assert status == 2
    assert "a TOML file has its own" in errors


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "give a TOML file, or both"),
        (TIGER[:2], "give a TOML file, or both"),
        ([EXAMPLES / "tiger.toml", *TIGER[:2]], "give either"),
        ([EXAMPLES / "tiger.toml", *TIGER], "give either"),
        ([*TIGER, "--ensemble", "tiger"], "--ensemble is for a TOML file"),
    ],
)
def test_wrong_usage(mdm, arguments, words):
    status, output, errors = mdm("simulate", *arguments)
    assert (status, output) == (2, [])
    assert words in errors.splitlines()[-1]


def test_a_recorded_simulation_is_replayed(mdm, tmp_path):
    mdm("simulate", *TIGER, "--episodes", "3", "--steps", "10", "--record", tmp_path / "a.mcap")
    status, output, _ = mdm("replay", tmp_path / "a.mcap")
    assert (status, output) == (0, ["30 decisions recorded, 30 replayed: all the same (bit by bit)"])
    mdm("simulate", EXAMPLES / "tiger.toml", "--episodes", "2", "--steps", "5", "--record", tmp_path / "b.mcap")
    status, output, _ = mdm("replay", tmp_path / "b.mcap")
    assert (status, output) == (0, ["10 decisions recorded, 10 replayed: all the same (bit by bit)"])


def test_a_simulation_that_cannot_be_recorded_is_refused(mdm, tmp_path):
    status, _, error = mdm("simulate", *TIGER, "--episodes", "1", "--record", tmp_path / "nowhere" / "a.mcap")
    assert status == 1
    assert "its folder does not exist" in error
