"""`mdm team up`: a process for each agent, and its end, however it comes."""

from __future__ import annotations

import os
import signal
import sys

import pytest
from team_processes import histories
from transports import free_port

PRINTING = (
    ("[predicates]\n", "[predicates]\n"),
    ('stay = "team_code:stay"\ngo = "team_code:go"', 'stay = "printing_code:stay"\ngo = "printing_code:go"'),
    ('tasks = ["team_code:sense"]', 'tasks = ["printing_code:sense"]'),
)

CODE = """
import asyncio, os

def stay():
    print("stay", flush=True)

def go():
    print("go", flush=True)

async def sense(system):
    print(f"pid {os.getpid()}", flush=True)
    for number in range(10**9):
        system.predicates.sense("InLab", number % 2 == (system.agent == "a"))
        await asyncio.sleep(0.2)
"""


@pytest.fixture
def team(free, tmp_path):
    (tmp_path / "printing_code.py").write_text(CODE)
    return free(*PRINTING)


def pid(record):
    return int(record["text"].split()[1])


@pytest.mark.slow
def test_agents_decide_together_and_end_in_order(team, up, tmp_path):
    with up(team, "--decisions", tmp_path / "decided") as running:
        for agent in "ab":
            running.hear(agent=agent, event="output", text="go", times=3)
        running.process.send_signal(signal.SIGINT)
        status, records = running.end()
    assert status == 130
    stopped = {record["actor"] for record in records if record["event"] == "stopped" and "actor" in record}
    assert stopped >= {"a", "b"}
    steps = histories(tmp_path / "decided")
    shared = steps["a"].keys() & steps["b"].keys()
    assert len(shared) >= 5
    assert all(steps["a"][step] == steps["b"][step] for step in shared)


@pytest.mark.slow
def test_an_agent_that_is_killed_is_started_again(team, up):
    with up(team) as running:
        first = running.hear(agent="b", event="output", text="go") and next(
            record for record in running.records if record["agent"] == "b" and record.get("text", "").startswith("pid")
        )
        os.kill(pid(first), signal.SIGKILL)
        told = running.hear(agent="b", event="failed")
        assert told["text"] == "was ended by SIGKILL, and is started again in 0.5 s"
        running.hear(agent="b", event="running", actor="b", times=2)
        running.hear(agent="a", event="fault", kind="lost_teammate")
        before = len([record for record in running.records if record.get("text") == "go" and record["agent"] == "b"])
        running.hear(agent="b", event="output", text="go", times=before + 3)
        running.process.send_signal(signal.SIGTERM)
        status, records = running.end()
    assert status == 1
    assert records[-1]["text"] == "mdm team up: agent 'b' failed 1 time\n"


@pytest.mark.slow
def test_seconds_end_it(team, up):
    with up(team, "--seconds", "1.5") as running:
        status, records = running.end()
    assert status == 0
    assert not [record for record in records if record["event"] == "failed"]


@pytest.mark.slow
def test_an_agent_that_cannot_start_ends_with_its_reason_and_the_others_go_on(team, up):
    team.write_text(team.read_text().replace('tasks = ["printing_code:sense"]', 'tasks.b = ["nowhere:sense"]'))
    with up(team) as running:
        running.hear(event="failed", text="has failed with status 1 before it was up, and is not started again")
        running.hear(agent="a", event="fault", kind="missing_teammate")
        running.process.send_signal(signal.SIGINT)
        status, records = running.end()
    assert status == 1
    assert any("there is no module 'nowhere'" in record.get("text", "") for record in records)
    assert records[-1]["text"] == "mdm team up: agent 'b' failed 1 time\n"


def test_a_port_that_somebody_has_is_told_in_a_sentence(mdm, team):
    import socket

    from mdm.config import load_team

    ours = load_team(team).agents[1].endpoint
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", int(ours.rpartition(":")[2])))
        taken.listen()
        status, _, errors = mdm("team", "up", team)
    assert status == 1
    assert f"agent 'b' cannot listen at {ours}: Address already in use; perhaps the team runs already" in errors


def test_two_agents_that_want_one_port_of_this_machine_are_told(mdm, team):
    """In two containers they may have one."""
    port = free_port()
    text = team.read_text().replace("endpoint = ", f'listen = "tcp/0.0.0.0:{port}", connect = ')
    team.write_text(text)
    assert mdm("team", "check", team)[0] == 0
    status, _, errors = mdm("team", "up", team)
    assert status == 1
    assert f"agent 'b' cannot listen at tcp/0.0.0.0:{port}: Address already in use; " in errors


@pytest.mark.parametrize(
    ("endpoint", "words"),
    [
        ("tcp/192.0.2.7:7447", "run it on the machine that has this address: mdm team run FILE --agent a"),
        ("quic/192.0.2.7:7447", "run it on the machine that has this address: mdm team run FILE --agent a"),
        ("tcp/robot.invalid:7447", "no host 'robot.invalid' is known"),
    ],
)
def test_an_address_of_another_machine_is_told_in_a_sentence(mdm, team, endpoint, words):
    from mdm.config import load_team

    team.write_text(team.read_text().replace(load_team(team).agents[0].endpoint, endpoint))
    status, _, errors = mdm("team", "up", team)
    assert (status, words in errors) == (1, True)
    assert errors.count("\n") == 1


