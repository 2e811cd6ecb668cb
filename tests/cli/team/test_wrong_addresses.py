"""Robots with a mistake in their addresses, as processes with a file each: none acts, and `mdm team status` says so."""

from __future__ import annotations

import time

import pytest
from patience import PATIENCE
from programs import python
from team_file import write
from team_processes import Up
from transports import endpoint

pytest.importorskip("zenoh")

CODE = """
import asyncio

def stay():
    print("acts", flush=True)

go = stay

async def sense(system):
    for number in range(10**9):
        system.predicates.sense("InLab", number % 2 == 0)
        await asyncio.sleep(0.05)
"""

A, B = endpoint(), endpoint()

KINDS = {
    "another port": {"a": endpoint()},
    "another order": {"order": "ba"},
    "another name of the team": {"name": "roms"},
    "every address of a machine": {"a": A.replace("127.0.0.1", "0.0.0.0")},
    "the port of the other": {"a": endpoint(), "b": A},  # one of the two has it, and the other one ends
    "an address of nobody": {"a": "tcp/192.0.2.7:7447"},
}
"""What bob's file says and ada's does not."""

MODES = ["replicated", "centralised"]


def file(folder, mode, *, name="rooms", order="ab", a=A, b=B):
    """Write the team's file of one robot, in a folder of its own."""
    folder.mkdir()
    ends = {"a": a, "b": b}
    agents = ", ".join(f'{{ name = "{agent}", endpoint = "{ends[agent]}" }}' for agent in order)
    team = f'name = "{name}"\nmode = "{mode}"\nagents = [{agents}]\n'
    path = write(folder, ('name = "rooms"\nagents = ["a", "b"]\nport = 7600\n', team))
    (folder / "team_code.py").write_text(CODE)
    return path


def settle(up):
    """Wait until an agent misses the other, or has ended; return how it ended."""
    until = time.monotonic() + PATIENCE
    with up._came:
        while not any(one.get("kind") == "missing_teammate" for one in up.records):
            if up.process.poll() is not None:
                break
            assert time.monotonic() < until, up.records
            up._came.wait(0.1)  # the end of a process is no word of it
    return up.process.poll()


def acted(up):
    return any("acts" in one.get("text", "") for one in up.records)


def running(path, agent):
    return python("-m", "mdm", "team", "run", path, "--agent", agent, "--log", "json")


def refused(mdm, tmp_path, mode, wrong):
    """Run both robots until each has noticed; check that neither acts, and that who asks is told."""
    ours, theirs = file(tmp_path / "ada", mode), file(tmp_path / "bob", mode, **wrong)
    with running(ours, "a") as one, running(theirs, "b") as other:
        ups = Up(one), Up(other)
        assert {settle(up) for up in ups} <= {None, 1}
        status, _, errors = mdm("team", "status", ours)
        assert status == 1, errors
        for process in (one, other):
            process.terminate()
        for up in ups:
            up.end()
        assert not any(acted(up) for up in ups)


def test_where_one_would_connect_to_every_address_no_robot_acts(mdm, tmp_path):
    refused(mdm, tmp_path, "replicated", KINDS["every address of a machine"])


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("kind", KINDS)
def test_with_wrong_addresses_no_robot_acts(mdm, tmp_path, mode, kind):
    refused(mdm, tmp_path, mode, KINDS[kind])


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
def test_with_right_addresses_both_robots_act(mdm, tmp_path, mode):
    ours, theirs = file(tmp_path / "ada", mode), file(tmp_path / "bob", mode)
    with running(ours, "a") as one, running(theirs, "b") as other:
        ups = Up(one), Up(other)
        for up in ups:
            up.hear(event="line", text="acts\n", times=3)
        until = time.monotonic() + PATIENCE
        while mdm("team", "status", ours)[0] != 0:
            assert time.monotonic() < until
        for process in (one, other):
            process.terminate()
        for up in ups:
            up.end()
