"""The end of a run: what was due before comes before it, and a replay of it ends as well."""

from __future__ import annotations

import asyncio

import pytest
from replay.held import recorded

import mdm
from mdm.replay import replay

pytestmark = pytest.mark.usefixtures("recorded_here")


async def rest():
    await asyncio.sleep(3600)


class TwoLevels:
    """A robot that goes once it has been near for 20 ms, by an ensemble below it, which decides at once."""

    def __init__(self):
        self.predicates = mdm.PredicateManager("predicates")
        self.near = self.predicates.sensor("Near", initial=False)
        self.predicates.define("Held", "Near", held_for=0.02)
        self.below = self._ensemble("below", "Near", rest)
        self.top = self._ensemble("top", "Held", self.below)
        self.alone = self._ensemble("alone", "Near", rest)
        self.direct = self._ensemble("direct", "Near", self._ensemble("last", "Near", rest))

    def _ensemble(self, name, predicate, go):
        states = [mdm.StateFactor(f"{name}held", [predicate])]
        actions = {f"{name}_stay": lambda: None, f"{name}_go": go}
        return mdm.Ensemble(name, predicates=self.predicates, policy=[0, 1], states=states, actions=actions)


@pytest.mark.parametrize("held", [20.5, 45, 5000])
def test_what_a_timer_begins_within_the_call_that_ends_is_begun_in_both(tmp_path, held):
    system = TwoLevels()

    async def happen(clock):
        system.near.set(True)
        clock.hold_until(held)

    decisions = recorded(tmp_path / "run.mcap", [system.top], happen)
    assert [each.action_name for each in decisions] == ["top_stay", "top_go", "below_go"]
    result = replay(tmp_path / "run.mcap", TwoLevels().top)
    assert (result.differences, result.recorded, result.replayed) == ((), 3, 3)


@pytest.mark.parametrize("rounds", [0, 3])
def test_what_the_last_input_begins_is_begun_as_far_as_it_was(tmp_path, rounds):
    system = TwoLevels()

    async def happen(clock):
        system.near.set(True)
        for _ in range(rounds):
            await asyncio.sleep(0)

    decisions = recorded(tmp_path / "run.mcap", [system.direct], happen)
    result = replay(tmp_path / "run.mcap", TwoLevels().direct)
    assert (result.differences, result.recorded, result.replayed) == ((), len(decisions), len(decisions))


class Clerk(mdm.Actor):
    """Starts an ensemble that was stopped, some time after its own start, and notes whether all ends by then."""

    def __init__(self, ensemble):
        super().__init__("clerk")
        self.ensemble, self.ended = ensemble, []

    def on_start(self):
        self.call_later(0.03, self._start)

    def _start(self):
        self.ended.append(self.runtime.ending)
        self.ensemble.start()


def test_timers_that_are_due_before_the_end_fire_before_it(tmp_path):
    robot, again = TwoLevels().alone, TwoLevels().alone
    clerk = Clerk(robot)

    async def happen(clock):
        robot.stop()
        clock.hold_until(100)

    decisions = recorded(tmp_path / "run.mcap", [robot, clerk], happen)
    assert clerk.ended == [False]
    assert len(decisions) == 2
    assert replay(tmp_path / "run.mcap", [again, Clerk(again)]).differences == ()
