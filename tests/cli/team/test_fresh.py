"""`mdm team up` after a stop: everybody is stopped as before, and `--fresh` forgets that, and says so."""

from __future__ import annotations

import os
import re
import signal
import socket
from argparse import Namespace

import pytest
from cli.team.test_up import CODE, PRINTING, pid
from team.test_storage import KEPT

from mdm.cli.team.file import forget_state
from mdm.cli.team.up import _command, run_agent
from mdm.errors import Error
from mdm.team.storage import path_of, write


def test_what_agents_forget_is_said(free, capsys):
    team = free()
    for agent in "ab":
        write(path_of(team.parent, "rooms", agent), "rooms", agent, KEPT)
    forget_state(str(team), ["a"])
    told = capsys.readouterr().err
    assert told.startswith("mdm team: agent 'a' forgets: joint stopped since 2023-11-1")
    assert told.count("\n") == 1
    assert [path_of(team.parent, "rooms", agent).exists() for agent in "ab"] == [False, True]
    forget_state(str(team), ["a"])
    assert capsys.readouterr().err == ""


def test_an_agent_that_is_started_again_after_a_failure_forgets_nothing():
    arguments = Namespace(file="team.toml", record=None, debug=False, fresh=True)
    assert "--fresh" not in _command(arguments, "a", None)


def test_an_agent_that_runs_and_was_stopped_is_not_forgotten_by_a_second_process(free):
    team = free()
    [port] = re.findall(r'"a".*?:(\d+)"', team.read_text())
    kept = path_of(team.parent, "rooms", "a")
    write(kept, "rooms", "a", KEPT)
    with socket.create_server(("127.0.0.1", int(port))), pytest.raises(Error, match="agent 'a' cannot listen at"):
        run_agent(Namespace(file=str(team), agent="a", fresh=True))
    assert kept.exists()


@pytest.mark.slow
def test_a_team_that_was_stopped_is_stopped_when_its_processes_come_back(mdm, free, up, tmp_path):
    (tmp_path / "printing_code.py").write_text(CODE)
    team = free(*PRINTING)

    def go(running):
        for agent in "ab":
            running.hear(agent=agent, event="output", text="go", times=2)

    with up(team) as running:
        go(running)
        assert mdm("team", "stop", team)[0] == 0
        for agent in "ab":
            [told] = [r for r in running.records if r["agent"] == agent and r.get("text", "").startswith("pid")]
            os.kill(pid(told), signal.SIGKILL)
        for agent in "ab":
            running.hear(agent=agent, event="fault", kind="held")
        _, output, _ = mdm("team", "status", team)
        assert [line.split()[2:5:2] for line in output[1:]] == [["stopped", "20"]] * 2 or "stopped (since 20" in output[
            1
        ]
        running.process.send_signal(signal.SIGINT)
        _, records = running.end()
    with up(team) as running:
        for agent in "ab":
            running.hear(agent=agent, event="fault", kind="held")
        running.process.send_signal(signal.SIGINT)
        _, records = running.end()
        assert not [record for record in records if record.get("text") in {"go", "stay"}]
    with up(team, "--fresh") as running:
        go(running)
        running.process.send_signal(signal.SIGINT)
        _, records = running.end()
    assert sum("forgets: joint stopped since 20" in record.get("text", "") for record in records) == 2
