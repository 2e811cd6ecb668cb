"""The page of the design: its drawing of the house, and the way of a value through it, against the code."""

from __future__ import annotations

import asyncio
import re
import sys
from contextlib import contextmanager
from pathlib import Path

import blocks
from team_robots import Robot, over_beliefs, tigers

import mdm
from mdm import Ensemble, PredicateManager, StateFactor, problems
from mdm.policies import DeterministicPolicy
from mdm.team.transport.network import Network
from mdm.testing import run_virtual

PACKAGE = Path(mdm.__file__).parent


def drawn():
    """Return the folders and modules that the drawing names, as paths."""
    [drawing] = blocks.texts("docs/design.md", "text", "\n## 6. Layout\n", "\n### ")
    drawing = drawing.removeprefix("mdm/\n")
    found, top = set(), ""
    for line in drawing.splitlines():
        indent = len(line) - len(line.lstrip())
        if indent == 2:
            top = line.split()[0]
            found.add(top)
        elif indent == 4:
            found |= {top + word for word in re.match(r"\S+/(?: \S+/)*|\S+", line.strip())[0].split()}
    return found


def test_the_drawing_names_each_folder_of_the_package_and_nothing_else():
    folders = {f"{path.parent.relative_to(PACKAGE).as_posix()}/" for path in PACKAGE.glob("**/__init__.py")} - {"./"}
    modules = {path.name for path in PACKAGE.glob("*.py")} - {"__main__.py"}
    named = drawn()
    assert {name for name in named if name.endswith(".py")} == modules
    assert {name for name in named if name.endswith("/")} == folders


class Calls(list):
    """The functions of the package that are called, in their order, as pairs of a module and a name."""

    def note(self, frame, event, _):
        path = Path(frame.f_code.co_filename)
        if event == "call" and path.is_relative_to(PACKAGE):
            self.append((path.relative_to(PACKAGE).as_posix(), frame.f_code.co_qualname))

    @contextmanager
    def noted(self):
        sys.setprofile(self.note)
        try:
            yield
        finally:
            sys.setprofile(None)


def walked():
    """Return the functions of the package that run when a sensor is set, in their order."""
    manager = PredicateManager()
    sensor = manager.sensor("Warm")
    robot = Ensemble(
        "robot",
        policy=DeterministicPolicy([0, 1]),
        actions={"Rest": lambda: None, "Work": lambda: None},
        predicates=manager,
        states=[StateFactor("warm", ["Warm"])],
        safe_action="Rest",
    )
    calls = Calls()

    async def main():
        async with mdm.Runtime(log=False) as runtime:
            await runtime.start(robot)
            for count in range(6):
                sensor.set(count % 2 == 0)
                await asyncio.sleep(0)
            with calls.noted():
                sensor.set(True)

    asyncio.run(main())
    return calls


def told(number):
    """Return the lines of a way that the page tells."""
    return blocks.texts("docs/design.md", "text", "### A value's way through it")[number - 1].splitlines()


def test_the_way_of_a_value_is_the_one_that_is_told():
    assert walked() == [tuple(line.split()[:2]) for line in told(1)]


def stepped():
    """Return the calls of a joint step of two agents that agree, from what the second has seen to both callbacks."""
    calls, team = Calls(), tigers()

    async def main(runtime):
        network = Network(runtime.clock, team="tigers", delay=0.0001)
        robots = [Robot(team, name, network, over_beliefs(problems.dec_tiger())) for name in team.names]
        for robot in robots:  # and nobody listens to what was agreed on, which is not the agents' own
            await runtime.start(robot.member)
        await asyncio.sleep(0.5)
        for observation in (0, 1, 0):
            robots[1].observe(None, observation)
            await asyncio.sleep(0.123)
        with calls.noted():
            robots[1].observe(None, 1)
            await asyncio.sleep(0.005)

    run_virtual(main)
    # Between processes there are neither a network in this one nor virtual time.
    left_out = ("runtime/time/", "runtime/process/", "testing", "team/transport/network")
    return [(module, name) for module, name in calls if not module.startswith(left_out)]


def test_the_way_of_a_joint_step_goes_through_the_modules_that_are_told():
    # Which filter there is depends on what is installed.
    modules = [module for module, _ in stepped() if not module.startswith(("runtime/", "beliefs/"))]
    assert list(dict.fromkeys(modules)) == [line.split()[0] for line in told(2)]


def test_a_joint_step_takes_no_more_calls_than_it_did():
    calls = stepped()
    own = [module for module, _ in calls if not module.startswith("beliefs/")]  # of which there are some for each model
    assert len(own) <= 172
    assert len({*own}) <= 21
    names = [name for _, name in calls]
    assert names.index("Packer.pack") <= 24  # from the observation to the wire
    received = names[names.index("Unpacker.unpack") : names.index("Agreement.receive")]
    assert len(received) <= 6  # from the wire to the agreement
