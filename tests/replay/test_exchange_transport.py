"""The transport of a replay: it hands on what the record has, and keeps what is sent."""

from __future__ import annotations

import asyncio

from mdm.replay.exchange import ReplayTransport
from mdm.stimuli import Received


def test_recorded_messages_come_to_those_who_listen():
    transport = ReplayTransport("a", 7)
    found, live = [], []
    transport.subscribe("team/*/votes", found.append)
    transport.watch(live.append)
    transport.receive(Received(5, "a", "team/*/votes", "team/b/votes", "b", 3, 4, b"yes"))
    transport.receive(Received(6, "a", "team/*/others", "team/b/others", "b", 3, 4, b"no"))
    transport.see({"a": 7, "b": 3})
    (sample,) = found
    assert (sample.key, sample.owner, sample.incarnation, bytes(sample.body), sample.time) == (
        *("team/b/votes", "b", 3, b"yes", 4),
    )
    assert live == [{"a": 7, "b": 3}]


def test_messages_that_were_held_back_are_again():
    class Sent:
        def __init__(self):
            self.messages = []

        def send(self, *message):
            self.messages.append(message)

    transport = ReplayTransport("a", 7, frozenset({2}))
    assert transport.put("key", b"0")
    assert not transport.put("key", b"1")
    transport.exchange = Sent()
    assert transport.put("key", b"2")
    assert transport.exchange.messages == [("a", 7, "key", b"2")]


def test_it_opens_when_the_record_did():
    async def main():
        transport = ReplayTransport("a", 7)
        opening = asyncio.ensure_future(transport.open())
        await asyncio.sleep(0)
        assert not opening.done()
        transport.release()
        await opening
        await transport.close()

    asyncio.run(main())


def test_nobody_answers_in_a_replay():
    async def main():
        transport = ReplayTransport("a", 7)
        asking = asyncio.ensure_future(transport.ask("team/*/state"))
        await asyncio.sleep(0)
        assert not asking.done()
        asking.cancel()

    asyncio.run(main())
