"""Channels: what they keep, for whom they make it, and what they refuse."""

from __future__ import annotations

import asyncio
import gc
import weakref
from functools import partial

import pytest
from recorded import state
from sentences import refused

from mdm import Actor, Channel, Error, Restart, VirtualClock
from mdm.messages import Fault, State, Tick
from mdm.runtime.channel import Topics
from mdm.runtime.dispatcher import Dispatcher
from mdm.testing import crash, probe, run_virtual


def test_a_retained_message_reaches_late_subscribers():
    async def main(runtime):
        channel = runtime.channel("x", State, retain=True)
        channel.publish(state(1))
        channel.publish(state(2))
        assert [message.index for message in probe(channel)] == [2]
        assert probe(runtime.channel("y", State)) == []
        counted = runtime.channel("counted", State)
        counted.retain_by(lambda: state(counted.published))
        counted.publish(state(7))
        assert [message.index for message in probe(counted)] == [1]

    run_virtual(main)


def test_the_channels_of_an_actor_that_has_ended_are_given_back_when_nobody_listens():
    async def main(runtime):
        before = runtime.channels
        actor = Actor("actor")
        await runtime.start(actor)
        heard, kept, _ = (actor.channel(name, State, retain=True) for name in ("heard", "kept", "left"))
        stream = heard.stream()
        kept.publish(state(1))
        await runtime.stop(actor)
        assert runtime.channels == (*before, heard)
        assert probe(kept) == []
        stream.close()
        assert runtime.channels == before
        assert runtime.channel("actor/kept", State) is kept  # whoever has kept it publishes to those who come

        another = Actor("actor")
        await runtime.start(another)
        assert another.channel("kept", State) is kept
        subscription = kept.subscribe(str)
        subscription.cancel()
        assert kept in runtime.channels  # its actor lives

    run_virtual(main)


def test_an_actor_that_starts_anew_keeps_its_channels():
    class Starter(Actor):
        def on_start(self):
            self.channel("x", State, retain=True)

    async def main(runtime):
        actor = Starter("actor", supervision=Restart())
        await runtime.start(actor)
        actor.channel("x", State).publish(state(1))
        crash(actor)
        await asyncio.sleep(1)
        assert [message.index for message in probe(runtime.channel("actor/x", State))] == [1]

    run_virtual(main)


def test_a_costly_message_is_made_for_those_who_come():
    async def main(runtime):
        made = []

        def make(index):
            made.append(index)
            return state(index)

        channel = runtime.channel("x", State, retain=True)
        forgetful = runtime.channel("y", State)
        for index in (1, 2):
            channel.emit_later(index, partial(make, index))
            forgetful.emit_later(index, partial(make, index))
        found = channel.statistics()
        assert (made, found.published, found.unheard, found.last) == ([], 2, 2, 2)
        assert [message.index for message in probe(channel)] == [2]
        assert [message.index for message in probe(channel)] == [2]
        assert probe(forgetful) == []
        assert made == [2]

    run_virtual(main)


def test_a_channel_takes_one_type_only():
    async def main(runtime):
        with refused(TypeError):
            runtime.channel("x", State).publish(Tick(0, 0, 0, 0))
        with refused(Error):
            runtime.channel("x", Tick)
        for name, kind in (("x", "State"), (1, State)):
            with refused(Error):
                runtime.channel(name, kind)
        with refused(Error):
            runtime.channel("x", State).subscribe(str, topics="Up")

    run_virtual(main)


def test_messages_that_nobody_takes_are_counted():
    async def main(runtime):
        channel = runtime.channel("x", State)
        channel.publish(state(1))
        assert channel.statistics().unheard == 1

    run_virtual(main)


