"""Messages of agents that are replayed together: each comes once it was sent; one that never was is found."""

from __future__ import annotations

import asyncio

from patience import PATIENCE

from mdm.replay.exchange import Exchange, ReplayTransport
from mdm.stimuli import Finished, Received


def received(time, agent, owner, body, *, life=1, sent=None, channel="votes"):
    key = f"team/{owner}/{channel}"
    return Received(time, agent, f"team/*/{channel}", key, owner, life, time - 1 if sent is None else sent, body)


def played(scripts, serving=()):
    """Replay agents, each of which sends some bodies and receives some messages, in turn; return what came when."""
    exchange, order = Exchange(), []
    transports = {agent: ReplayTransport(agent, 1) for agent in scripts}
    for agent, script in scripts.items():
        stimuli = [step for step in script if isinstance(step, Received | Finished)]
        exchange.add(agent, stimuli, {agent: transports[agent]}, lambda: 0)
    for agent, key in serving:
        transports[agent].serve(key, bytes)

    async def play(agent):
        for step in scripts[agent]:
            if isinstance(step, Received):
                await exchange.comes(step, 1)
                order.append((agent, step.body))
            elif isinstance(step, tuple):
                channel, body = step
                transports[agent].put(f"team/{agent}/{channel}", body)
            elif isinstance(step, bytes):
                transports[agent].put(f"team/{agent}/votes", step)
        exchange.leave(agent)

    async def main():
        await asyncio.gather(*map(play, scripts))

    asyncio.run(asyncio.wait_for(main(), PATIENCE))
    return exchange, order


END = Finished(1000)


def test_a_message_comes_when_it_was_sent_whoever_is_played_first():
    first, second = received(10, "a", "b", b"1"), received(20, "b", "a", b"2")
    for agents in (("a", "b"), ("b", "a")):
        scripts = {"a": [first, b"2", END], "b": [b"1", second, END]}
        exchange, order = played({agent: scripts[agent] for agent in agents})
        assert order == [("a", b"1"), ("b", b"2")]
        assert (exchange.received, exchange.unlike, exchange.unrepeated) == (2, [], 0)


def test_what_was_not_sent_is_found_and_comes_all_the_same():
    said = [received(10, "a", "b", b"yes"), received(20, "a", "b", b"forged")]
    exchange, order = played({"a": [*said, b"no", END], "b": [b"yes", received(30, "b", "a", b"no", sent=25), END]})
    assert exchange.received == 3
    assert exchange.unlike == [said[1]]
    assert order == [("a", b"yes"), ("a", b"forged"), ("b", b"no")]


def test_what_was_sent_too_late_is_found():
    early = received(10, "a", "b", b"yes")
    exchange, _ = played({"a": [early, b"go", END], "b": [received(20, "b", "a", b"go"), b"yes", END]})
    assert exchange.unlike == [early]


def test_one_message_does_not_come_twice():
    twice = [received(10, "a", "b", b"yes"), received(11, "a", "b", b"yes")]
    exchange, _ = played({"a": [*twice, END], "b": [b"yes", END]})
    assert exchange.unlike == [twice[1]]
    exchange, _ = played({"a": [*twice, END], "b": [b"yes", b"yes", END]})
    assert exchange.unlike == []


def test_agents_of_whom_there_is_no_record_and_what_comes_behind_its_end_are_not_compared():
    said = [
        received(10, "a", "c", b"of an agent without a record"),
        received(20, "a", "b", b"of another life", life=2),
        received(60, "a", "b", b"sent behind the end of the record", sent=55),
        received(61, "a", "a", b"of its own"),
    ]
    exchange, order = played({"a": [*said, END], "b": [Finished(50), received(70, "b", "c", b"", sent=69)]})
    assert (exchange.received, exchange.unlike) == (0, [])
    assert len(order) == 5


def test_channels_of_the_programs_own_are_counted_apart_unless_a_replay_sends_on_them():
    own = received(10, "a", "b", b"said by code", channel="door")
    derived = [received(time, "a", "b", body, channel="state") for time, body in ((20, b"0"), (30, b"1"))]
    serving = [("b", "team/b/door"), ("b", "team/b/state")]
    exchange, _ = played({"a": [own, *derived, END], "b": [("state", b"0"), END]}, serving)
    assert (exchange.received, exchange.unlike, exchange.unrepeated) == (2, [derived[1]], 1)
