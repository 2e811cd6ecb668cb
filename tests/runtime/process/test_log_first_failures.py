"""Where no log is written, the first failure of each action is printed."""

from __future__ import annotations

import asyncio

import pytest
from action_lives import robot

from mdm import Runtime, run
from mdm.messages import Fault


def broken():
    raise ValueError("gripper stuck")


async def slow():
    raise OSError("no motor")


def program(**options):
    async def main():
        async with Runtime(**options) as runtime:
            ensemble = robot({"Grip": broken, "Go": slow})
            await runtime.start(ensemble)
            for state in (0, 1, 0, 1, 0):
                ensemble.publish_state(state)
                await asyncio.sleep(0.01)
            runtime.faults.publish(Fault(0, "robot", "other", "something else"))

    return main


@pytest.mark.parametrize("virtual", [True, False])
def test_each_action_is_told_once(capfd, virtual):
    run(program(log=None), virtual=virtual)
    first, second = capfd.readouterr().err.splitlines()
    assert first.startswith("mdm: ensemble 'robot': action 'Grip' failed: ValueError: gripper stuck")
    assert second.startswith("mdm: ensemble 'robot': action 'Go' failed: OSError: no motor")


def test_silence_is_asked_for(capfd):
    run(program(log=False), virtual=True)
    assert capfd.readouterr().err == ""


def test_a_log_tells_it_once_alone(capfd):
    run(program(log="json"), virtual=True)
    assert capfd.readouterr().err.count("gripper stuck") == 3


def test_no_standard_error_hinders_nothing(monkeypatch):
    monkeypatch.setattr("sys.stderr", None)
    run(program(log=None), virtual=True)