def test_topics_reach_only_those_who_asked_for_them():
    async def main(runtime):
        channel = runtime.channel("x", State)
        seen = {name: [] for name in ("all", "ab", "c")}
        actor = Actor("actor")
        await runtime.start(actor)
        channel.subscribe(lambda message: seen["all"].append(message.index))
        both = actor.subscribe(channel, lambda message: seen["ab"].append(message.index), topics=["a", "b"])
        actor.subscribe(channel, lambda message: seen["c"].append(message.index), topics=["c"])

        def emit():
            channel.emit_on(state(1), Topics("a", "b"))
            channel.emit_on(state(2), Topics("c", "a"))
            channel.emit_on(state(3), Topics("d"))

        actor.call_later(0, emit)
        await asyncio.sleep(1)
        assert seen == {"all": [1, 2, 3], "ab": [1, 2], "c": [2]}
        channel.publish(state(4))  # without topics, for all
        assert [numbers[-1] for numbers in seen.values()] == [4, 4, 4]
        assert both.received == 3
        both.cancel()
        actor.call_later(0, emit)
        await asyncio.sleep(1)
        assert seen["ab"] == [1, 2, 4]
        assert channel.statistics().subscribers == 2

    run_virtual(main)


@pytest.mark.parametrize("alone", [True, False])
def test_a_subscription_to_topics_counts_alike_what_is_published_and_what_is_emitted(alone):
    async def main(runtime):
        actor, channel, ways = Actor("actor"), runtime.channel("x", State), runtime.channel("ways", State)
        seen = []
        await runtime.start(actor)
        subscription = actor.subscribe(channel, lambda message: seen.append(message.index), topics=["a"])
        if not alone:
            channel.subscribe(lambda _: None)
        means = [
            channel.publish,
            channel.emit,
            channel.emit_last,
            lambda message: channel.emit_later(message.time, lambda: message),
            lambda message: channel.emit_on(message, Topics("a", "b")),
            lambda message: channel.emit_last_on(message, Topics("a")),
            lambda message: channel.emit_on(message, Topics("b")),
        ]
        ways.subscribe(lambda message: means[message.index](state(message.index)))
        for number in range(len(means)):
            ways.publish(state(number))
        assert seen == [0, 1, 2, 3, 4, 5]
        assert subscription.received == actor.statistics().received == len(seen)

    run_virtual(main)


def test_a_subscription_counts_what_it_was_handed():
    async def main(runtime):
        channel = runtime.channel("x", State)
        channel.publish(state(0))
        seen = []
        subscription = channel.subscribe(seen.append)
        for number in (1, 2):
            channel.publish(state(number))
        subscription.cancel()
        subscription.cancel()
        channel.publish(state(3))
        assert [message.index for message in seen] == [1, 2]
        assert subscription.received == 2
        found = channel.statistics()
        assert (found.name, found.published, found.unheard, found.dropped, found.subscribers) == ("x", 4, 2, 0, 0)

    run_virtual(main)


def test_messages_that_wait_for_a_subscription_that_is_cancelled_are_dropped():
    async def main(runtime):
        channel = runtime.channel("x", State)
        seen = []
        channel.subscribe(lambda _: second.cancel())
        second = channel.subscribe(seen.append)
        channel.publish(state(1))
        assert seen == []
        assert (second.received, channel.statistics().dropped) == (0, 1)

    run_virtual(main)


def test_who_fails_at_a_fault_is_not_told_of_its_own():
    async def main(runtime):
        told = []

        def listen(fault):
            told.append(fault)
            raise ValueError("cannot bear it")

        actor = Actor("actor", supervision="stop")
        await runtime.start(actor)
        faults = probe(runtime.faults)
        actor.subscribe(runtime.faults, listen)
        runtime.root.report("test", "something")
        await asyncio.sleep(1)
        assert [fault.kind for fault in told] == ["test"]
        assert [fault.kind for fault in faults] == ["test", "exception"]
        assert actor.life == "failed"

    run_virtual(main)


def test_channels_are_held_weakly_like_anything_else():
    held = []
    for _ in range(1000):
        channel = Channel("news", Fault, Dispatcher(VirtualClock()))
        held.append(weakref.ref(channel))
    del channel
    gc.collect()
    assert not any(weak() for weak in held)
