"""A small robot of two levels, to be looked at: a file with code of its own, and a script of what happens to it."""

from __future__ import annotations

import sys

FILE = """
tasks = ["{module}:live"]

[predicates]
Low = {{ initial = false }}
Near = {{ max_age = 0.5, initial = false }}
Quiet = "not Near"

[ensembles.top]
policy = [0, 1]
safe_action = "{module}:halt"

[ensembles.top.states]
battery = {{ low = "Low" }}

[ensembles.top.actions]
0 = {{ ensemble = "walk" }}
1 = "{module}:charge"

[ensembles.walk]
policy = [0, 1]
on_lost_input = "safe"
safe_action = "{module}:halt"

[ensembles.walk.states]
near = {{ yes = "Near" }}

[ensembles.walk.actions]
0 = "{module}:go"
1 = {{ call = "{module}:wait", then = "wait" }}
"""

CODE = """
import asyncio

def halt(): pass

async def go(): await asyncio.sleep(60)

async def wait(): await asyncio.sleep(0.4)

async def charge(): await asyncio.sleep(1.3)

async def live(system):
    near = False
    for step in range(200):
        if step % 30 == 20:
            system.predicates.sense("Low", True)
        elif step % 30 == 24:
            system.predicates.sense("Low", False)
        if step % 7 == 3:
            near = not near
        if not 100 < step < 110:
            system.predicates.sense("Near", near)
        await asyncio.sleep(0.2)
"""


def a_robot(folder, module="shown_robot"):
    """Write the robot to a folder; return its file."""
    (folder / f"{module}.py").write_text(CODE)
    file = folder / "robot.toml"
    file.write_text(FILE.format(module=module))
    sys.modules.pop(module, None)
    return file
