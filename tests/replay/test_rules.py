"""The rules of time by which a record of stimuli is the run: without any one of them, a replay differs."""

from __future__ import annotations

import asyncio
import sys
import threading
from random import Random

import pytest
from circles import Lamp
from replay import held
from replay.held import START, HeldClock, recorded

import mdm
from mdm.messages import Tick
from mdm.recording.recorder import Recorder
from mdm.replay import replay
from mdm.runtime.dispatcher import Dispatcher
from mdm.runtime.time.clock import Clock
from mdm.runtime.time.scheduler import Ticker
from mdm.stimuli import Cut, Ended, Over, Resumed

pytestmark = pytest.mark.usefixtures("recorded_here")

_MS = 1_000_000


class Robot:
    """Two ensembles over one predicate that has to hold for a time: one by events, one 100 times a second.

    Args:
        acts: What the first action of the one by events does.
    """

    def __init__(self, acts=lambda: None):
        self.predicates = mdm.PredicateManager("predicates")
        self.near = self.predicates.sensor("Near", initial=False)
        self.bright = self.predicates.sensor("Bright", initial=False)
        self.predicates.define("Held", "Near", held_for=0.02)
        self.predicates.latch("Done", set="go.succeeded", reset="Bright")
        factors = [mdm.StateFactor(name.lower(), [name]) for name in ("Held", "Bright", "Done")]
        self.events = mdm.Ensemble(
            "events",
            policy=[0, 1, 1, 1, 0, 1, 1, 0],
            predicates=self.predicates,
            states=factors,
            actions={"go": acts, "stay": lambda: None},
        )
        self.ticks = mdm.Ensemble(
            "ticks",
            policy=[0, 1, 0, 1],
            predicates=self.predicates,
            states=factors[:2],
            actions={"left": lambda: None, "right": lambda: None},
            drive=100.0,
        )
        self.tops = [self.events, self.ticks]


def run(path):
    """Record a robot whose event loop is held again and again; return what it decides."""
    clocks = []

    def takes_time():
        if clocks:
            clocks[0].hold_until((clocks[0].shown - START) / _MS + 0.5)

    robot = Robot(takes_time)

    async def happen(clock):
        clocks.append(clock)
        clock.let_go()
        robot.near.set(True)  # held at 20 ms
        clock.hold_until(23)
        robot.bright.set(True)  # comes behind that, though the loop has not turned since
        clock.let_go()
        robot.near.set(False)
        clock.hold_until(31.5)
        robot.near.set(True)  # held at 51.5 ms, behind the tick at 40 ms and before that at 60 ms
        clock.hold_until(64)
        clock.let_go()  # one tick stands for three, and comes behind the timer
        robot.bright.set(False)
        clock.hold_until(70.5)
        clock.let_go()
        robot.near.set(False)
        robot.near.set(True)  # held at 90.5 ms
        clock.hold_until(85)
        clock.let_go()
        thread = threading.Thread(target=robot.bright.set, args=(True,))
        thread.start()
        thread.join()
        clock.hold_until(92)
        clock.let_go()  # before the loop takes what the thread has set at 85 ms
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        clock.hold_until(100)
        clock.let_go()

    return recorded(path, robot.tops, happen)


def fire_no_timer_before_a_stimulus(patch):
    patch.setattr(Clock, "fire_before", lambda self, when: None)


def give_the_turn_of_a_timer_the_present_time(patch):
    due = Dispatcher.deliver_due

    def late(self, subscription, message, time):
        due(self, subscription, message, self.clock.now())

    patch.setattr(Dispatcher, "deliver_due", late)


def stamp_input_of_threads_when_it_is_sensed(patch):
    patch.setattr(Dispatcher, "_delivered", lambda self, message, now: message)


def give_a_turn_many_times(patch):
    reader = Dispatcher._reader

    def read(self):
        one, clock = reader(self), self.clock
        return lambda: one() if clock.firing >= 0 else clock.now()  # the time of timers is another rule

    patch.setattr(Dispatcher, "_reader", read)


