"""Commands in every mode: what was asked of an agent that was cut off, and what holds after healing."""

from __future__ import annotations

import asyncio

import pytest
from team_robots import over_beliefs, started, three

from mdm.team.sharing.calls import ask
from mdm.team.sharing.commanding import Commands
from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.testing import run_virtual

NAMES = ["r0", "r1", "r2"]
MODES = ["replicated", "centralised", "communicating"]


class Reached(Network):
    """A network in which the operator's console reaches everybody, unless it is on a side of its own."""

    def connected(self, first, second):
        if "console" in {first, second} and "console" not in self._sides:
            return first in self._open and second in self._open
        return super().connected(first, second)


class Squad:
    """Three robots that decide every half second, in virtual time."""

    def __init__(self, runtime, mode, controller="r2"):
        self.runtime = runtime
        more = {"controller": controller} if mode == "centralised" else {}
        self.team = Team("squad", NAMES, mode=mode, period=0.5, lease=0.5, **more)
        self.network = Reached(runtime.clock, team="squad")

    async def begin(self):
        self.robots = dict(zip(NAMES, await started(self.runtime, self.team, self.network, self.build), strict=True))
        await asyncio.sleep(3.0)
        assert self.modes == ["deciding"] * 3
        return self

    def build(self, robot, agent):
        return over_beliefs(three())(robot, agent)

    @property
    def modes(self):
        return [robot.ensemble.mode for robot in self.robots.values()]

    def tell(self, command, *agents):
        for agent in agents:
            getattr(self.robots[agent].ensemble, command)()

    async def cut(self, agent):
        self.network.partition({agent}, {*NAMES} - {agent})
        await asyncio.sleep(3.0)

    async def heal(self):
        self.network.heal()
        await asyncio.sleep(5.0)

    async def begun(self, seconds):
        """Return how many actions each robot begins within a time."""
        before = {name: len(robot.did) for name, robot in self.robots.items()}
        await asyncio.sleep(seconds)
        return [len(robot.did) - before[name] for name, robot in self.robots.items()]

    def void(self, agent):
        return [fault.detail for fault in self.robots[agent].faults if fault.kind == "void_command"]


@pytest.mark.parametrize("asked", ["start", "reset"])
@pytest.mark.parametrize("mode", MODES)
def test_what_was_asked_of_an_agent_that_was_cut_off_starts_nobody_after_healing(mode, asked):
    async def main(runtime):
        squad = await Squad(runtime, mode).begin()
        squad.tell("stop", "r0")
        await asyncio.sleep(2.0)
        assert squad.modes == ["stopped"] * 3
        squad.tell("start", "r1")
        await asyncio.sleep(2.0)
        await squad.cut("r0")
        squad.tell("stop", "r0", "r1")
        await asyncio.sleep(2.0)
        squad.tell(asked, "r0")
        await asyncio.sleep(20.0)
        assert squad.modes[1:] == ["stopped"] * 2
        await squad.heal()
        assert squad.modes == ["stopped"] * 3
        assert await squad.begun(5.0) == [0, 0, 0]
        if asked == "start":
            assert any(text.startswith("start, asked for at r0, is void: ") for text in squad.void("r0"))
        squad.tell("start", *NAMES)
        await asyncio.sleep(3.0)
        assert squad.modes == ["deciding"] * 3
        assert all(await squad.begun(5.0))

    run_virtual(main)


@pytest.mark.parametrize("mode", MODES)
def test_an_agent_that_heard_a_stop_while_it_was_cut_off_holds_it_after_healing(mode):
    async def main(runtime):
        squad = await Squad(runtime, mode).begin()
        await squad.cut("r0")
        squad.tell("stop", "r0")
        assert squad.modes[0] == "stopped"
        await asyncio.sleep(3.0)
        squad.tell("start", "r1")  # by somebody who knows nothing of the stop
        await squad.heal()
        assert squad.modes[0] == "stopped"
        assert (await squad.begun(10.0))[0] == 0
        squad.tell("start", "r1")  # who knows of it now
        await asyncio.sleep(3.0)
        assert squad.modes == ["deciding"] * 3
        assert all(await squad.begun(5.0))

    run_virtual(main)


def test_a_robot_that_holds_says_why():
    async def main(runtime):
        squad = await Squad(runtime, "replicated").begin()
        await squad.cut("r0")
        squad.tell("stop", "r0")
        await squad.heal()
        assert squad.modes == ["stopped", "deciding", "deciding"]
        [told] = squad.void("r0")
        assert told == (
            "stop, asked for at r0, is void: the term in which it was asked for has ended; this agent stays stopped "
            "until a start is asked for"
        )
        held = [fault.detail for fault in squad.robots["r0"].faults if fault.kind == "held"]
        assert held == ["r0 was stopped, and stays so while the team decides: start the team again"]

    run_virtual(main)


@pytest.mark.parametrize("mode", ["replicated", "centralised"])
def test_who_is_stopped_with_all_others_is_not_told_to_be_held(mode):
    async def main(runtime):
        squad = await Squad(runtime, mode).begin()
        console = squad.network.transport("console")
        await console.open()

        async def held():
            status = await ask(console, squad.team, "status", ensemble="joint")
            return [status[name]["held"] for name in NAMES]

        squad.tell("stop", *NAMES)
        await asyncio.sleep(2.0)
        assert (squad.modes, await held()) == (["stopped"] * 3, [False] * 3)
        squad.tell("start", "r1")
        await asyncio.sleep(2.0)
        await squad.cut("r0")
        squad.tell("stop", "r0")
        await squad.heal()
        assert (squad.modes, await held()) == (["stopped", "deciding", "deciding"], [True, False, False])

    run_virtual(main)


@pytest.mark.parametrize("mode", MODES)
def test_a_controller_or_leader_that_comes_back_starts_nobody_who_was_stopped(mode):
    async def main(runtime):
        squad = await Squad(runtime, mode, controller="r0").begin()
        squad.tell("stop", "r1")
        await asyncio.sleep(2.0)
        squad.network.crash("r0")
        await asyncio.sleep(3.0)
        await runtime.stop(squad.robots["r0"].member)
        [back] = await started(runtime, squad.team, squad.network, squad.build, names=["r0"])
        squad.robots["r0"] = back
        await asyncio.sleep(5.0)
        assert squad.modes[1:] == ["stopped"] * 2
        assert (await squad.begun(10.0))[1:] == [0, 0]
        squad.tell("start", *NAMES)
        await asyncio.sleep(3.0)
        assert squad.modes == ["deciding"] * 3

    run_virtual(main)


def test_outcomes_are_kept_by_token_and_forgotten_in_order():
    commands = Commands("a", 255)
    first = commands.ask("start", None)
    assert commands.ask("stop", "x") == "x"
    assert (first, commands.name("x"), commands.name("y")) == ("a.ff.1", "stop", "a command")
    commands.done("x")
    commands.void(first, "it is late")
    commands.done("")
    assert commands.outcomes == {"x": "done", first: "void: it is late"}
    for number in range(40):
        commands.ask("reset", str(number))
    assert list(commands.outcomes) == [str(number) for number in range(8, 40)]
    assert commands.name("x") == "a command"
