"""`mdm team status`, `stop`, `reset`, `start` and `release` of a team that runs, and of one that does not."""

from __future__ import annotations

import json
import signal
import time

import msgspec
import pytest
from patience import PATIENCE

from mdm.cli.team.status import _doubles
from mdm.team.team import Team


def lines(output):
    """The lines of a table, word by word."""
    return [line.split() for line in output]


def asked(mdm, team, *, agents=2, mode="deciding"):
    """Ask until so many agents have this mode, and those that decide see each other."""
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        status, output, errors = mdm("team", "status", team, "--json")
        found = json.loads(output[0])
        there = [one["joint"] for one in found["agents"].values()]
        settled = status == 0 or mode != "deciding" or agents < 2
        if settled and len(there) == agents and all(one["mode"] == mode and one.get("step") for one in there):
            return status, found, errors
    raise AssertionError((found, errors))


@pytest.mark.slow
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
        assert output[0].endswith("  action")
        assert output[1].split()[:3] == ["a", "joint", "deciding"]
        assert "(waits for InLab, room_b (of b))" in output[1]  # nobody has told where it is
        status, output, errors = mdm("team", "stop", team)
        assert (status, errors) == (0, "")
        assert lines(output)[0] == ["agent", "ensemble", "mode", "role", "term", "step", "confirmed"]
        assert [[*line[:4], line[-1]] for line in lines(output)[1:]] == [
            ["a", "joint", "stopped", "leading", "yes"],
            ["b", "joint", "stopped", "following", "yes"],
        ]
        assert {one["joint"]["mode"] for one in asked(mdm, team, mode="stopped")[1]["agents"].values()} == {"stopped"}
        status, output, _ = mdm("team", "start", team, "--ensemble", "joint")
        assert (status, [line[2] for line in lines(output)[1:]]) == (0, ["deciding", "deciding"])
        assert mdm("team", "reset", team)[0] == 0
        assert mdm("team", "release", team)[0] == 0
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
        while not (output := mdm("team", "status", team)[1]):
            pass  # on a busy machine it is not reached at once
        status, output, errors = mdm("team", "status", team)
        assert (status, output[1].split()[:4]) == (1, ["a", "joint", "stopped", "(waits"])
        never = "mdm team status: joint: agent 'a' has never met b, and waits for a start\n"
        assert errors == f"{never}mdm team status: no answer from b\n"
        while (told := mdm("team", "start", team, "--wait", "3"))[1] == []:
            pass
        assert (told[0], lines(told[1])[1][:4]) == (1, ["a", "joint", "deciding", "leading"])
        status, _, errors = asked(mdm, team, agents=1)  # a person has said that it goes on without b
        assert status == 1
        assert errors == "mdm team status: no answer from b\n"
        status, output, errors = mdm("team", "stop", team, "--wait", "1")
        assert (status, [line[-1] for line in lines(output)]) == (1, ["confirmed", "yes", "no"])
        assert errors == "mdm team stop: joint: agent 'b' did not confirm: it does not answer\n"


@pytest.mark.slow
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
        status, output, errors = mdm("team", "stop", team, "--wait", "2")
        assert (status, [line[-1] for line in lines(output)]) == (1, ["confirmed", "no", "yes"])
        assert errors == "mdm team stop: joint: agent 'a' did not confirm: it does not answer\n"


@pytest.mark.slow
def test_the_operator_of_a_team_with_certificates_may_ask(mdm, free, up, tmp_path):
    pytest.importorskip("cryptography", reason="the extra mdm[certificates]")
    team = free(('name = "rooms"', 'name = "rooms"\naccess = "keys"'))
    team.write_text(team.read_text().replace("tcp/", "tls/"))
    assert mdm("team", "certificates", team, "-o", tmp_path / "keys")[0] == 0
    with up(team) as running:
        for agent in "ab":
            running.hear(agent=agent, event="running", actor=agent)
        status, found, _ = asked(mdm, team)
        assert status == 0
        assert [29 < one["joint"]["certificate"] < 30.1 for one in found["agents"].values()] == [True, True]
        assert mdm("team", "status", team)[1][0].endswith("  certificate (days)")
        assert mdm("team", "stop", team)[0] == 0
        asked(mdm, team, mode="stopped")
        (tmp_path / "keys" / "operator.pem").unlink()
        status, _, errors = mdm("team", "status", team)
        assert status == 1
        assert "operator.pem" in errors