def tick_for_others_in_the_place_of_the_first(patch):
    def fire(self):
        now = self._clock.now()
        missed = max(now * self._denominator // self._numerator - self._number, 0)
        self._number += missed
        due = self._due(self._number)
        self.tick(Tick(due, self._number, now - due, missed))

    patch.setattr(Ticker, "_fire", fire)


RULES = [
    fire_no_timer_before_a_stimulus,
    give_the_turn_of_a_timer_the_present_time,
    stamp_input_of_threads_when_it_is_sensed,
    give_a_turn_many_times,
    tick_for_others_in_the_place_of_the_first,
]


def test_a_run_whose_event_loop_was_held_is_repeated(tmp_path):
    decisions = run(tmp_path / "run.mcap")
    result = replay(tmp_path / "run.mcap", Robot().tops)
    assert result.differences == ()
    assert result.recorded == result.replayed == len(decisions) > 10


@pytest.mark.parametrize("plant", RULES, ids=lambda plant: plant.__name__)
def test_without_a_rule_a_replay_differs(tmp_path, plant):
    with pytest.MonkeyPatch.context() as patch:
        plant(patch)
        run(tmp_path / "run.mcap")
    assert replay(tmp_path / "run.mcap", Robot().tops).differences


@pytest.mark.parametrize(
    ("delivered", "expected"), [(40, [(40, 1), (60, 0)]), (59, [(59, 1), (60, 0)]), (60, [(60, 1), (60, 0)]), (70, [])]
)
def test_input_of_threads_is_delivered_late_and_as_old_as_it_was_sensed(tmp_path, delivered, expected):
    predicates = mdm.PredicateManager("predicates")
    near = predicates.sensor("Near", max_age=0.02)
    robot = mdm.Ensemble(
        "robot",
        policy=[0, 1],
        predicates=predicates,
        states=[mdm.StateFactor("near", ["Near"])],
        actions={"go": lambda: None, "stay": lambda: None},
        on_lost_input="continue",
    )
    found = []

    async def happen(clock):
        predicates.updates.subscribe(
            lambda update: found.append(((update.time - START) / _MS, int(update.rising == ("Near",))))
        )
        clock.hold_until(40)
        thread = threading.Thread(target=near.set, args=(True,))
        thread.start()
        thread.join()
        clock.hold_until(delivered)
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        clock.hold_until(100)
        clock.let_go()

    recorded(tmp_path / "run.mcap", [robot], happen)
    assert found == expected


def test_what_a_callback_or_a_timer_sets_has_the_time_of_its_turn(tmp_path):
    predicates = mdm.PredicateManager("predicates")
    near, bright = predicates.sensor("Near", initial=False), predicates.sensor("Bright")
    clocks, found = [], []

    def act():
        clocks[0].shown += 5 * _MS
        bright.set(True)

    robot = mdm.Ensemble(
        "robot",
        policy=[0, 1],
        predicates=predicates,
        states=[mdm.StateFactor("near", ["Near"])],
        actions={"stay": lambda: None, "go": act},
    )

    async def happen(clock):
        clocks.append(clock)
        predicates.sensed.subscribe(lambda update: found.append((update.predicates[0], (update.time - START) / _MS)))
        clock.hold_until(3)
        near.set(True)
        clock.call_at(START + 10 * _MS, lambda: near.set(False))
        clock.hold_until(19)
        clock.let_go()

    recorded(tmp_path / "run.mcap", [robot], happen)
    assert found == [(("Near", True), 3.0), (("Bright", True), 3.0), (("Near", False), 10.0)]


class Tired:
    """An ensemble that decides again 5 ms after an action that holds the event loop for 50."""

    def __init__(self, act=lambda: None):
        self.predicates = mdm.PredicateManager("predicates")
        self.near = self.predicates.sensor("Near", initial=False)
        self.robot = mdm.Ensemble(
            "robot",
            policy=[0, 0],
            predicates=self.predicates,
            states=[mdm.StateFactor("near", ["Near"])],
            actions={"go": mdm.Binding(act, then="decide", pause=0.005)},
        )


@pytest.mark.parametrize("planted", [False, True])
def test_who_decides_again_sooner_than_it_has_acted_leaves_the_loop_to_others(tmp_path, planted):
    clocks, calls = [], []

    def act():
        calls.append(clocks[0].shown)
        clocks[0].shown += 50 * _MS
        assert len(calls) < 100, "it is called without end"

    tired = Tired(act)

    async def happen(clock):
        for number in range(5):
            clock.hold_until((clock.shown - START) / _MS + 20)
            before = len(calls)
            tired.near.set(number % 2 == 0)  # a timer, and the decision on it
            assert len(calls) - before <= 3

    def run():
        class First(HeldClock):
            def __init__(self):
                super().__init__()
                clocks.append(self)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(held, "HeldClock", First)
            if planted:
                patch.setattr(Dispatcher, "counts_from", lambda self, actor: self.now())
            return recorded(tmp_path / "run.mcap", [tired.robot], happen)

    if planted:
        with pytest.raises(AssertionError):
            run()
        return
    decisions = run()
    result = replay(tmp_path / "run.mcap", Tired().robot)
    assert result.differences == ()
    assert result.recorded == len(decisions) > 5


class Circle(Lamp):
    """A lamp that goes round, with an action of the robot beside it that takes time."""

    def __init__(self, acts=lambda: None):
        super().__init__(acts)
        self.beside = mdm.Ensemble(
            "beside",
            policy=[0, 1],
            predicates=self.predicates,
            states=[mdm.StateFactor("obstacle", ["Obstacle"])],
            actions={"go": mdm.Binding(self.go, then="decide", pause=0.25), "stay": lambda: None},
        )
        self.tops.append(self.beside)

    async def go(self):
        await asyncio.sleep(0)


def run_in_a_circle(path, seed=1):
    """Record a lamp that goes round while other input comes; return what is decided, and how often a turn was cut."""
    circle, cuts, random = Circle(), [], Random(seed)

    async def happen(clock):
        def acts():
            clock.shown += random.randrange(6 * _MS)

        def tell(sensor, value):
            thread = threading.Thread(target=sensor.set, args=(value,))
            thread.start()
            thread.join()

        circle.acts = acts
        runtime = circle.lamp.runtime
        circle.power.set(True)
        for _ in range(18):
            value = random.random() < 0.5
            for do in random.sample(
                [
                    lambda value=value: tell(circle.obstacle, value),
                    lambda value=value: circle.obstacle.set(not value),
                    circle.robot.stop,
                    circle.robot.start,
                    circle.beside.reset,
                    *[lambda: None] * 5,
                ],
                2,
            ):
                do()
            await asyncio.sleep(0)
        cuts.append(runtime.statistics().dispatcher.interrupted)
        circle.power.set(False)
        while runtime.dispatcher.active:
            await asyncio.sleep(0)
        circle.obstacle.set(True)

    decisions = recorded(path, circle.tops, happen)
    return decisions, cuts[0]


def note(patch, change):
    """Have a recorder keep stimuli as a function changes them; it keeps none in place of None."""
    keep = Recorder.on_stimulus

    def on_stimulus(self, stimulus):
        changed = change(stimulus)
        if changed is not None:
            keep(self, changed)

    patch.setattr(Recorder, "on_stimulus", on_stimulus)


def note_no_cuts(patch):
    note(patch, lambda stimulus: None if isinstance(stimulus, Cut) else stimulus)


def note_cuts_elsewhere(patch):
    note(
        patch,
        lambda stimulus: Cut(stimulus.time, stimulus.after - 2) if isinstance(stimulus, Cut) else stimulus,
    )


def note_nothing_of_hunger(patch):
    note(patch, lambda stimulus: Resumed(stimulus.time, False) if isinstance(stimulus, Resumed) else stimulus)


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 41))])
def test_a_turn_that_time_has_cut_is_cut_where_it_was_when_it_is_repeated(tmp_path, seed):
    decisions, cuts = run_in_a_circle(tmp_path / "run.mcap", seed)
    assert cuts > 10
    assert {"robot", "lamp", "beside"} == {decision.ensemble for decision in decisions}
    result = replay(tmp_path / "run.mcap", Circle().tops)
    assert result.differences == ()
    assert result.recorded == result.replayed == len(decisions)


