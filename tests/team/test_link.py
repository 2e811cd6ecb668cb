"""The link between a transport and the actors of an agent."""

from __future__ import annotations

import asyncio

import msgspec
import pytest

import mdm
from mdm.team.link import Beat, Link
from mdm.team.team import Team
from mdm.team.transport.keys import join
from mdm.team.transport.network import Network
from mdm.testing import probe, run_virtual

TEAM = Team("team", ["a", "b", "c"])


async def linked(runtime, network, name):
    link = Link(TEAM, network.transport(name), name=name)
    await runtime.start(link)
    link.connect()
    await asyncio.sleep(0.1)
    return link


def test_messages_come_in_turns_of_who_listens_until_it_stops():
    async def main(runtime):
        network = Network(runtime.clock)
        a, b = await linked(runtime, network, "a"), await linked(runtime, network, "b")
        heard, user = [], mdm.Actor("user")
        await runtime.start(user)
        first = b.listen(join("team", "*", "news"), lambda sample: heard.append((sample.owner, sample.body)), user)
        b.listen(join("team", "*", "news"), lambda _: heard.append(runtime.dispatcher.active), user)
        assert a.put(a.key("news"), b"1")
        await asyncio.sleep(0.1)
        assert heard == [("a", b"1"), True]
        b.drop([first])
        a.put(a.key("news"), b"2")
        await asyncio.sleep(0.1)
        assert heard[2:] == [True]

    run_virtual(main)


def test_a_stranger_is_told_once_and_lives_for_nobody():
    async def main(runtime):
        network, faults = Network(runtime.clock), probe(runtime.faults)
        a = await linked(runtime, network, "a")
        strangers = [network.transport(name) for name in ("x", *map(str, range(20)))]
        for stranger in strangers:
            await stranger.open()
        for _ in range(10):
            for stranger in strangers:
                stranger.put(join("team", stranger.agent, "beat"), msgspec.msgpack.encode({"a": 1}), priority="step")
            await asyncio.sleep(0.1)
        assert tuple(a.live) == ("a",)
        assert a._beats == a._heard_at == {}
        assert 0 < len(faults) <= 8
        assert faults[0].kind == "stranger"
        assert faults[0].detail == (
            "agent 'x' says that it is of team 'team', whose agents are a, b, c here: the team's name, or the file, is "
            "another one there"
        )

    run_virtual(main)


def test_who_is_live_is_told_at_each_change_and_who_leaves_is_not_lost():
    async def main(runtime):
        network = Network(runtime.clock, lease=0.5)
        a = await linked(runtime, network, "a")
        seen, user = [], mdm.Actor("user")
        await runtime.start(user)
        a.watch(lambda link: seen.append((tuple(link.live), tuple(link.left))), user)
        b = await linked(runtime, network, "b")
        c = await linked(runtime, network, "c")
        b.say_farewell()
        await asyncio.sleep(0.1)
        assert not b.put(b.key("news"), b"late")
        assert seen == [(("a",), ()), (("a", "b"), ()), (("a", "b", "c"), ()), (("a", "c"), ("b",))]
        await runtime.stop(b)
        network.crash("c")
        await asyncio.sleep(1.0)
        assert seen[-1] == (("a",), ("b",))
        await runtime.stop(c)
        again = await linked(runtime, network, "b")
        assert seen[-1] == (("a", "b"), ())
        assert again.live == {"a": 1, "b": 2}

    run_virtual(main)


def test_nothing_is_sent_before_it_is_open_and_a_second_close_does_nothing():
    async def main(runtime):
        network = Network(runtime.clock)
        link = Link(TEAM, network.transport("a"))
        await runtime.start(link)
        assert not link.put(link.key("news"), b"")
        link.connect()
        await asyncio.sleep(0.1)
        assert link.live == {"a": 1}
        await runtime.stop(link)
        await link.transport.close()

    run_virtual(main)


def test_a_transport_that_cannot_open_fails_the_program_in_words():
    async def main(runtime):
        network = Network(runtime.clock)
        await linked(runtime, network, "a")
        link = Link(TEAM, network.transport("a"), name="again")
        await runtime.start(link)
        link.connect()
        await asyncio.sleep(1.0)

    with pytest.raises(mdm.ActorFailure, match="live already"):
        run_virtual(main)


def test_what_is_too_large_is_told_and_harms_nothing():
    async def main(runtime):
        network = Network(runtime.clock)
        link = Link(TEAM, network.transport("a", largest=1000))
        await runtime.start(link)
        link.connect()
        await asyncio.sleep(0.1)
        faults = probe(runtime.faults)
        assert not link.put(link.key("news"), bytes(2000))
        assert not link.put(link.key("news"), bytes(2000))
        assert link.put(link.key("news"), b"short")
        assert [fault.kind for fault in faults] == ["oversize"]
        assert link.life == "running"

    run_virtual(main)


def test_a_live_agent_that_turns_to_another_configuration_is_gone_at_once_for_who_watches():
    """It was taken for live, says another thing in the same life, and is not told to go by anything that it says."""

    async def main(runtime):
        network = Network(runtime.clock, lease=60.0)
        a = Link(TEAM, network.transport("a"), {"model": "rooms"}, name="a")
        await runtime.start(a)
        a.connect()
        await asyncio.sleep(0.1)
        seen, user = [], mdm.Actor("user")
        await runtime.start(user)
        a.watch(lambda link: seen.append(tuple(link.live)), user)
        b = network.transport("b")
        await b.open()
        lives = {"a": a.transport.incarnation, "b": b.incarnation}

        def beat(model):
            said = Beat(TEAM.names, lives, {"model": model}, settled=False, company=1)
            b.put(join("team", "b", "beat"), msgspec.msgpack.encode(said), priority="step")

        beat("rooms")
        await asyncio.sleep(0.05)
        assert seen[-1] == ("a", "b")
        beat("doors")
        await asyncio.sleep(0.05)
        assert seen[-1] == ("a",)
        assert tuple(a.live) == ("a",)

    run_virtual(main)


@pytest.mark.parametrize(("seconds", "kinds"), [(2.9, []), (4.1, ["stopping"])])
def test_a_transport_may_take_its_time_to_close(seconds, kinds):
    async def main(runtime):
        faults = probe(runtime.faults)
        a = await linked(runtime, Network(runtime.clock), "a")
        close = a.transport.close

        async def close_late():
            await asyncio.sleep(seconds)
            await close()

        a.transport.close = close_late
        await runtime.stop(a)
        assert [fault.kind for fault in faults] == kinds

    run_virtual(main)
