"""The end of a run: what was due before comes before it, and a replay of it ends as well."""

from __future__ import annotations

import asyncio
import signal

import pytest
from replay.held import recorded

import mdm
from mdm.replay import replay
from mdm.runtime.process import signals
from mdm.testing import run_virtual

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
        self.plain = self._ensemble("plain", "Near", lambda: None)
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


class Ferry:
    """A robot that goes to and fro, for its state follows from the ends of its own actions.

    Args:
        policy: What it does here and there.
        seconds: How long each way takes; none for ways of no time.
    """

    def __init__(self, policy=(0, 1), seconds=(0.1, 0.15)):
        def way(long):
            async def drive():
                await asyncio.sleep(long)

            return drive if long else lambda: None

        self.predicates = mdm.PredicateManager("predicates")
        self.predicates.latch("AtFar", set="far.succeeded", reset="near.succeeded", initial=False)
        self.robot = mdm.Ensemble(
            "robot",
            predicates=self.predicates,
            policy=mdm.policies.DeterministicPolicy(list(policy), 2),
            states=[mdm.StateFactor("far", ["AtFar"])],
            actions={name: way(long) for name, long in zip(("far", "near"), seconds, strict=True)},
        )


def ferried(path, **options):
    """Record a ferry for 3 s; return the record."""

    async def main(runtime):
        await runtime.start(Ferry(**options).robot)
        await asyncio.sleep(3)

    run_virtual(main, record=path)
    return path


def test_a_replay_ends_where_the_state_follows_from_ends_of_actions(tmp_path):
    result = replay(ferried(tmp_path / "run.mcap"), Ferry().robot)
    assert (result.differences, result.recorded, result.replayed) == ((), 24, 24)


@pytest.mark.parametrize("most", [1, 20])
@pytest.mark.parametrize("recorded_with", [(1, 1), (0, 1), (0, 0)])
@pytest.mark.parametrize("other", [(0, 1), (1, 0), (1, 1)])
def test_a_replay_with_another_policy_ends(tmp_path, recorded_with, other, most):
    path = ferried(tmp_path / "run.mcap", policy=recorded_with)
    result = replay(path, Ferry(policy=other).robot, most=most)
    assert bool(result.differences) == (other[0] != recorded_with[0] or {other, recorded_with} == {(0, 0), (0, 1)})
    assert result.replayed <= 1.5 * result.recorded + 2


def test_what_goes_round_at_one_instant_after_a_difference_comes_to_an_end(tmp_path):
    path = ferried(tmp_path / "run.mcap", policy=(0, 0), seconds=(None, None))
    result = replay(path, Ferry(seconds=(None, None)).robot)
    assert result.recorded == 2
    assert 1000 < result.replayed < 1010  # it would decide for ever


@pytest.fixture
def given_back(monkeypatch):
    """Give the handlers of signals back at once."""
    monkeypatch.setattr(signals, "_LINGER", 0.0)
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in numbers}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("given_back")
def test_the_first_signal_ends_a_replay(tmp_path):
    async def main(runtime):
        system = TwoLevels()
        await runtime.start(system.plain)
        for number in range(1000):
            await asyncio.sleep(0.01)
            system.near.set(number % 2 == 0)

    run_virtual(main, record=tmp_path / "run.mcap")
    decided = []

    def hear(decision):
        decided.append(decision)
        if len(decided) == 50:
            signal.raise_signal(signal.SIGTERM)

    with pytest.raises(SystemExit) as ended:
        replay(tmp_path / "run.mcap", TwoLevels().plain, listen=lambda each: each.decisions.subscribe(hear))
    assert ended.value.code == 143
    assert 50 <= len(decided) < 300
