"""Turns: their order, no re-entrance, their length, and messages of other threads."""

from __future__ import annotations

import asyncio
import inspect
import sys
import threading
from collections import Counter, deque
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given, strategies as st
from patience import PATIENCE
from programs import python
from recorded import state, tell
from replay.held import START, HeldClock

from mdm import Actor, ActorFailure, Ensemble, Error, PredicateManager, Runtime, StateFactor, run
from mdm.messages import State
from mdm.runtime import Dispatcher, WallClock
from mdm.runtime.channel import Channel, Subscription, Topics
from mdm.runtime.time.virtual import VirtualClock
from mdm.testing import probe, run_virtual


class Echo(Actor):
    """Publishes, for each message on its channel, what a table says."""

    def __init__(self, name, table, log):
        super().__init__(name)
        self.table, self.log, self.depth = table, log, 0

    def on_start(self):
        self.subscribe(self.runtime.channel(self.name, State), self.handle)

    def handle(self, message):
        assert self.depth == 0, "re-entered"
        self.depth += 1
        self.log.append((self.name, message.index))
        for target, index in self.table.get((self.name, message.index), ()):
            self.runtime.channel(target, State).publish(state(index))
        self.depth -= 1


def test_what_is_delivered_behind_a_turn_comes_after_all_that_the_turn_brings_about():
    table, log = {("a", 0): [("b", 1), ("b", 2)], ("b", 2): [("a", 3)]}, []

    async def main(runtime):
        class Eager(Echo):
            def handle(self, message):
                if message.index == 0:
                    runtime.dispatcher.deliver_behind(Subscription(None, self, log.append), "behind")
                super().handle(message)

        for actor in (Eager("a", table, log), Echo("b", table, log)):
            await runtime.start(actor)
        runtime.channel("a", State).publish(state(0))
        assert log == [("a", 0), ("b", 1), ("b", 2), ("a", 3), "behind"]
        runtime.dispatcher.deliver_behind(Subscription(None, None, log.append), "at once")
        assert log[-1] == "at once"

    run_virtual(main)


def test_what_waits_behind_a_turn_may_be_far_more_than_the_stack_is_deep():
    async def main(runtime):
        seen, dispatcher = [], runtime.dispatcher
        many = 5 * sys.getrecursionlimit()

        def begin(_):
            for number in range(many):
                dispatcher.deliver_behind(Subscription(None, None, seen.append), number)

        before = dispatcher.statistics().turns
        dispatcher.deliver(Subscription(None, None, begin), None)
        assert seen == list(range(many))
        assert dispatcher.statistics().turns - before == many + 1  # each in a turn of its own

    run_virtual(main)


def test_a_turn_behind_comes_to_its_end_before_the_next_one():
    log = []

    async def main(runtime):
        dispatcher, channel = runtime.dispatcher, runtime.channel("x", State)
        channel.subscribe(lambda message: log.append(message.index))

        def behind(number):
            log.append(f"begins {number}")
            channel.publish(state(number))

        def begin(_):
            for number in range(3):
                dispatcher.deliver_behind(Subscription(None, None, behind), number)

        dispatcher.deliver(Subscription(None, None, begin), None)

    run_virtual(main)
    assert log == ["begins 0", 0, "begins 1", 1, "begins 2", 2]


def test_turns_that_lead_to_further_ones_behind_them_yield_to_the_event_loop_and_are_told(monkeypatch):
    monkeypatch.setattr("mdm.runtime.dispatcher._MOST_CUTS", 8)

    async def main(runtime):
        dispatcher, faults, count, other = runtime.dispatcher, probe(runtime.faults), [0], []

        def behind(_):
            count[0] += 1
            if not faults:
                dispatcher.deliver_behind(turn, None)

        turn = Subscription(None, None, behind)
        asyncio.get_running_loop().call_soon(lambda: other.append(count[0]))
        dispatcher.deliver(turn, None)
        assert not faults
        await asyncio.sleep(0)
        assert other[0] <= 16_384  # the loop turns after as many messages as one turn may have
        while not faults:
            await asyncio.sleep(0)
        assert dispatcher.statistics().interrupted >= 8
        return faults[0]

    fault = run_virtual(main)
    assert (fault.kind, "handlers may publish to each other without end" in fault.detail) == ("endless_turn", True)


