"""Actors: the tree, its order, failures and supervision, work, timers."""

from __future__ import annotations

import asyncio
import itertools

import pytest
from hypothesis import given, strategies as st
from recorded import Recorded, tell
from sentences import refused

from mdm import Actor, ActorFailure, Error, Restart, Runtime, VirtualClock, run
from mdm.messages import State
from mdm.testing import crash, probe, run_virtual


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
    with refused(Error):
        Actor("other").add(child)
    with refused(Error):
        parent.add(Actor("child"))
    with refused(Error):
        Actor("a/b")
    with refused(Error):
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


PUBLIC = sorted(name for name in vars(Actor) if not name.startswith("_"))
HOOKS = ("on_start", "on_running", "on_failing", "on_ending", "on_starved", "on_stop")
FREE = {*HOOKS, "on_stopping", "patience", "statistics"}


@pytest.mark.parametrize("name", [*sorted(set(PUBLIC) - FREE), "name", "supervision", "grace"])
@pytest.mark.parametrize("value", [7, lambda self: None], ids=["value", "method"])
def test_a_subclass_that_hides_what_an_actor_has_is_refused(name, value):
    with refused(Error):
        type("Robot", (Actor,), {name: value})

    class Mixin:
        pass

    setattr(Mixin, name, value)
    with refused(Error):
        type("Robot", (Mixin, Actor), {})


@pytest.mark.parametrize("name", sorted(set(PUBLIC) - FREE))
@pytest.mark.parametrize("early", [False, True])
def test_an_attribute_that_hides_what_an_actor_has_is_refused(name, early):
    class Robot(Actor):
        def __init__(self):
            if early:
                setattr(self, name, "mine")
            super().__init__("robot")
            setattr(self, name, "mine")

    with refused(Error):
        Actor("parent").add(Robot())


def test_a_subclass_may_call_its_own_as_it_likes():
    hidden = {*vars(Actor), *vars(Actor("actor"))}
    names = sorted(name.removeprefix("_Actor__") for name in hidden if name.startswith("_Actor__"))
    assert "request" in names
    calls = []

    class Robot(Actor):
        def __init__(self):
            super().__init__("robot", supervision=Restart(backoff=0.5))
            for name in names[::2]:
                setattr(self, f"_{name}", f"my {name}")

        @property
        def path(self):
            return super().path

        def on_start(self):
            self.call_later(1.0, lambda: calls.append(self.runtime.clock.now() // 10**9))
            self.spawn(asyncio.sleep(0.1))

    for name in names[1::2]:
        setattr(Robot, f"_{name}", lambda self, *_, name=name: calls.append(name))

    async def main(runtime):
        robot = Robot()
        await runtime.start(robot)
        await asyncio.sleep(2)
        crash(robot)
        await asyncio.sleep(2)
        await runtime.stop(robot)
        assert (calls, robot.life, robot.statistics().restarts) == ([1, 3], "stopped", 1)

    run_virtual(main)


async def later(self):
    pass


@pytest.mark.parametrize(
    ("name", "hook", "words"),
    [
        *((name, later, f"Robot.{name} must be a plain function, but later is an async") for name in HOOKS),
        ("on_stopping", lambda self: None, "Robot.on_stopping is awaited"),
        ("on_start", None, "Robot.on_start is a function, not None"),
    ],
)
def test_a_hook_that_could_not_be_called_is_refused(name, hook, words):
    with pytest.raises(Error, match=words):
        type("Robot", (Actor,), {name: hook})


def test_a_deep_path_costs_as_much_as_it_is_long():
    """Read twice at each level, it took 2 to the power of its depth."""
    actors = [Actor(f"a{depth}") for depth in range(100)]
    for parent, child in itertools.pairwise(actors):
        parent.add(child)
    assert actors[-1].path == "/".join(actor.name for actor in actors)


@pytest.mark.parametrize("name", [None, 5])
def test_a_name_is_a_text(name):
    with refused(Error):
        Actor(name)


@pytest.mark.parametrize(
    ("thing", "words"),
    [(None, "an object of type NoneType"), ("robot", "an object of type str"), (Actor, "the class Actor")],
)
def test_only_an_actor_is_started_added_and_stopped(thing, words):
    async def program():
        async with Runtime(log=None) as runtime:
            for use in (runtime.start, runtime.stop):
                with refused(Error):
                    await use(thing)
            with refused(Error):
                runtime.root.add(thing)

    run(program)


def test_a_child_has_a_name():
    with refused(Error):
        Actor("a").add(Actor(""))


@pytest.mark.parametrize("supervision", ["nonsense", None, 5, Restart])
def test_what_is_no_supervision_is_refused(supervision):
    with refused(Error):
        Actor("a", supervision=supervision)


@pytest.mark.parametrize("grace", [0, "x", True, None])
def test_grace_is_a_number_of_seconds(grace):
    with refused(Error):
        Actor("a", grace=grace)


class Slow(Actor):
    """Ends after some seconds."""

    def __init__(self, seconds, patience=0.0, **options):
        super().__init__("slow", **options)
        self.seconds, self.limit = seconds, patience

    @property
    def patience(self):
        return self.limit

    async def on_stopping(self):
        await asyncio.sleep(self.seconds)  # here it waits


@pytest.mark.parametrize(
    ("seconds", "patience", "told"),
    [(0.0, 0.0, []), (0.99, 0.0, []), (5.0, 0.0, [1.0]), (3.9, 3.0, []), (30.0, 3.0, [4.0])],
)
def test_an_actor_that_takes_long_to_end_is_named(seconds, patience, told):
    async def main(runtime):
        faults, slow = probe(runtime.faults), Slow(seconds, patience)
        parent = Actor("parent")
        parent.add(slow)
        await runtime.start(parent)
        await runtime.stop(parent)
        assert runtime.clock.now() == seconds * 1e9
        assert [fault.time / 1e9 for fault in faults] == told
        line = Slow.on_stopping.__code__.co_firstlineno + 1
        for fault in faults:
            assert (fault.source, fault.kind) == ("parent/slow", "stopping")
            assert fault.detail == (f"`on_stopping` has not ended within {told[0]:g} s: it waits at {__file__}:{line}")

    run_virtual(main)


def test_an_actor_that_takes_long_to_start_anew_is_named():
    async def main(runtime):
        faults = probe(runtime.faults)
        slow = Slow(5.0, supervision=Restart())
        await runtime.start(slow)
        slow.fail(ValueError("broken"))
        await asyncio.sleep(10)
        assert [fault.kind for fault in faults] == ["exception", "stopping"]
        assert slow.life == "running"

    run_virtual(main)


def test_what_two_stop_and_one_of_them_starts_anew_lives_and_ends_with_the_runtime():
    async def main(runtime):
        one = Actor("one")
        await runtime.start(one)

        async def stop_and_start():
            await runtime.stop(one)
            await runtime.start(one)

        await asyncio.gather(stop_and_start(), runtime.stop(one))
        assert (one.life, one.parent) == ("running", runtime.root)
        return one

    assert run_virtual(main).life == "stopped"