@pytest.mark.parametrize("plant", [note_no_cuts, note_cuts_elsewhere, note_nothing_of_hunger])
def test_without_the_places_of_cuts_a_replay_differs(tmp_path, plant):
    with pytest.MonkeyPatch.context() as patch:
        plant(patch)
        run_in_a_circle(tmp_path / "run.mcap")
    assert replay(tmp_path / "run.mcap", Circle().tops).differences


@pytest.mark.parametrize("within", [False, True])
def test_a_run_that_ends_in_the_midst_of_a_turn_without_end_is_repeated_up_to_there(tmp_path, within):
    circle = Circle()

    async def happen(clock):
        def acts():
            clock.shown += 3 * _MS
            if within and circle.switches == 500:
                sys.exit("enough")

        circle.acts = acts
        circle.power.set(True)
        for number in range(5):
            circle.obstacle.set(number % 2 == 0)
            await asyncio.sleep(0)
        assert circle.lamp.runtime.dispatcher.active

    path = tmp_path / "run.mcap"
    if within:
        with pytest.raises(SystemExit, match="enough"):
            recorded(path, circle.tops, happen)
    else:
        recorded(path, circle.tops, happen)
    result = replay(path, Circle().tops)
    assert result.differences == ()
    assert result.recorded == result.replayed > 500


