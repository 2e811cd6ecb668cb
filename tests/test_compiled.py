from __future__ import annotations

import gc
import weakref
from importlib.machinery import EXTENSION_SUFFIXES

import mdm
from mdm.compiled import is_compiled
from mdm.runtime import dispatcher
from mdm.testing import run_virtual


def test_it_says_what_runs():
    assert is_compiled() == dispatcher.__file__.endswith(tuple(EXTENSION_SUFFIXES))


def test_a_runtime_says_what_runs():
    async def main(runtime):
        return runtime.statistics().compiled

    assert run_virtual(main) == is_compiled()


def test_what_is_compiled_says_what_it_is():
    assert mdm.ActionLayer.__doc__.startswith("Runs one agent's component")
    assert mdm.PredicateManager.define.__doc__.startswith("Declare a predicate by a formula")


def test_what_is_compiled_is_held_weakly_like_anything_else():
    held = []
    for _ in range(1000):
        channel = mdm.Channel("news", mdm.messages.Fault, dispatcher.Dispatcher(mdm.VirtualClock()))
        held += [weakref.ref(channel), weakref.ref(mdm.PredicateManager())]
    del channel
    gc.collect()
    assert not any(weak() for weak in held)


def test_actors_that_are_compiled_have_room_for_more():
    class Manager(mdm.PredicateManager):
        def take(self, readings):
            self.seen = readings
            super().take(readings)

    manager = Manager()
    manager.sensor("A").set(value=True)
    manager.note = "mine"
    assert manager.seen == (("A", True),)
    assert manager.note == "mine"
