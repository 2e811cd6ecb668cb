"""Actors: the tree, its order, failures and supervision, work, timers."""

from __future__ import annotations

import asyncio

import pytest
from hypothesis import given, strategies as st

from mdm import Actor, ActorFailure, Error, Restart, Runtime, VirtualClock, run
from mdm.messages import State
from mdm.testing import block, crash, delay, probe, run_virtual


class Recorded(Actor):
    """Tells a list of its life."""

    def __init__(self, name, log, **options):
        super().__init__(name, **options)
        self.log = log

    def on_start(self):
        self.log.append(("start", self.path))

    def on_stop(self):
        self.log.append(("stop", self.path))


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


def test_the_block_may_be_left_in_any_way():
    log = []

    async def leave(how):
        async with Runtime(clock=VirtualClock(), log=None) as runtime:
            await runtime.start(Recorded("actor", log))
            if how == "raise":
                raise LookupError("own error")
            if how == "timeout":
                await asyncio.sleep(3600)

    async def main(how):
        async with asyncio.timeout(5):
            await leave(how)

    run(lambda: main("return"), virtual=True)
    with pytest.raises(LookupError, match="own error"):
        run(lambda: main("raise"), virtual=True)
    with pytest.raises(TimeoutError):
        run(lambda: main("timeout"), virtual=True)
    assert log == [("start", "actor"), ("stop", "actor")] * 3


def test_what_a_start_raises_is_raised_to_the_starter_and_stops_those_before():
    log = []

    class Broken(Actor):
        def on_start(self):
            raise LookupError("no device")

    async def main(runtime):
        parent = Recorded("parent", log)
        parent.add(Recorded("first", log))
        parent.add(Broken("second"))
        with pytest.raises(LookupError, match="no device"):
            await runtime.start(parent)
        assert runtime.root.children == []
        await runtime.start(Recorded("other", log))

    run_virtual(main)
    assert [entry for entry in log if "parent" in entry[1]] == [
        ("start", "parent"),
        ("start", "parent/first"),
        ("stop", "parent/first"),
        ("stop", "parent"),
    ]


class Fragile(Recorded):
    """Fails at each odd number it is told."""

    def on_start(self):
        super().on_start()
        self.subscribe(self.runtime.channel("numbers", State), self.handle)

    def handle(self, message):
        if message.index % 2:
            raise ValueError(f"{message.index} is odd")
        self.log.append(("handled", message.index))


def tell(runtime, number):
    runtime.channel("numbers", State).publish(State(0, number, ()))


def test_escalation_ends_the_block_with_the_cause():
    log, faults = [], []

    async def main(runtime):
        runtime.faults.subscribe(faults.append)
        parent = Recorded("parent", log)
        parent.add(Fragile("child", log))
        await runtime.start(parent)
        tell(runtime, 1)
        await asyncio.sleep(3600)
        pytest.fail("the block goes on")

    with pytest.raises(ActorFailure, match=r"'parent/child' failed: 1 is odd"):
        run_virtual(main)
    assert [(fault.source, fault.kind) for fault in faults][:2] == [
        ("parent/child", "exception"),
        ("parent", "exception"),
    ]
    assert "ValueError: 1 is odd (at" in faults[0].detail
    assert log[-2:] == [("stop", "parent/child"), ("stop", "parent")]


def test_supervision_stop_leaves_the_others_alone():
    log = []

    async def main(runtime):
        actor = Fragile("actor", log, supervision="stop")
        await runtime.start(actor)
        lives = probe(runtime.lives)
        tell(runtime, 1)
        await asyncio.sleep(0.1)
        assert actor.life == "failed"
        assert actor.failing
        tell(runtime, 2)
        assert ("handled", 2) not in log
        assert [change.state for change in lives] == ["stopping", "failed"]

    run_virtual(main)


def test_supervision_restart_has_a_limit_and_a_growing_back_off():
    log = []

    async def main(runtime):
        actor = Fragile("actor", log, supervision=Restart(limit=2, within=10, backoff=1))
        await runtime.start(actor)
        times = []
        for wait in (1, 2):
            tell(runtime, 1)
            tell(runtime, 4)  # nobody takes it
            began = runtime.clock.time()
            while actor.life != "running" or actor.failing:
                await asyncio.sleep(0.25)
            times.append(runtime.clock.time() - began)
            assert times[-1] == pytest.approx(wait, abs=0.3)
            tell(runtime, 2)
        assert actor.statistics().restarts == 2
        await asyncio.sleep(60)  # the window passes, and the budget is whole again
        tell(runtime, 1)
        await asyncio.sleep(5)
        assert actor.life == "running"
        tell(runtime, 1)
        await asyncio.sleep(5)
        tell(runtime, 1)
        await asyncio.sleep(60)
        pytest.fail("one failure too many escalates")

    with pytest.raises(ActorFailure, match="is odd"):
        run_virtual(main)
    assert log.count(("handled", 2)) == 2
    assert ("handled", 4) not in log


