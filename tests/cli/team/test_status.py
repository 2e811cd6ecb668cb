"""`mdm team status`, `stop`, `reset` and `start` of a team that runs, and of one that does not."""

from __future__ import annotations

import asyncio
import json
import signal
import time
from typing import ClassVar

import pytest

from mdm import Error
from mdm.cli.team import commands


def asked(mdm, team, *, agents=2, mode="deciding"):
    """Ask until so many agents have this mode, a minute at most."""
    until = time.monotonic() + 60
    while time.monotonic() < until:
        status, output, errors = mdm("team", "status", team, "--json")
        found = json.loads(output[0])
        there = [one["joint"] for one in found["agents"].values()]
        if len(there) == agents and all(one["mode"] == mode and one.get("step") for one in there):
            return status, found, errors
    raise AssertionError((found, errors))


def test_a_team_that_runs_tells_how_it_is_and_is_told_what_to_do(mdm, free, up):
    team = free()
    with up(team) as running:
        for agent in "ab":
            running.hear(agent=agent, event="running", actor=agent)
        status, found, errors = asked(mdm, team)
        assert (status, errors, found["silent"]) == (0, "", [])
        a, b = (found["agents"][agent]["joint"] for agent in "ab")
        assert (a["role"], b["role"]) == ("leading", "following")
        assert (a["digest"], a["live"]) == (b["digest"], ["a", "b"])
        assert a["late"]["worst"] >= a["late"]["median"] > 0
        assert a["sent"]["messages"] > 0
        status, output, _ = mdm("team", "status", team)
        assert output[0].split()[:6] == ["agent", "ensemble", "mode", "role", "term", "step"]
        assert output[1].split()[:4] == ["a", "joint", "deciding", "leading"]
        assert mdm("team", "stop", team)[:2] == (0, ["joint: stop, said to a"])
        asked(mdm, team, mode="stopped")
        assert mdm("team", "start", team, "--ensemble", "joint")[0] == 0
        assert mdm("team", "reset", team)[0] == 0
        asked(mdm, team)
        status, _, errors = mdm("team", "start", team, "--ensemble", "jont")
        assert status == 1
        assert "no ensemble 'jont'; did you mean 'joint'" in errors


@pytest.mark.parametrize("verb", ["status", "start"])
def test_nobody_runs_it(mdm, free, verb):
    team = free()
    status, _, errors = mdm("team", verb, team)
    assert status == 1
    assert errors == f"mdm team {verb}: nobody runs the team 'rooms': no agent answers\n"


def test_one_that_does_not_answer_is_told(mdm, free, up, tmp_path):
    team = free()
    from programs import python

    with python("-m", "mdm", "team", "run", team, "--agent", "a", "--log", "json") as alone:
        while json.loads(alone.stderr.readline()).get("event") != "running":
            pass
        status, _, errors = asked(mdm, team, agents=1)
        assert status == 1
        assert errors == "mdm team status: no answer from b\n"
        status, output, errors = mdm("team", "stop", team)
        assert (status, output) == (1, ["joint: stop, said to a"])
        assert errors == "mdm team stop: joint: agent 'b' does not answer\n"


def test_one_that_hangs_is_told_and_the_others_are_asked(mdm, free):
    from programs import python

    team = free()
    alone = [("-m", "mdm", "team", "run", team, "--agent", agent, "--log", "json") for agent in "ab"]
    with python(*alone[0]) as a, python(*alone[1]) as b:
        asked(mdm, team)
        a.send_signal(signal.SIGSTOP)
        while json.loads(b.stderr.readline()).get("kind") != "lost_teammate":
            pass
        status, found, errors = asked(mdm, team, agents=1)
        assert (status, found["silent"], errors) == (1, ["a"], "mdm team status: no answer from a\n")
        status, output, errors = mdm("team", "stop", team)
        assert (status, output) == (1, ["joint: stop, said to b"])
        assert errors == "mdm team stop: joint: agent 'a' does not answer\n"


@pytest.mark.parametrize(
    ("states", "answers", "told"),
    [
        ({"a": {"live": ["a", "b"]}, "b": {"live": ["a", "b"]}}, {"a": "done"}, ["a: done"]),
        ({"a": {"live": ["a"]}, "b": {"live": ["b"]}}, {"a": "done", "b": "done"}, ["a: done", "b: done"]),
        (
            {"a": {"live": ["a", "b"], "role": "refused"}, "b": {"live": ["a", "b"], "role": "leading"}},
            {"a": Error("it was refused"), "b": "done"},
            ["a: agent 'a' does not start: it was refused", "b: done"],
        ),
        (
            {"a": {"live": ["a", "b"], "role": "leading"}, "b": {"live": ["a", "b"], "role": "refused"}},
            {"a": "done", "b": Error("it was refused")},
            ["a: done", "b: agent 'b' does not start: it was refused"],
        ),
        ({"b": Error("in another form")}, {"b": "done"}, ["a: agent 'a' does not answer", "b: done"]),
        ({"a": {"live": ["a"]}}, {}, ["a: agent 'a' does not answer", "b: agent 'b' does not answer"]),
    ],
)
def test_all_are_told_who_are_not_told_by_others(states, answers, told):
    class Asked:
        ensembles: ClassVar = {"joint": ["a", "b"]}

        async def ask(self, call, ensemble, agent):
            return {agent: answers[agent]} if agent in answers else {}

    results = asyncio.run(commands.tell(Asked(), "start", "joint", states))
    assert [f"{agent}: {problem or 'done'}" for _, agent, problem in results] == told


def test_the_operator_of_a_team_with_certificates_may_ask(mdm, free, up, tmp_path):
    pytest.importorskip("cryptography", reason="the extra mdm[certificates]")
    team = free(('name = "rooms"', 'name = "rooms"\naccess = "keys"'))
    team.write_text(team.read_text().replace("tcp/", "tls/"))
    assert mdm("team", "certificates", team, "-o", tmp_path / "keys")[0] == 0
    with up(team) as running:
        for agent in "ab":
            running.hear(agent=agent, event="running", actor=agent)
        assert asked(mdm, team)[0] == 0
        assert mdm("team", "stop", team)[0] == 0
        asked(mdm, team, mode="stopped")
        (tmp_path / "keys" / "operator.pem").unlink()
        status, _, errors = mdm("team", "status", team)
        assert status == 1
        assert "operator.pem" in errors