def test_what_waits_behind_is_delivered_before_the_runtime_closes():
    """A turn that has been cut short right before what comes behind it."""
    seen = []

    async def main():
        async with Runtime(clock=VirtualClock(), log=None) as runtime:
            dispatcher = runtime.dispatcher
            nothing = Subscription(None, None, lambda _: None)

            def begin(_):
                for _ in range(16_383):
                    dispatcher.deliver(nothing, None)
                dispatcher.deliver_behind(Subscription(None, None, seen.append), "behind")

            dispatcher.deliver(Subscription(None, None, begin), None)
            assert (len(dispatcher.queue), seen) == (0, [])  # cut short, with nothing left of the turn itself
            dispatcher.close()
            assert seen == ["behind"]

    run(main, virtual=True)


@given(st.data())
def test_messages_are_delivered_first_in_first_out(data):
    """Against a plain queue: a turn is a breadth-first walk, in the order of publication."""
    names = ["a", "b", "c"]
    # messages only lead to larger numbers, so that every turn ends
    table = {
        (name, index): data.draw(
            st.lists(st.tuples(st.sampled_from(names), st.integers(index + 1, 4)), max_size=2)
            if index < 4
            else st.just([])
        )
        for name in names
        for index in range(5)
    }
    log = []

    async def main(runtime):
        for name in names:
            await runtime.start(Echo(name, table, log))
        runtime.channel("a", State).publish(state(0))

    run_virtual(main)
    expected, queue = [], deque([("a", 0)])
    while queue:
        entry = queue.popleft()
        expected.append(entry)
        queue.extend(table[entry])
    assert log == expected


def test_a_turn_is_over_when_publish_returns_and_every_subscriber_sees_one_order():
    async def main(runtime):
        channel = runtime.channel("x", State)
        first, second = probe(channel), probe(channel)
        for number in range(5):
            channel.publish(state(number))
            assert [message.index for message in first] == list(range(number + 1))
        assert first == second
        assert runtime.statistics().dispatcher.turns >= 5

    run_virtual(main)


def test_an_endless_turn_yields_to_the_loop_and_goes_on():
    class Endless(Actor):
        def on_start(self):
            self.seen = 0
            self.own = self.channel("own", State)
            self.subscribe(self.own, self.handle)

        def handle(self, message):
            self.seen += 1
            if self.seen < 100_000:
                self.own.publish(message)

    async def main(runtime):
        actor = Endless("endless")
        await runtime.start(actor)
        runtime.dispatcher.deliver(actor.subscriptions[0], state(0))
        assert 0 < actor.seen < 100_000
        other = probe(runtime.channel("other", State))
        runtime.channel("other", State).publish(state(1))
        assert other == []  # it queues behind what the turn still has to deliver
        while actor.seen < 100_000:
            await asyncio.sleep(0)
        assert [message.index for message in other] == [1]
        assert runtime.statistics().dispatcher.interrupted > 0

    run_virtual(main)


@pytest.mark.parametrize("uvloop", [False, True])
def test_other_threads_publish_through_one_wake_up(uvloop):
    if uvloop:
        pytest.importorskip("uvloop")

    async def main():
        async with Runtime(log=None) as runtime:
            channel = runtime.channel("x", State)
            here, seen = threading.get_ident(), []
            done = asyncio.Event()

            def take(message):
                assert threading.get_ident() == here
                seen.append(message.index)
                if len(seen) == 2000:
                    done.set()

            channel.subscribe(take)
            threads = [
                threading.Thread(target=lambda base=base: [channel.publish(state(base + i)) for i in range(500)])
                for base in range(0, 2000, 500)
            ]
            for thread in threads:
                thread.start()
            await done.wait()
            for thread in threads:
                thread.join()
            assert sorted(seen) == list(range(2000))
            for base in range(0, 2000, 500):  # first in, first out for each thread
                own = [number for number in seen if base <= number < base + 500]
                assert own == sorted(own)
            assert runtime.statistics().dispatcher.from_threads == 2000
            return runtime, channel

    runtime, channel = run(main, uvloop=uvloop)
    failures = []

    def late(channel):
        try:
            channel.publish(state(0))
        except Error as error:
            failures.append(str(error))

    for each in (channel, Runtime(log=None).channel("early", State)):
        thread = threading.Thread(target=late, args=(each,))
        thread.start()
        thread.join()
    assert failures == ["channel 'early' got a message before its runtime began"]
    assert runtime.statistics().dispatcher.refused == 1


