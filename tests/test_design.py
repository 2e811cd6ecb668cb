"""The page of the design: its drawing of the house, and the way of a value through it, against the code."""

from __future__ import annotations

import asyncio
import re
import sys
from pathlib import Path

from places import ROOT

import mdm
from mdm import Ensemble, PredicateManager, StateFactor
from mdm.policies import DeterministicPolicy

PACKAGE = Path(mdm.__file__).parent
DESIGN = (ROOT / "docs" / "design.md").read_text()


def drawn():
    """Return the folders and modules that the drawing names, as paths."""
    drawing = DESIGN.split("```\nmdm/\n", 1)[1].split("```", 1)[0]
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
    calls = []

    def note(frame, event, _):
        path = Path(frame.f_code.co_filename)
        if event == "call" and path.is_relative_to(PACKAGE):
            calls.append((path.relative_to(PACKAGE).as_posix(), frame.f_code.co_qualname))

    async def main():
        async with mdm.Runtime(log=False) as runtime:
            await runtime.start(robot)
            for count in range(6):
                sensor.set(count % 2 == 0)
                await asyncio.sleep(0)
            sys.setprofile(note)
            sensor.set(True)
            sys.setprofile(None)

    asyncio.run(main())
    return calls


def test_the_way_of_a_value_is_the_one_that_is_told():
    section = DESIGN.split("### A value's way through it", 1)[1]
    lines = section.split("```text\n", 1)[1].split("```", 1)[0].splitlines()
    assert walked() == [tuple(line.split()[:2]) for line in lines]