@pytest.mark.parametrize(("days", "told"), [(5.0, ["'a'", "'operator'"]), (8.0, [])])
def test_certificates_that_end_soon_are_told(days, told):
    from mdm.cli.team import status

    found = {"a": {"joint": {"certificate": days, "mode": "deciding", "causes": [], "live": ["a"]}}, "b": {"joint": {}}}
    words = "warning: the certificate of {}, or of the authority that signed it, ends in 5.0 days"
    assert list(status._ending(found, days)) == [words.format(name) for name in told]
    assert list(status._ending(found, None)) == [words.format(name) for name in told[:1]]
    assert status._row("a", "joint", found["a"]["joint"])[-1] == f"{days}"


def test_times_that_cannot_be_are_not_shown():
    from mdm.cli.team import status
    from mdm.runtime.statistics import Latencies

    def told(late, ahead):
        latencies = Latencies()
        latencies.record(late)
        traffic = {"lateness": msgspec.to_builtins(latencies.snapshot()), "dropped": {}, "sent": {}, "received": {}}
        clocks = {"b": {"seconds": status._plausible(ahead), "error": 0.001}, "c": {"seconds": 0.002, "error": 0.001}}
        shown = {"mode": "deciding", "causes": [], "live": ["a"], "clocks": clocks, **status._carried(traffic)}
        return status._row("a", "joint", shown)[7:9]

    assert told(2_000_000, -0.5) == ["2.0, 2.0", "-500.0"]
    assert told(2**62, -(2.0**62) / 1e9) == ["more than a day, more than a day", "more than a day"]


@pytest.mark.parametrize(("idle", "told"), [(None, "deciding"), (12.4, "deciding (idle for 12 s)"), (1e9, "deciding")])
def test_what_has_nothing_to_do_says_for_how_long(idle, told):
    from mdm.cli.team import status

    assert status._row("a", "joint", {"mode": "deciding", "causes": [], "live": ["a"], "idle": idle})[2] == told


def test_what_it_waits_for_stands_beside_the_mode():
    from mdm.cli.team import status

    shown = {"mode": "deciding", "causes": [], "live": ["a"], "idle": None, "waiting": ["agent b", "room_b (of b)"]}
    assert status._row("a", "joint", shown)[2] == "deciding (waits for agent b, room_b (of b))"


def test_a_second_robot_is_never_told_to_be_at_the_address_of_the_first():
    team = Team("pair", [("ada", "tcp/10.0.0.1:7447"), ("bob", "tcp/10.0.0.2:7447")])
    here, elsewhere = "tcp/10.0.0.1:7447", "tcp/10.0.0.9:7447"
    found = {"ada": {"joint": {"doubles": {"ada": elsewhere}}}, "bob": {"joint": {"doubles": {"ada": here}}}}
    assert _doubles(found, team) == [f"two robots are called ada: at {here} and {elsewhere}"]


@pytest.mark.slow
def test_a_second_robot_of_a_name_is_told_by_the_pair_and_by_the_status(mdm, free, up, tmp_path):
    """Where its endpoint is another one nobody connects to it, so that it has to ask; else it is refused."""
    from programs import python
    from transports import endpoint

    team = free()
    with up(team) as running:
        asked(mdm, team)
        lists = team.read_text().splitlines()
        [agents] = [line for line in lists if line.startswith("agents")]
        first, second = endpoint(), endpoint()
        for agent, own in (("a", first), ("b", second)):
            there = agents.split(f'name = "{agent}", endpoint = "')[1].split('"')[0]
            other = tmp_path / f"{agent}.toml"
            other.write_text(team.read_text().replace(there, own))
            told = f"two robots are called '{agent}': at {there} and {own}"
            with python("-m", "mdm", "team", "run", other, "--agent", agent, "--log", "json") as double:
                running.hear(kind="duplicate", agent="b" if agent == "a" else "a", detail=told)
                status, _, errors = mdm("team", "status", team)
                assert status == 1
                assert f"mdm team status: {told.replace(chr(39), '')}\n" in errors
                if agent == "a":
                    lines = iter(double.stderr.readline, "")
                    said = next(line for line in map(json.loads, lines) if line.get("kind") == "duplicate")
                    assert said["detail"] == f"two robots are called 'a': at {own} and {there}"
                else:
                    assert "an agent 'b' of team 'rooms' is live already" in double.communicate(timeout=PATIENCE)[1]