def test_a_loop_that_is_closed_while_a_thread_publishes_is_the_end():
    class Closing:
        def is_closed(self):
            return False

        def call_soon_threadsafe(self, call):
            raise RuntimeError("Event loop is closed")

    async def main(runtime):
        channel = runtime.channel("x", State)
        dispatcher = runtime.dispatcher
        loop, dispatcher.loop = dispatcher.loop, Closing()
        thread = threading.Thread(target=channel.publish, args=(state(0),))
        thread.start()
        thread.join()
        dispatcher.loop = loop
        return runtime.statistics().dispatcher.refused

    assert run_virtual(main) == 1


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit])
def test_a_handler_that_ends_the_program_ends_the_runtime_and_the_turn_goes_on(error):
    seen = []

    async def main(runtime):
        channel = runtime.channel("x", State)

        def interrupt(message):
            if message.index == 0:
                raise error
            seen.append(message.index)

        channel.subscribe(interrupt)
        channel.publish(state(0))
        channel.publish(state(1))
        await asyncio.Event().wait()

    with pytest.raises(error):
        run_virtual(main)
    assert seen == [1]


def test_an_error_of_nobody_is_raised_where_it_was_brought_about_and_the_turn_goes_on():
    seen = []

    async def main(runtime):
        channel = Channel("x", State, runtime.dispatcher)
        for handler in (lambda _: seen.append(1 / 0), seen.append):
            channel.subscribe(handler)
        with pytest.raises(ZeroDivisionError):
            channel.publish(state(0))
        assert seen == []
        await asyncio.sleep(0)
        assert seen == [state(0)]

    run_virtual(main)


def test_a_dispatcher_needs_no_runtime():
    dispatcher = Dispatcher(WallClock())
    assert dispatcher.statistics().turns == 0


