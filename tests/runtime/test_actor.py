"""Actors: the tree, its order, failures and supervision, work, timers."""

from __future__ import annotations

import asyncio

import pytest
from hypothesis import given, strategies as st
from recorded import Recorded, tell

from mdm import Actor, ActorFailure, Error, Restart, Runtime, VirtualClock, run
from mdm.messages import State
from mdm.testing import crash, run_virtual


def tree(log, shape, name="root"):
    actor = Recorded(name, log)
    for index, below in enumerate(shape):
        actor.add(tree(log, below, f"{name}{index}"))
    return actor


shapes = st.recursive(st.just([]), lambda inner: st.lists(inner, max_size=3), max_leaves=8)


@given(shapes)
def test_a_tree_starts_in_order_and_stops_in_reverse(shape):
    log = []

    async def main(runtime):
        await runtime.start(tree(log, shape))

    run_virtual(main)
    started = [path for what, path in log if what == "start"]
    stopped = [path for what, path in log if what == "stop"]

    def walk(actor):
        yield actor.path
        for child in actor.children:
            yield from walk(child)

    def walk_back(actor):
        for child in reversed(actor.children):
            yield from walk_back(child)
        yield actor.path

    plain = tree([], shape)
    assert started == list(walk(plain))
    assert stopped == list(walk_back(plain))
    assert log.index(("stop", stopped[0])) == len(started)


def test_timers_and_subscriptions_end_with_the_actor():
    calls = []

    async def main(runtime):
        actor = Actor("actor")
        await runtime.start(actor)
        actor.call_later(1, lambda: calls.append("timer"))
        actor.every(1, calls.append)
        actor.subscribe(runtime.channel("numbers", State), calls.append)
        await runtime.stop(actor)
        tell(runtime, 1)
        await asyncio.sleep(10)

    run_virtual(main)
    assert calls == []


def test_wrong_trees_are_refused():
    parent, child = Actor("parent"), Actor("child")
    parent.add(child)
    with pytest.raises(Error, match="already a child of 'parent'"):
        Actor("other").add(child)
    with pytest.raises(Error, match="two children named 'child'"):
        parent.add(Actor("child"))
    with pytest.raises(Error, match="no '/'"):
        Actor("a/b")
    with pytest.raises(Error, match="has not been started"):
        parent.runtime  # noqa: B018


@given(st.data())
def test_random_trees_that_fail_at_random_leave_nothing_behind(data):
    """Whatever is started, stopped and made to fail, no task is left over and every start has its stop."""
    log = []
    supervisions = ["stop", "escalate", Restart(limit=2, within=60, backoff=0.5)]

    async def forever():
        await asyncio.sleep(1e6)

    class Busy(Recorded):
        def on_start(self):
            super().on_start()
            self.spawn(forever())
            self.every(1, lambda tick: None)

    async def main():
        before = asyncio.all_tasks()
        try:
            async with Runtime(clock=VirtualClock(), log=None) as runtime:
                actors = []
                for index in range(data.draw(st.integers(1, 6))):
                    actor = Busy(f"a{index}", log, supervision=data.draw(st.sampled_from(supervisions)))
                    alive = [other for other in actors if other.life == "running"]
                    if alive and data.draw(st.booleans()):
                        await data.draw(st.sampled_from(alive)).start_child(actor)
                    else:
                        await runtime.start(actor)
                    actors.append(actor)
                for _ in range(data.draw(st.integers(0, 6))):
                    actor = data.draw(st.sampled_from(actors))
                    if data.draw(st.booleans()):
                        crash(actor)
                    else:
                        actor.end()
                    if data.draw(st.booleans()):
                        await asyncio.sleep(data.draw(st.sampled_from([0, 0.4, 3])))
        except ActorFailure:
            pass
        assert asyncio.all_tasks() == before

    run(main, virtual=True)
    assert sum(what == "start" for what, _ in log) == sum(what == "stop" for what, _ in log)
