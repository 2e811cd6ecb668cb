"""Sharing: what several use lives as long as one of them does."""

from __future__ import annotations

import asyncio

import pytest
from recorded import Recorded
from sentences import refused

from mdm import Actor, ActorFailure, Ensemble, Error, PredicateManager, Restart, Runtime, StateFactor, run
from mdm.testing import crash, run_virtual


class User(Actor):
    """Uses another actor."""

    def __init__(self, name, used, **options):
        super().__init__(name, **options)
        self.used = used

    def on_start(self):
        self.share(self.used)


def test_a_shared_actor_lives_from_its_first_user_s_start_to_its_last_one_s_end():
    log = []

    async def main(runtime):
        shared = Recorded("shared", log)
        first, second = User("first", shared), User("second", shared)
        await asyncio.gather(runtime.start(first), runtime.start(second))
        assert (shared.life, shared.path) == ("running", "first/shared")
        await runtime.stop(first)
        assert (shared.life, log) == ("running", [("start", "first/shared")])
        await runtime.stop(second)
        assert (shared.life, shared.parent) == ("stopped", None)
        await runtime.start(second)
        assert shared.path == "second/shared"

    run_virtual(main)
    assert [what for what, _ in log] == ["start", "stop", "start", "stop"]


def test_a_shared_actor_stops_after_all_its_users_at_the_end():
    log = []

    class Logged(User):
        def on_stop(self):
            log.append(("stop", self.path))

    async def main(runtime):
        shared = Recorded("shared", log)
        await runtime.start(Logged("first", shared))
        await runtime.start(Logged("second", shared))

    run_virtual(main)
    assert log[1:] == [("stop", "second"), ("stop", "first"), ("stop", "first/shared")]


def test_the_failure_of_a_shared_actor_is_that_of_its_users_which_start_it_anew():
    log = []

    async def main(runtime):
        shared = Recorded("shared", log)
        users = [User(name, shared, supervision=Restart(backoff=wait)) for name, wait in (("a", 0.1), ("b", 1.0))]
        other = Actor("other")
        for actor in (*users, other):
            await runtime.start(actor)
        crash(shared)
        await asyncio.sleep(0.5)
        assert [actor.life for actor in (*users, shared, other)] == ["running", "restarting", "running", "running"]
        await asyncio.sleep(1)
        assert [actor.life for actor in (*users, shared)] == ["running"] * 3

    run_virtual(main)
    assert [what for what, _ in log] == ["start", "stop", "start", "stop"]


def test_what_the_start_of_a_shared_actor_raises_its_user_raises():
    class Broken(Actor):
        def on_start(self):
            raise LookupError("no device")

    async def main(runtime):
        with refused(LookupError):
            await runtime.start(User("user", Broken("broken")))
        assert runtime.root.children == ()

    run_virtual(main)


def patrols():
    """Two ensembles that share a predicate manager, and what they have done."""
    predicates = PredicateManager()
    predicates.sensor("A", initial=False)
    calls = {"first": [], "second": []}
    return (
        predicates,
        calls,
        [
            Ensemble(
                name,
                policy=[0, 1],
                predicates=predicates,
                states=[StateFactor("a", ["A"])],
                actions={0: lambda name=name: calls[name].append(0), 1: lambda name=name: calls[name].append(1)},
                supervision="stop",
            )
            for name in calls
        ],
    )


@pytest.mark.parametrize("how", ["stop", "fail"])
def test_ensembles_that_share_a_manager_do_not_take_it_along(how):
    async def main(runtime):
        predicates, calls, (first, second) = patrols()
        await runtime.start(first)
        await runtime.start(second)
        if how == "stop":
            await runtime.stop(first)
        else:
            crash(first)
        await asyncio.sleep(1)
        predicates.sense("A", True)
        assert calls["second"] == [0, 1]
        assert predicates.life == "running"

    run_virtual(main)


def test_a_manager_that_fails_ends_a_runtime_whose_ensembles_escalate():
    async def main():
        predicates = PredicateManager()
        predicates.sensor("A", initial=False)
        ensemble = Ensemble(
            "robot", policy=[0, 0], predicates=predicates, states=[StateFactor("a", ["A"])], actions={0: lambda: None}
        )
        async with Runtime(log=None) as runtime:
            await runtime.start(ensemble)
            crash(predicates)
            await runtime.wait()

    with refused(ActorFailure):
        run(main, virtual=True)


@pytest.mark.parametrize("shared", [True, False])
def test_what_lives_in_another_runtime_is_refused_until_that_lets_go(shared):
    """Its channels are the other's: who used it would hear nothing any more as soon as it starts anew there."""
    log = []

    async def main():
        used = Recorded("used", log)
        first, second = User("first", used), User("second", used)
        async with Runtime(log=None) as one, Runtime(log=None) as other:
            await one.start(first if shared else used)
            words = f"'{used.path}' lives in another runtime: give each runtime one of its own"
            with pytest.raises(Error, match=words):
                await other.start(second)
            await one.stop(first if shared else used)
            await other.start(second)
            assert (used.life, used.path, used.runtime is other) == ("running", "second/used", True)

    run(main, virtual=True)
