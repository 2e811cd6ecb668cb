"""The errand of the examples about actions, done by one library or another."""

from __future__ import annotations

import asyncio
import sys
import threading
from contextlib import contextmanager
from importlib import import_module

import pytest
from action_lives import lives_of
from patience import PATIENCE
from places import EXAMPLES

from mdm import Runtime, run
from mdm.messages import ActionLife

FOLDER = EXAMPLES / "actions"


@contextmanager
def importable():
    sys.path.insert(0, str(FOLDER))
    try:
        yield
    finally:
        sys.path.remove(str(FOLDER))


NAMES = ("py_trees", "behaviortree_cpp", "statemachine", "transitions", "smach")
TREES = NAMES[:2]
with importable():
    errand = import_module("errand")
    within = import_module("ensemble_within")
    ADAPTERS = {name: import_module(f"{name}_action") for name in NAMES}

libraries = pytest.mark.parametrize("library", NAMES)
STEPS = ("approach", "take", "bring", "put_down")


class Scene:
    """A robot whose errand is done by one library, in virtual time where the library knows none of its own."""

    def __init__(self, library):
        self.library = library
        self.virtual = library != "smach"  # which waits in a thread for what takes time
        self.lines = []
        self.told = asyncio.Queue()
        self.robot = errand.Robot(pace=1.0 if self.virtual else 0.002, tell=self.tell)
        self.fetch = ADAPTERS[library].fetch

    def tell(self, line):
        self.lines.append(line)
        self.told.put_nowait(line)

    def step(self, name):
        self.tell(f"step: {name}")

    @property
    def steps(self):
        return tuple(line.removeprefix("step: ") for line in self.lines if line.startswith("step"))

    async def until(self, line):
        while not (await self.told.get()).startswith(line):
            pass


def played(library, script):
    """Run a script beside the errand; return the scene and the lives, when all tasks and threads have ended."""
    threads = set(threading.enumerate())

    async def main():
        scene = Scene(library)
        before = asyncio.all_tasks()
        helper = errand.Helper(scene.robot, scene.fetch)
        async with Runtime(log=None) as runtime:
            lives = lives_of(runtime, "helper")
            runtime.channel("helper/lives", ActionLife).subscribe(
                lambda life: scene.tell(f"{life.action} {life.status} {life.detail}")
            )
            await script(scene, helper, runtime)
        assert asyncio.all_tasks() == before
        assert not scene.robot.is_moving
        return scene, lives

    scene, lives = run(main, virtual=library != "smach")
    for thread in set(threading.enumerate()) - threads:  # one that has done all has yet to end
        thread.join(timeout=PATIENCE)
    assert set(threading.enumerate()) <= threads
    return scene, lives