FLOOD = """
import asyncio, gc, os, sys, threading, time
import mdm

def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")

async def main():
    manager = mdm.PredicateManager()
    sensors = [manager.sensor(name, initial=False) for name in "AB"]
    source = manager.event("E") if "events" in sys.argv else None
    async with mdm.Runtime(log=None, watchdog=None) as runtime:
        await runtime.start(manager)
        updates, faults = [], []
        runtime.faults.subscribe(faults.append)
        started, count = threading.Event(), [0]

        def flood():
            started.set()
            for _ in range(int(sys.argv[1])):
                for sensor in sensors:
                    sensor.set(count[0] % 2 == 0)
                if source is not None:
                    source.fire()
                count[0] += 1
            for sensor in sensors:
                sensor.set(True)

        thread = threading.Thread(target=flood)
        manager.updates.subscribe(lambda update: updates.append(update.time))
        thread.start()
        started.wait()
        before = resident()
        thread.join()
        after, updates[:], began = resident(), [], time.process_time()
        await asyncio.sleep(0)
        while not (sensors[0].value and sensors[1].value):
            await asyncio.sleep(0)
        took = time.process_time() - began
        found = runtime.statistics().dispatcher
        print(count[0], after - before, took, len(updates), found.from_threads, found.replaced, found.lost, len(faults))

mdm.run(main)
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
@pytest.mark.parametrize("kind", ["predicates", "events"])
def test_a_flood_while_the_loop_is_held_takes_little_memory_and_little_time(kind):
    with python("-c", FLOOD, 60_000, kind) as process:
        output, errors = process.communicate(timeout=PATIENCE)
    assert not errors
    words = output.split()
    took = float(words.pop(2))
    count, grown, updates, taken, replaced, lost, faults = map(int, words)
    assert count == 60_000
    assert grown < 3_000_000
    assert took < 0.5  # of the processor, which is 0.1 on an idle machine
    if kind == "predicates":
        assert (updates, taken, lost, faults) == (2, 2, 0, 0)
        assert replaced == 2 * count
    else:
        assert updates <= 2050
        assert (taken <= 2050, lost > 0, faults) == (True, True, 1)
    assert taken + replaced + lost == count * (2 if kind == "predicates" else 3) + 2


def test_the_fault_about_lost_messages_is_told_once_each_time():
    async def main(runtime):
        channel, faults = runtime.channel("x", State), probe(runtime.faults)

        def flood(number):
            thread = threading.Thread(target=lambda: [channel.publish(state(i)) for i in range(number)])
            thread.start()
            thread.join()

        counts = []
        for number in (3000, 3000, 10, 3000):
            flood(number)
            await asyncio.sleep(0)
            await asyncio.sleep(0)
            counts.append((channel.dropped, len(faults)))
        return counts, faults[0]

    counts, fault = run_virtual(main)
    assert counts == [(952, 1), (1904, 1), (1904, 1), (2856, 2)]
    assert (fault.source, fault.kind) == ("runtime", "overflow")
    assert fault.detail.startswith("952 messages of other threads on channel 'x' were lost: 2,048 waited already")


def test_what_threads_say_is_taken_in_and_does_not_pile_up_behind_a_turn_without_end():
    async def main(runtime):
        channel, endless = runtime.channel("x", State), [True]
        sides = [runtime.channel(name, State) for name in ("ping", "pong")]
        seen = probe(channel)

        def pass_on(to):
            for _ in range(5000 if not channel.published and not to.published else 1):
                if endless:
                    to.publish(state(0))

        for number in (0, 1):
            sides[number].subscribe(lambda _, to=sides[1 - number]: pass_on(to))
        sides[0].publish(state(0))
        most = 0
        for _ in range(20):
            thread = threading.Thread(target=lambda: [channel.publish(state(i)) for i in range(3000)])
            thread.start()
            thread.join()
            await asyncio.sleep(0)
            most = max(most, len(runtime.dispatcher.queue))
        assert runtime.dispatcher.active
        assert len(seen) >= 2048
        assert 5000 < most <= 5000 + 2048 + 2
        endless.clear()
        while runtime.dispatcher.active:
            await asyncio.sleep(0)
        counts = runtime.statistics().dispatcher
        assert counts.from_threads == len(seen)
        assert counts.lost == 20 * 3000 - len(seen)

    run_virtual(main, log=False)  # whoever hears faults has them in the queue, too


def test_a_turn_without_end_is_told_once(monkeypatch):
    monkeypatch.setattr("mdm.runtime.dispatcher._MOST_CUTS", 8)

    class Ping(Actor):
        def on_start(self):
            self.own = self.channel("own", State)
            self.subscribe(self.own, self.own.publish)

    async def main(runtime):
        faults = probe(runtime.faults)
        actor = Ping("ping")
        await runtime.start(actor)
        asyncio.get_running_loop().call_soon(actor.own.publish, state(0))
        while runtime.statistics().dispatcher.interrupted < 20:
            await asyncio.sleep(0)
        actor.subscriptions[0].cancel()
        await asyncio.sleep(0)
        await asyncio.sleep(1)
        assert [fault.kind for fault in faults] == ["endless_turn"]
        assert faults[0].detail.endswith("without end: 'ping' publishes on 'ping/own'")

    run_virtual(main)


FORK = """
import os, sys, warnings, mdm
warnings.simplefilter("ignore")

async def main():
    predicates = mdm.PredicateManager()
    sensor = predicates.sensor("A", initial=False)
    states = [mdm.StateFactor("a", ["A"])]
    actions = {0: lambda: None, 1: lambda: print("drives", os.getpid() == parent, flush=True)}
    async with mdm.Runtime(log=None) as runtime:
        await runtime.start(mdm.Ensemble("robot", policy=[0, 1], predicates=predicates, states=states, actions=actions))
        child = os.fork()
        if child == 0:
            try:
                sensor.set(True)
            except mdm.Error as error:
                print(error, flush=True)
            os._exit(0)
        os.waitpid(child, 0)
        sensor.set(True)

