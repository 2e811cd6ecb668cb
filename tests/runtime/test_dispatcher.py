"""Turns: their order, no re-entrance, their length, and messages of other threads."""

from __future__ import annotations

import asyncio
import threading
from collections import deque

import pytest
from hypothesis import given, strategies as st
from recorded import state

from mdm import Actor, Error, Runtime, run
from mdm.messages import State
from mdm.runtime import Dispatcher, WallClock
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
                if len(seen) == 4000:
                    done.set()

            channel.subscribe(take)
            threads = [
                threading.Thread(target=lambda base=base: [channel.publish(state(base + i)) for i in range(1000)])
                for base in range(0, 4000, 1000)
            ]
            for thread in threads:
                thread.start()
            await done.wait()
            for thread in threads:
                thread.join()
            assert sorted(seen) == list(range(4000))
            for base in range(0, 4000, 1000):  # first in, first out for each thread
                own = [number for number in seen if base <= number < base + 1000]
                assert own == sorted(own)
            assert runtime.statistics().dispatcher.from_threads == 4000
            return runtime, channel

    runtime, channel = run(main, uvloop=uvloop)
    failures = []

    def late():
        try:
            channel.publish(state(0))
        except Error as error:
            failures.append(str(error))

    thread = threading.Thread(target=late)
    thread.start()
    thread.join()
    assert "while its runtime did not run" in failures[0]
    assert runtime.statistics().dispatcher.refused == 1


def test_a_dispatcher_survives_an_interrupt_in_a_handler():
    async def main(runtime):
        channel = runtime.channel("x", State)
        seen = []

        def interrupt(message):
            if message.index == 0:
                raise KeyboardInterrupt
            seen.append(message.index)

        channel.subscribe(interrupt)
        with pytest.raises(KeyboardInterrupt):
            channel.publish(state(0))
        channel.publish(state(1))
        await asyncio.sleep(0)
        assert seen == [1]

    run_virtual(main)


def test_a_dispatcher_needs_no_runtime():
    dispatcher = Dispatcher(WallClock())
    assert dispatcher.statistics().turns == 0
