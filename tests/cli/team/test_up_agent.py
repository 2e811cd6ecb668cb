"""`mdm run --agent` and `mdm team run`: one agent of a team."""

from __future__ import annotations

import json
import signal

import pytest
from patience import PATIENCE
from places import EXAMPLES
from programs import python


@pytest.mark.parametrize("verb", [("run",), ("team", "run")])
def test_an_agent_runs_alone_for_some_seconds(free, tmp_path, verb):
    team, decided = free(), tmp_path / "a.jsonl"
    with python("-m", "mdm", *verb, team, "--agent", "a", "--seconds", 1.5, "--decisions", decided) as process:
        _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, errors
    assert decided.read_text() == ""  # it has never met b, without whom it decides nothing


ACTING = """
import asyncio

def stay():
    print("stays")

def go():
    print("goes")

async def sense(system):
    for number in range(10**9):
        system.predicates.sense("InLab", number % 2 == (system.agent == "a"))
        await asyncio.sleep(2.0)  # far longer than the end takes on a busy machine
"""


def test_an_agent_ends_after_so_many_decisions(free, tmp_path):
    team = free()
    (tmp_path / "acting_code.py").write_text(ACTING)
    team.write_text(team.read_text().replace("team_code:", "acting_code:"))
    command = ("-m", "mdm", "team", "run", team, "--agent")
    with (
        python(*command, "b", "--seconds", PATIENCE),
        python(*command, "a", "--epochs", 3, "--decisions", tmp_path / "a.jsonl") as process,
    ):
        output, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, errors
    decided = [json.loads(line)["action"] for line in (tmp_path / "a.jsonl").read_text().splitlines()]
    made = len([action for action in decided if action is not None])
    assert made in {3, 4}  # one more may have come with the third
    assert 1 <= len(output.splitlines()) <= made


@pytest.mark.slow
def test_an_agent_that_is_refused_has_failed(free, tmp_path):
    team = free()
    other = tmp_path / "other.toml"
    other.write_text(team.read_text().replace("[team]", "[team]\nmax_age = 7.5"))
    run = ("-m", "mdm", "team", "run")
    with (
        python(*run, team, "--agent", "a", "--seconds", 12) as first,
        python(*run, other, "--agent", "b", "--seconds", 12) as second,
    ):
        told = [process.communicate(timeout=PATIENCE)[1] for process in (first, second)]
    failed = [text for process, text in zip((first, second), told, strict=True) if process.returncode == 1]
    assert len(failed) == 1, told
    assert "took no part in team 'rooms': team's max_age is" in failed[0].splitlines()[-1]


def test_an_agent_that_is_refused_waits_until_it_is_ended(free, tmp_path):
    team = free()
    other = tmp_path / "other.toml"
    other.write_text(team.read_text().replace("[team]", "[team]\nmax_age = 7.5"))
    run = ("-m", "mdm", "team", "run")
    with python(*run, team, "--agent", "a", "--log", "json") as first:
        while json.loads(first.stderr.readline()).get("event") != "running":
            pass
        with python(*run, other, "--agent", "b", "--log", "json") as second:
            while "refused" not in json.loads(second.stderr.readline()).values():
                pass
            assert second.poll() is None
            second.send_signal(signal.SIGINT)
            _, told = second.communicate(timeout=PATIENCE)
        assert first.poll() is None
    assert second.returncode
    assert "took no part in team 'rooms': team's max_age is" in told.splitlines()[-1]


def test_it_ends_with_its_input(free):
    import subprocess
    import sys

    command = [sys.executable, "-m", "mdm", "run", free(), "--agent", "a", "--attached", "--log", "json"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        while json.loads(process.stderr.readline()).get("event") != "running":
            pass
        process.communicate(timeout=PATIENCE)
    assert process.returncode == 0


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (
            ["FILE"],
            2,
            "the team 'rooms': say which agent this process is, such as --agent a (there are a, b)",
        ),
        (["FILE", "--agent", "c"], 1, "team 'rooms' has no agent 'c'; the agents are a, b"),
        (["FILE", "--agent", "a", "--virtual"], 2, "--virtual is for a file without a team"),
        (["FILE", "--agent", "a", "--decisions", "/nowhere/a.jsonl", "--seconds", "5"], 1, "cannot be written to"),
        (["TIGER", "--agent", "a"], 2, "--agent is for a team's file"),
        (["FILE", "--agent"], 2, "expected one argument"),
        (["FILE", "--agent", "a", "--epochs", "0"], 2, "a whole number of 1 or more was expected, not '0'"),
    ],
)
def test_wrong_usage(mdm, free, arguments, status, words):
    files = {"FILE": free(), "TIGER": EXAMPLES / "tiger.toml"}
    found, _, errors = mdm("run", *(files.get(argument, argument) for argument in arguments))
    assert found == status
    assert words in errors
    assert "Traceback" not in errors


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["FILE"], "say which agent this process is"),
        (["FILE", "--agent", "a", "--virtual"], "there is no argument --virtual"),
        (["TIGER"], "describes no team: a table [team] is missing"),
    ],
)
def test_wrong_usage_of_the_verb_of_teams(mdm, free, arguments, words):
    files = {"FILE": free(), "TIGER": EXAMPLES / "tiger.toml"}
    found, _, errors = mdm("team", "run", *(files.get(argument, argument) for argument in arguments))
    assert found == 2
    assert words in errors