class Stubborn:
    """An ensemble whose action is abandoned and ends long after, and one whose actions set their input as they end.

    Args:
        go: What the latter does.
        stay: What the former does.
    """

    def __init__(self, go=lambda: None, stay=lambda: None):
        self.predicates = mdm.PredicateManager("predicates")
        self.odd = self.predicates.sensor("Odd", initial=False)
        self.call = self.predicates.sensor("Call", initial=False)
        self.predicates.latch("Tried", set="stay.failed", reset="rest.succeeded", initial=False)
        self.predicates.latch("Done", set="turn.succeeded", reset="go.succeeded or turn.preempted", initial=False)
        self.swift = mdm.Ensemble(
            "swift",
            policy=[0, 1, 1, 0],
            predicates=self.predicates,
            states=[mdm.StateFactor("odd", ["Odd"]), mdm.StateFactor("done", ["Done"])],
            actions={"go": mdm.bind(go, group="wheels"), "turn": mdm.bind(go, group="wheels")},
        )
        self.slow = mdm.Ensemble(
            "slow",
            policy=[0, 0, 1, 1],
            predicates=self.predicates,
            states=[mdm.StateFactor("call", ["Call"]), mdm.StateFactor("tried", ["Tried"])],
            actions={"rest": lambda: None, "stay": mdm.bind(stay, timeout=0.005, grace=0.005)},
        )
        self.tops = [self.swift, self.slow]


def run_stubborn(path):
    """Record such a robot; return what it decides."""
    free, count = asyncio.Event(), []

    async def go():
        await asyncio.sleep(0)
        count.append(len(count) % 2 == 0)
        if len(count) < 9:
            asyncio.get_running_loop().call_soon(robot.odd.set, count[-1])

    async def stay():
        while not free.is_set():
            try:
                await free.wait()
            except asyncio.CancelledError:
                continue

    robot = Stubborn(go, stay)

    async def rounds():
        for _ in range(20):
            await asyncio.sleep(0)

    async def happen(clock):
        await rounds()
        robot.call.set(True)
        await rounds()
        for time in (5, 11):  # it times out, and is abandoned
            clock.hold_until(time)
            clock.let_go()
            await rounds()
        for milliseconds, called in ((20, False), (21, True), (22, False)):  # it still runs, and fails at once
            clock.hold_until(milliseconds)
            robot.call.set(called)
        free.set()
        await rounds()
        for milliseconds, called in ((30, True), (31, False)):
            clock.hold_until(milliseconds)
            robot.call.set(called)
            await rounds()

    decisions = recorded(path, robot.tops, happen)
    assert len(count) == 9
    return decisions


def note_no_task_that_is_over(patch):
    note(patch, lambda stimulus: None if isinstance(stimulus, Over) else stimulus)


def note_no_end_of_what_was_abandoned(patch):
    note(patch, lambda stimulus: None if isinstance(stimulus, Ended) and stimulus.abandoned else stimulus)


def test_what_is_over_or_abandoned_when_its_action_is_decided_again_is_repeated(tmp_path):
    decisions = run_stubborn(tmp_path / "run.mcap")
    result = replay(tmp_path / "run.mcap", Stubborn().tops)
    assert result.differences == ()
    assert result.recorded == result.replayed == len(decisions) > 15


@pytest.mark.parametrize(
    "plant", [note_no_task_that_is_over, note_no_end_of_what_was_abandoned], ids=lambda plant: plant.__name__
)
def test_without_a_note_of_how_a_task_stands_a_replay_differs(tmp_path, plant):
    with pytest.MonkeyPatch.context() as patch:
        plant(patch)
        run_stubborn(tmp_path / "run.mcap")
    assert replay(tmp_path / "run.mcap", Stubborn().tops).differences
