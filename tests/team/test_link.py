"""The link between a transport and the actors of an agent."""

from __future__ import annotations

import asyncio

import msgspec
import pytest
from sentences import refused

import mdm
from mdm.team.link import Beat, Link
from mdm.team.team import Team
from mdm.team.transport.keys import join
from mdm.team.transport.network import Network
from mdm.team.transport.router import Packer
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
        assert a.send(a.key("news"), b"1")
        await asyncio.sleep(0.1)
        assert heard == [("a", b"1"), True]
        b.drop([first])
        a.send(a.key("news"), b"2")
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
        b.send_farewell()
        await asyncio.sleep(0.1)
        assert not b.send(b.key("news"), b"late")
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
        assert not link.send(link.key("news"), b"")
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

    with refused(mdm.ActorFailure):
        run_virtual(main)


def test_what_is_too_large_is_told_and_harms_nothing():
    async def main(runtime):
        network = Network(runtime.clock)
        link = Link(TEAM, network.transport("a", largest=1000))
        await runtime.start(link)
        link.connect()
        await asyncio.sleep(0.1)
        faults = probe(runtime.faults)
        assert not link.send(link.key("news"), bytes(2000))
        assert not link.send(link.key("news"), bytes(2000))
        assert link.send(link.key("news"), b"short")
        assert [fault.kind for fault in faults] == ["oversize"]
        assert link.life == "running"

    run_virtual(main)


def beats(transport, **facts):
    """Beat once, as an agent that hears all others and has these facts."""
    lives = dict.fromkeys(TEAM.names, 1)
    said = Beat(TEAM.names, lives, facts, settled=True, company=3)
    transport.put(join("team", transport.agent, "beat"), msgspec.msgpack.encode(said), priority="step")


async def alone(runtime, network):
    """Return a link with a fact of its own."""
    link = Link(TEAM, network.transport("a"), {"model": "rooms"}, name="a")
    await runtime.start(link)
    link.connect()
    await asyncio.sleep(0.1)
    return link


def test_a_live_agent_does_not_turn_to_another_configuration_in_one_life():
    """Whoever says so in its name has no say in who is live."""

    async def main(runtime):
        network = Network(runtime.clock)
        a, b = await alone(runtime, network), network.transport("b")
        faults = probe(runtime.faults)
        await b.open()
        beats(b, model="rooms")
        await asyncio.sleep(0.05)
        assert tuple(a.live) == ("a", "b")
        beats(b, model="doors")
        await asyncio.sleep(0.05)
        assert tuple(a.live) == ("a", "b")
        assert a.refusal is None
        assert [fault.kind for fault in faults] == ["incredible"]
        assert "says what its agent did not say before in this life: model is rooms at a" in faults[0].detail

    run_virtual(main)


@pytest.mark.parametrize("facts", [{"model": "rooms"}, {"model": "doors"}])
def test_a_beat_of_a_life_that_is_not_here_parts_nobody(facts):
    async def main(runtime):
        network = Network(runtime.clock)
        a, b = await alone(runtime, network), network.transport("b")
        told, user = [], mdm.Actor("user")
        await runtime.start(user)
        a.watch(lambda link: told.append((tuple(link.live), link.refusal)), user)
        await b.open()
        beats(b, model="rooms")
        await asyncio.sleep(0.05)
        told.clear()
        said = Beat(TEAM.names, dict.fromkeys(TEAM.names, 1), facts, settled=True, company=3)
        forged = Packer("b", 2**62, runtime.clock.now).pack(join("team", "b", "beat"), msgspec.msgpack.encode(said))
        a.transport.arrive(join("team", "b", "beat"), forged)
        await asyncio.sleep(0.05)
        assert told == []
        assert tuple(a.live) == ("a", "b")
        assert a.configuration.differing == {}

    run_virtual(main)


@pytest.mark.parametrize("back", ["agrees", "is silent", "leaves"])
def test_an_agent_that_is_refused_waits_for_the_other_and_goes_on(back):
    async def main(runtime):
        network = Network(runtime.clock)
        a, b = await alone(runtime, network), network.transport("b")
        told, user = [], mdm.Actor("user")
        await runtime.start(user)
        a.watch(lambda link: told.append(link.refusal), user)
        await b.open()
        beats(b, model="doors")
        await asyncio.sleep(0.05)
        assert a.refusal == a.configuration.last_refusal == told[-1] == "model is rooms at a and doors at b"
        beats(b, model="windows")  # whatever it says next
        await asyncio.sleep(0.05)
        assert a.life == "running"
        assert tuple(a.live) == ("a",)
        if back == "agrees":
            beats(b, model="rooms")
        elif back == "leaves":
            b.put(join("team", "b", "leaving"), b"")
        await asyncio.sleep(0.05 if back != "is silent" else 1.3)
        assert a.refusal is told[-1] is None
        assert tuple(a.live) == (("a", "b") if back == "agrees" else ("a",))
        assert a.life == "running"
        assert (a.configuration.last_refusal is None) == (back == "agrees")

    run_virtual(main)


def test_a_farewell_counts_of_the_life_that_is_here_and_as_long_as_it_does_not_beat():
    async def main(runtime):
        network = Network(runtime.clock)
        a, b = await alone(runtime, network), network.transport("b")
        await b.open()
        beats(b, model="rooms")
        await asyncio.sleep(0.05)
        b.put(join("team", "b", "leaving"), b"")
        await asyncio.sleep(0.05)
        assert tuple(a.live) == ("a",)
        beats(b, model="rooms")
        await asyncio.sleep(0.05)
        assert tuple(a.live) == ("a", "b")
        assert a.left == {}

    run_virtual(main)


@pytest.mark.parametrize("life", [0, 2, 99])
def test_a_farewell_of_another_life_counts_for_nothing(life):
    """Who was then lost would be taken for one that has left, and nobody be told."""

    async def main(runtime):
        network = Network(runtime.clock)
        a, b = await alone(runtime, network), network.transport("b")
        await b.open()
        assert b.incarnation not in {life, None}
        beats(b, model="rooms")
        await asyncio.sleep(0.05)
        farewell = join("team", "b", "leaving")
        a.transport.arrive(farewell, Packer("b", life, runtime.clock.now).pack(farewell, b""))
        await asyncio.sleep(0.05)
        assert (tuple(a.live), a.left) == (("a", "b"), {})

    run_virtual(main)


@pytest.mark.parametrize("facts", [{"model": "doors"}, {}])
def test_a_farewell_of_one_that_was_never_live_is_not_that_of_an_earlier_life(facts):
    """Neither of an agent of another configuration, nor of one that is not heard by then, nor of a stranger."""

    async def main(runtime):
        network = Network(runtime.clock)
        a, b, x = await alone(runtime, network), network.transport("b"), network.transport("x")
        await b.open()
        beats(b, model="rooms")
        await asyncio.sleep(0.05)
        assert a.joined == {"a": 1, "b": 1}
        network.crash("b")
        await asyncio.sleep(2.0)
        again = network.transport("b")
        await again.open()
        await x.open()
        if facts:
            beats(again, **facts)
            await asyncio.sleep(0.05)
        for transport in (again, x):
            transport.put(join("team", transport.agent, "leaving"), b"")
        await asyncio.sleep(0.05)
        assert tuple(a.live) == ("a",)
        assert a.joined == {"a": 1, "b": 1}
        beats(again, model="rooms")
        await asyncio.sleep(0.05)
        again.put(join("team", "b", "leaving"), b"")
        await asyncio.sleep(0.05)
        assert a.joined == {"a": 1}

    run_virtual(main)
