"""What every transport promises, to run on each of them."""

from __future__ import annotations

import asyncio

import pytest
from patience import PATIENCE
from sentences import refused
from transports import LOOPBACK, SIMULATED, key

from mdm.errors import Error

pytestmark = pytest.mark.parametrize("world", [SIMULATED, LOOPBACK])


async def hear(net, sender, receiver):
    """Have one subscribe to the other, and hear it."""
    got = []
    receiver.subscribe("mdm/team/a/**", got.append)

    def put():
        sender.put(key("a"), b"")
        return got

    await net.until(put)


def test_messages_come_in_order_and_not_to_their_sender(world):
    async def main(net):
        first, second = net.transport("a"), net.transport("b")
        own, got = [], []
        first.subscribe("mdm/team/*/e/c", own.append)
        second.subscribe("mdm/team/*/e/c", got.append)
        await net.open(first, second)
        for number in range(100):
            assert first.put(key("a"), b"%d" % number)
        await net.until(lambda: len(got) == 100)
        assert [sample.body for sample in got] == [b"%d" % number for number in range(100)]
        assert {(sample.key, sample.owner, sample.incarnation) for sample in got} == {
            (key("a"), "a", first.incarnation)
        }
        assert own == []
        sent, received = first.statistics(), second.statistics()
        assert sent.sent[key("a")].messages == received.received[key("a")].messages == 100
        assert sent.sent[key("a")].bytes == received.received[key("a")].bytes > 100
        assert received.lateness.count == 100
        assert received.dropped == {}

    world(main)


def test_a_message_comes_once_to_each_handler_of_expressions_that_overlap(world):
    async def main(net):
        first, second = net.transport("a"), net.transport("b")
        got = []
        for number, expression in enumerate(["mdm/team/*/e/c", "mdm/team/a/**", "mdm/team/a/e/c", "mdm/team/a/e/*"]):
            second.subscribe(expression, lambda sample, number=number: got.append((number, sample.body)))
        await net.open(first, second)
        for number in range(20):
            first.put(key("a"), b"%d" % number)
        await net.until(lambda: len(got) >= 80)
        assert got == [(handler, b"%d" % number) for number in range(20) for handler in range(4)]
        assert second.statistics().dropped == {}

    world(main)


def test_what_is_subscribed_later_comes_too(world):
    async def main(net):
        first, second = net.transport("a"), net.transport("b")
        await net.open(first, second)
        await hear(net, first, second)

    world(main)


def test_watchers_see_who_comes_and_goes(world):
    async def main(net):
        first, second = net.transport("a"), net.transport("b")
        seen = []
        first.watch(seen.append)
        await net.open(first, second)
        assert seen[-1] == {"a": first.incarnation, "b": second.incarnation}
        late = []
        first.watch(late.append)
        await net.until(lambda: late)
        assert late == [seen[-1]]
        await second.close()
        await net.until(lambda: seen[-1] == {"a": first.incarnation})
        again = net.transport("b")
        await again.open()
        await net.until(lambda: "b" in seen[-1])
        assert seen[-1]["b"] == again.incarnation > second.incarnation

    world(main)


def test_who_is_seen_is_reached_by_the_first_message(world):
    async def main(net):
        first, second = net.transport("a"), net.transport("b")
        got = []
        second.subscribe("mdm/team/**", got.append)
        first.watch(lambda live: first.put(key("a"), b"hello") if "b" in live else None)
        await net.open(first, second)
        await net.until(lambda: got)

    world(main)


def test_questions_are_answered_by_all_who_serve(world):
    async def main(net):
        first, second, third = (net.transport(agent) for agent in "abc")
        for transport in (first, second, third):
            transport.serve(key(transport.agent, "call"), lambda body, name=transport.agent: body + name.encode())
        await net.open(first, second, third)
        assert await first.ask("mdm/team/*/e/call", b"I am ", timeout=PATIENCE) == {"b": b"I am b", "c": b"I am c"}
        assert await first.ask(key("c", "call"), b"and ", timeout=PATIENCE) == {"c": b"and c"}
        assert await first.ask(key("c", "other"), b"") == {}
        assert first.statistics().round_trips["c"].count >= 2

    world(main)


def test_one_that_cannot_answer_is_left_out_and_told_of(world):
    async def main(net):
        first, second, third = (net.transport(agent) for agent in "abc")
        failures = []
        second.supervise(failures.append, lambda kind, text: None)

        def fail(body):
            raise ValueError("no")

        second.serve(key("b", "call"), fail)
        third.serve(key("c", "call"), lambda body: b"yes")
        await net.open(first, second, third)
        assert await first.ask("mdm/team/*/e/call", timeout=0.5) == {"c": b"yes"}
        assert [str(failure) for failure in failures] == ["no"]

    world(main)


def test_a_failing_handler_is_told_and_others_go_on(world):
    async def main(net):
        first, second = net.transport("a"), net.transport("b")
        failures, got = [], []
        second.supervise(failures.append, lambda kind, text: None)

        def fail(sample):
            raise ValueError(sample.body)

        second.subscribe("mdm/team/a/**", fail)
        second.subscribe("mdm/team/a/**", got.append)
        await net.open(first, second)
        first.put(key("a"), b"1")
        first.put(key("a"), b"2")
        await net.until(lambda: len(got) == 2)
        assert [failure.args for failure in failures] == [(b"1",), (b"2",)]

    world(main)


def test_a_failing_handler_without_supervision_reaches_the_event_loop(world):
    async def main(net):
        first, second = net.transport("a"), net.transport("b")
        told = []
        asyncio.get_running_loop().set_exception_handler(lambda loop, context: told.append(context["exception"]))

        def fail(sample):
            raise ValueError(sample.body)

        second.subscribe("mdm/team/a/**", fail)
        await net.open(first, second)
        first.put(key("a"), b"1")
        await net.until(lambda: told)
        assert told[0].args == (b"1",)

    world(main)


def test_only_ones_own_keys_may_be_used(world):
    async def main(net):
        first = net.transport("a")
        await net.open(first)
        for wrong in (key("b"), "mdm/other/a/e/c", "a", "mdm/team/a/*"):
            with refused(Error):
                first.put(wrong, b"")
            with refused(Error):
                first.serve(wrong, bytes)
        first.serve(key("a"), bytes)
        with refused(Error):
            first.serve(key("a"), bytes)
        with refused(Error):
            first.put(key("a"), bytes(10_000_000))
        with refused(Error):
            first.subscribe("mdm//x", print)

    world(main)


def test_a_name_that_is_live_is_refused(world):
    async def main(net):
        first, second, again = net.transport("a"), net.transport("b"), net.transport("a")
        await net.open(first, second)
        with refused(Error):
            await again.open()
        await again.close()
        await hear(net, first, second)

    world(main)


def test_the_order_of_calls_is_minded(world):
    async def main(net):
        first = net.transport("a")
        with refused(Error):
            first.put(key("a"), b"")
        await net.open(first)
        with refused(Error):
            await first.open()
        await first.close()
        await first.close()
        assert first.put(key("a"), b"") is False
        assert first.statistics().dropped == {"closed": 1}
        with refused(Error):
            await first.ask("mdm/team/**")
        never = net.transport("b")
        await never.close()

    world(main)