parent = os.getpid()
mdm.run(main)
"""


def test_a_forked_child_runs_nothing_of_its_parent():
    with python("-c", FORK) as process:
        output, errors = process.communicate(timeout=PATIENCE)
    first, *rest = output.splitlines()
    assert "in a forked process" in first, errors
    assert rest == ["drives True"]


@pytest.mark.parametrize("room", range(2, 40, 3))
def test_a_turn_that_a_deep_stack_has_no_room_for_fails_from_the_event_loop(room):
    def deep(levels, function):
        if levels:
            deep(levels - 1, function)
        else:
            function()

    handled = []

    def handler(message):
        deep(10, lambda: None)
        handled.append(message.index)

    async def main(runtime):
        actor = Actor("actor", supervision="stop")
        faults = probe(runtime.faults)
        await runtime.start(actor)
        channel = runtime.channel("numbers", State)
        actor.subscribe(channel, handler)
        limit, used = sys.getrecursionlimit(), len(inspect.stack())
        try:
            deep(limit - used - room, lambda: tell(runtime, 1))
            raised = False
        except RecursionError:
            raised = True
        tell(runtime, 2)
        await asyncio.sleep(1)
        assert sys.getrecursionlimit() == limit
        # How many levels are left for a handler depends on the version of Python, but not that a failure is told.
        assert raised or bool(faults) == (1 not in handled)
        assert handled == ([] if faults else [2] if raised else [1, 2])
        assert not runtime.dispatcher.active
        assert not runtime.dispatcher.queue

    run_virtual(main)


CHANNELS, MOST = 3, 600


class Plain:
    """What a dispatcher promises, said plainly: one queue, first in, first out, and nothing else."""

    def __init__(self, subscribers):
        self.subscribers, self.queue, self.log, self.steps = subscribers, deque(), [], 0
        self.published, self.last = [0] * CHANNELS, [None] * CHANNELS

    def emit(self, channel, topics):
        if topics is None:
            self.publish(channel)
            return
        self.published[channel] += 1
        self.last[channel] = self.published[channel]
        general = [one for one in self.subscribers if one.channel == channel and one.topics is None]
        about = [one for topic in topics for one in self.subscribers if one.channel == channel and topic in one.heeds]
        for subscriber in (*general, *{one.name: one for one in about}.values()):
            self.queue.append((subscriber, self.published[channel]))

    def publish(self, channel):
        self.published[channel] += 1
        self.last[channel] = self.published[channel]
        self.queue.extend((one, self.published[channel]) for one in self.subscribers if one.channel == channel)

    def turn(self, channel):
        self.publish(channel)
        while self.queue:
            subscriber, number = self.queue.popleft()
            self.steps += 1
            self.log.append((subscriber.name, number, *self.published, *self.last))
            if self.steps > MOST:
                continue
            for way, target, topics in subscriber.script:
                if way == "raise":
                    self.log.append(f"{subscriber.name} failed")
                    break
                self.publish(target) if way == "publish" else self.emit(target, topics)


class Real:
    """The same by channels and a dispatcher."""

    def __init__(self, subscribers, loop):
        self.log, self.steps = [], 0
        self.dispatcher = Dispatcher(VirtualClock(), max_messages=256)
        self.dispatcher.open(loop)
        self.channels = [Channel(f"c{index}", State, self.dispatcher) for index in range(CHANNELS)]
        self.subscriptions = []
        for one in subscribers:
            fails = SimpleNamespace(fail=lambda _, one=one: self.log.append(f"{one.name} failed"))
            channel = self.channels[one.channel]
            self.subscriptions.append(channel.subscribe(partial(self.handle, one), fails, topics=one.topics))

    def handle(self, one, message):
        self.steps += 1
        last = [None if channel.last is None else channel.last.index for channel in self.channels]
        self.log.append((one.name, message.index, *(channel.published for channel in self.channels), *last))
        if self.steps > MOST:
            return
        for way, target, topics in one.script:
            channel = self.channels[target]
            new = state(channel.published + 1)
            if way == "raise":
                raise ValueError
            if way == "publish":
                channel.publish(new)
            elif way == "emit" and topics is None:
                channel.emit(new)
            elif way == "emit":
                channel.emit_on(new, one.topics_of[target, topics])
            elif topics is None:
                channel.emit_last(new)
            else:
                channel.emit_last_on(new, one.topics_of[target, topics])


@st.composite
def scripted(draw):
    """Return subscribers with what each does at a message; only what comes last may be emitted as the last thing."""
    subscribers = []
    for number in range(draw(st.integers(1, 6))):
        channels, ways = st.integers(0, CHANNELS - 1), st.sampled_from(["emit", "publish"])
        about = st.sampled_from([None, (), ("a",), ("b", "a")])
        script = draw(st.lists(st.tuples(ways, channels, about), max_size=2))
        last = draw(st.sampled_from([None, "last", "last", "raise"]))
        if last is not None:
            script.append((last, draw(channels), draw(about)))
        topics = draw(st.sampled_from([None, None, ("a",), ("a", "b")]))
        subscribers.append(
            SimpleNamespace(
                name=f"s{number}",
                channel=draw(channels),
                topics=topics,
                heeds=topics or (),
                script=script,
                topics_of={(target, names): Topics(*names) for _, target, names in script if names is not None},
            )
        )
    return subscribers


@given(subscribers=scripted(), stimuli=st.lists(st.integers(0, CHANNELS - 1), min_size=1, max_size=3))
def test_what_is_handed_on_by_a_call_comes_as_if_it_had_been_queued(subscribers, stimuli):
    plain = Plain(subscribers)
    loop = asyncio.new_event_loop()
    try:
        real = Real(subscribers, loop)
        turns = cuts = 0
        for channel in stimuli:
            before = plain.steps
            plain.turn(channel)
            turns += plain.steps > before
            # What comes behind the first cut is watched, for 256 messages, and then counted anew.
            steps = plain.steps - before
            cuts += (steps >= 256) + max(0, steps // 256 - 2)
            real.channels[channel].publish(state(real.channels[channel].published + 1))
            while real.dispatcher.active:
                loop.run_until_complete(asyncio.sleep(0))
        assert real.log == plain.log
        counts = real.dispatcher.statistics()
        assert (counts.turns, counts.interrupted) == (turns, cuts)
        handled = Counter(entry[0] for entry in plain.log if isinstance(entry, tuple))
        received = {one.name: sub.received for one, sub in zip(subscribers, real.subscriptions, strict=True)}
        assert all(received[one.name] == handled[one.name] for one in subscribers)
    finally:
        loop.close()


@pytest.mark.parametrize(("messages", "cuts"), [(255, 0), (256, 1), (257, 1)])
def test_what_is_handed_on_by_a_call_counts_as_any_message_of_a_turn(messages, cuts):
    loop = asyncio.new_event_loop()
    dispatcher = Dispatcher(VirtualClock(), max_messages=256)
    dispatcher.open(loop)
    first, second, third = (Channel(name, State, dispatcher) for name in "abc")
    first.subscribe(second.emit_last)
    second.subscribe(lambda _: [third.publish(state(0)) for _ in range(messages - 2)])
    third.subscribe(lambda _: None)
    first.publish(state(0))
    assert dispatcher.statistics().interrupted == cuts
    loop.run_until_complete(asyncio.sleep(0))
    assert (dispatcher.statistics().turns, third.published) == (1, messages - 2)
    loop.close()


def test_other_input_comes_behind_what_a_turn_that_is_cut_has_published_and_in_the_order_of_its_time():
    log = []

    async def main(runtime):
        dispatcher, channel = runtime.dispatcher, runtime.channel("x", State)
        channel.subscribe(lambda message: log.append((message.index, dispatcher.time)))
        clock.shown += 5
        clock.call_at(clock.shown + 10, lambda: dispatcher.deliver_due(timer, None, START + 15))
        timer = Subscription(None, None, lambda _: (log.append(("timer", dispatcher.time)), tell(runtime, 2)))
        dispatcher.deliver(Subscription(None, None, lambda _: cut(runtime, 20_000, channel)), None)
        assert dispatcher.active
        before = len(log)
        clock.shown += 20
        channel.publish(state(1))  # behind the timer, which was due before
        dispatcher.deliver(Subscription(None, None, lambda _: log.append(("direct", dispatcher.time))), None)
        assert log[before:] == [("timer", START + 15), ("direct", START + 25)]
        clock.shown += 5
        while dispatcher.active:
            await asyncio.sleep(0)
        rest = [entry for entry in log[before + 2 :] if entry[0] != 0]
        assert rest == [(2, START + 30), (1, START + 30)]
        assert len(log) == 20_000 + 4
        assert log[-2:] == rest

    def cut(runtime, number, channel):
        for _ in range(number):
            channel.publish(state(0))

    def tell(runtime, number):
        runtime.channel("x", State).publish(state(number))

    clock = HeldClock()

    async def program():
        async with Runtime(clock=clock, log=False, watchdog=None) as runtime:
            await main(runtime)

    asyncio.run(program())


@pytest.mark.parametrize("tasks", [False, True])
def test_a_runtime_in_which_virtual_time_stands_still_ends_and_names_the_circle(monkeypatch, tasks):
    if tasks:  # of which each turn takes some rounds of the event loop
        monkeypatch.setattr("mdm.runtime.dispatcher._AT_ONCE", 3_000)
        monkeypatch.setattr("mdm.runtime.time.virtual.LOOK_EVERY", 100)
        monkeypatch.setattr("mdm.runtime.dispatcher.LOOK_EVERY", 100)
    predicates = PredicateManager("predicates")
    lit = predicates.sensor("Lit", initial=False)

    async def soon(value):
        lit.set(value)

    act = soon if tasks else lit.set
    lamp = Ensemble(
        "lamp",
        policy=[0, 1],
        predicates=predicates,
        states=[StateFactor("lit", ["Lit"])],
        actions={"on": lambda: act(True), "off": lambda: act(False)},
    )
    count = []

    async def main(runtime):
        runtime.decisions.subscribe(count.append)
        await runtime.start(lamp)
        await asyncio.sleep(10)

    with pytest.raises(ActorFailure, match="^time stands still: ") as failure:
        run_virtual(main)
    told = str(failure.value)
    kind = "turns at one instant" if tasks else "messages of one turn at one instant"
    assert kind in told
    assert "'lamp/control' publishes on 'lamp/action'" in told
    assert told.endswith("what an action or a message leads to must not bring that about at once")
    assert 1_000 <= len(count) < 40_000
    assert {decision.time for decision in count} == {0}


def test_many_turns_at_one_instant_that_the_program_itself_begins_stop_no_time(monkeypatch):
    monkeypatch.setattr("mdm.runtime.dispatcher._AT_ONCE", 1_000)

    async def main(runtime):
        channel = runtime.channel("x", State)
        seen = probe(channel)
        for _ in range(5_000):
            channel.publish(state(0))
        await asyncio.sleep(1)
        for _ in range(3_000):
            await asyncio.sleep(0)
        return len(seen)

    assert run_virtual(main) == 5_000


@pytest.mark.parametrize("tasks", [False, True])
def test_what_ends_beside_a_circle_in_which_no_time_passes_has_its_time(monkeypatch, tasks):
    """What is stopped before the circle waits for a timer, which never came."""
    for name in ("dispatcher._AT_ONCE", "dispatcher.LOOK_EVERY", "time.virtual.LOOK_EVERY"):
        monkeypatch.setattr(f"mdm.runtime.{name}", 1_000)
    ended, most = [], 100_000

    class Circle(Actor):
        def on_running(self):
            self.rounds = 0
            self.subscribe(self.runtime.channel("x", State), self._go_round)

        def _go_round(self, message):
            self.rounds += 1
            if self.rounds == most:  # else it never ends
                ended.append(self.name)
            elif tasks:
                asyncio.get_running_loop().call_soon(self.runtime.channel("x", State).publish, message)
            else:
                self.runtime.channel("x", State).publish(message)

    class Lasting(Actor):
        async def on_stopping(self):
            await asyncio.sleep(0.05)
            ended.append(self.name)

    async def main(runtime):
        await runtime.start(Circle("circle"))
        await runtime.start(Lasting("lasting"))
        runtime.channel("x", State).publish(state(0))
        await asyncio.sleep(10)

    with pytest.raises(ActorFailure, match="^time stands still: "):
        run_virtual(main)
    assert ended == ["lasting"]