def test_a_failure_too_many_while_it_waits_to_restart_ends_it():
    log = []

    async def main(runtime):
        actor = Recorded("actor", log, supervision=Restart(limit=1, within=60, backoff=2))
        await runtime.start(actor)
        crash(actor)
        await asyncio.sleep(0.5)
        crash(actor)
        await asyncio.sleep(60)
        pytest.fail("the block goes on")

    with pytest.raises(ActorFailure, match="made to crash"):
        run_virtual(main)
    assert log == [("start", "actor"), ("stop", "actor")]


def test_a_restart_adds_children_anew():
    log = []

    class Parent(Recorded):
        def on_start(self):
            super().on_start()
            self.add(Recorded("child", log))

    async def main(runtime):
        parent = Parent("parent", log, supervision=Restart(backoff=0.1))
        await runtime.start(parent)
        crash(parent)
        await asyncio.sleep(1)
        assert parent.life == "running"
        assert [child.life for child in parent.children] == ["running"]

    run_virtual(main)
    assert log == [("start", "parent"), ("start", "parent/child"), ("stop", "parent/child"), ("stop", "parent")] * 2


def test_work_ends_with_its_actor_and_may_await_while_it_cleans_up():
    log = []

    class Worker(Actor):
        def on_start(self):
            self.spawn(self.work(), lambda work: log.append(("ended", work.cancelled)))

        async def work(self):
            try:
                await asyncio.sleep(3600)
            finally:
                await asyncio.sleep(0.5)
                await asyncio.sleep(0.5)
                log.append("clean")

    async def main(runtime):
        await runtime.start(Worker("worker"))
        await asyncio.sleep(1)

    run_virtual(main)
    assert log == ["clean", ("ended", True)]


def test_work_that_ignores_its_end_is_abandoned_and_reported():
    async def stubborn(free):
        while not free.is_set():
            try:
                await free.wait()
            except asyncio.CancelledError:
                continue

    async def main():
        free = asyncio.Event()
        faults = []
        async with Runtime(clock=VirtualClock(), log=None) as runtime:
            runtime.faults.subscribe(faults.append)
            actor = Actor("actor", grace=2)
            await runtime.start(actor)
            actor.spawn(stubborn(free), name="stubborn")
        assert [(fault.kind, fault.source) for fault in faults] == [("abandoned", "actor")]
        assert "stubborn did not end within 2 s" in faults[0].detail
        assert len(runtime.abandoned) == 1
        free.set()
        await asyncio.sleep(0)

    run(main, virtual=True)


def test_an_error_in_work_or_a_timer_is_the_actor_s_failure():
    async def broken():
        raise ValueError("in work")

    for disturb in (
        lambda actor: actor.spawn(broken()),
        lambda actor: actor.call_later(1, lambda: 1 / 0),
        lambda actor: actor.every(10, lambda tick: 1 / 0),
    ):

        async def main(runtime, disturb=disturb):
            actor = Actor("actor", supervision="stop")
            await runtime.start(actor)
            disturb(actor)
            await asyncio.sleep(2)
            return actor.life

        assert run_virtual(main) == "failed"


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


def test_disturbances():
    log = []

    async def main(runtime):
        actor = Fragile("actor", log)
        await runtime.start(actor)
        with block(actor) as held:
            tell(runtime, 2)
            tell(runtime, 4)
            assert len(held) == 2
            assert log == [("start", "actor")]
        await asyncio.sleep(0.1)
        assert log[1:] == [("handled", 2), ("handled", 4)]
        with delay(actor, 5):
            tell(runtime, 6)
        await asyncio.sleep(4.9)
        assert ("handled", 6) not in log
        await asyncio.sleep(0.2)
        assert ("handled", 6) in log

    run_virtual(main)


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


def test_two_runtimes_in_one_program_do_not_know_of_each_other():
    async def main():
        async with Runtime(clock=VirtualClock(), log=None) as first, Runtime(clock=VirtualClock(), log=None) as second:
            seen = probe(first.channel("numbers", State)), probe(second.channel("numbers", State))
            tell(first, 1)
            await second.start(Fragile("fragile", [], supervision="stop"))
            tell(second, 3)
            return [len(messages) for messages in seen]

    assert run(main, virtual=True) == [1, 1]


def test_a_cancelled_start_ends_what_has_started_in_good_order():
    log = []

    class Slow(Recorded):
        async def on_stopping(self):
            await asyncio.sleep(0.5)
            log.append(("stopping", self.path))

    async def main(runtime):
        parent = Slow("parent", log)
        parent.add(Recorded("child", log))
        starting = asyncio.create_task(runtime.start(parent))
        while parent.life == "created":
            await asyncio.sleep(0)
        starting.cancel()
        await asyncio.wait([starting])
        assert starting.cancelled()
        assert runtime.root.children == []

    run_virtual(main)
    assert log[0] == ("start", "parent")
    assert log[-2:] == [("stopping", "parent"), ("stop", "parent")] or log[-3] == ("stopping", "parent")
    assert sum(what == "start" for what, _ in log) == sum(what == "stop" for what, _ in log)