def test_without_zenoh_no_process_is_started(mdm, team, monkeypatch):
    monkeypatch.setitem(sys.modules, "zenoh", None)
    status, _, errors = mdm("team", "up", team)
    assert status == 1
    assert errors.startswith("mdm team up: processes of a team talk through Zenoh, which is not installed: pip install")


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["up"], 2, "usage: mdm team up"),
        (["up", "nowhere.toml"], 1, "mdm team up: nowhere.toml: there is no such file"),
        (["up", "FILE", "--seconds", "0"], 2, "a number of seconds above 0 was expected, not '0'"),
        (["up", "FILE", "--log", "xml"], 2, "invalid choice"),
        (["up", "FILE", "--decisions", "FILE"], 1, "decisions cannot be written to"),
        (["up", "FILE", "--decisions", "FILE"], 1, "that is a file, and no folder"),
        (["up", "FILE", "--decisions", ""], 1, "--decisions names no folder"),
        (["upp", "FILE"], 2, "invalid choice: 'upp'"),
        ([], 2, "usage: mdm team"),
    ],
)
def test_wrong_usage(mdm, team, arguments, status, words):
    given = [str(team) if argument == "FILE" else argument for argument in arguments]
    found, _, errors = mdm("team", *given)
    assert found == status
    assert words in errors
    assert "Traceback" not in errors


@pytest.fixture
def certified(mdm, free, tmp_path):
    """A team with certificates; that of its operator is good for a name and for this machine."""
    pytest.importorskip("cryptography", reason="the extra mdm[certificates]")
    pytest.importorskip("websockets", reason="the extra mdm[page]")
    team = free(('name = "rooms"', 'name = "rooms"\naccess = "keys"'))
    team.write_text(team.read_text().replace("tcp/", "tls/"))
    hosts = ["--host", "robots.test", "--host", "127.0.0.1"]
    assert mdm("team", "certificates", team, "-o", tmp_path / "keys", *hosts)[0] == 0
    return team


def test_a_page_has_the_hosts_of_the_operator_s_certificate(mdm, certified, tmp_path):
    page = ["--page", free_port()]
    status, _, errors = mdm(
        "team", "up", certified, *page, "--page-host", "192.0.2.1", "--decisions", tmp_path / "decided"
    )
    assert (status, "operator.pem is a certificate of robots.test, 127.0.0.1" in errors) == (1, True)
    assert not (tmp_path / "decided").exists()  # nothing stands in the way of the next try


@pytest.mark.slow
def test_a_team_with_certificates_opens_its_page_to_other_machines(mdm, certified, up, tmp_path):
    with up(certified, "--page", free_port(), "--page-host", "0.0.0.0", "--debug") as running:
        for agent in "ab":
            running.hear(agent=agent, event="running", actor=agent)
        (address,) = (
            record["text"].removeprefix("page: ").strip()
            for record in running.records
            if record.get("text", "").startswith("page: https")
        )
        assert address.startswith("https://robots.test:")
        status, told, errors = mdm(
            "watch",
            address.replace("robots.test", "127.0.0.1"),
            "--authority",
            tmp_path / "keys" / "authority.pem",
            "--once",
        )
    assert (status, errors) == (0, "")
    assert "a/joint" in "\n".join(told)


@pytest.mark.parametrize("option", [["--page-control"], ["--page-host", "0.0.0.0"], ["--page-access", "keys/operator"]])
def test_options_of_a_page_are_for_a_page(mdm, team, option):
    status, _, errors = mdm("team", "up", team, *option)
    assert status == 2
    assert f"{option[0]} is for a page: say --page, too" in errors


def test_a_team_without_certificates_keeps_its_page_to_itself(mdm, team):
    pytest.importorskip("websockets", reason="the extra mdm[page]")
    status, _, errors = mdm("team", "up", team, "--page", "--page-host", "0.0.0.0")
    assert status == 1
    assert "a page for other machines needs TLS" in errors
    assert errors.count("\n") == 1


def test_decisions_of_another_run_are_not_written_over(mdm, team, tmp_path):
    (tmp_path / "b.jsonl").write_text("")
    status, _, errors = mdm("team", "up", team, "--decisions", tmp_path)
    assert (status, "b.jsonl is there already" in errors) == (1, True)


def test_decisions_that_cannot_be_written_are_told_before_anything_starts(mdm, team, tmp_path):
    (tmp_path / "decided").mkdir()
    (tmp_path / "decided" / "b.jsonl").symlink_to(tmp_path / "nowhere" / "b.jsonl")
    status, printed, errors = mdm("team", "up", team, "--decisions", tmp_path / "decided")
    assert (status, printed) == (1, [])
    assert errors.count("\n") == 1
    assert "decided/b.jsonl" in errors


def test_problems_are_told_once_and_not_by_each_agent(mdm, team):
    team.write_text(team.read_text().replace('owner = "b"', 'owner = "c"'))
    status, _, errors = mdm("team", "up", team)
    assert status == 1
    assert errors.count("has no agent 'c'") == 1


def test_a_file_without_a_team(mdm):
    from places import EXAMPLES

    status, _, errors = mdm("team", "up", EXAMPLES / "tiger.toml")
    assert status == 2
    assert "describes no team: a table [team] is missing" in errors
