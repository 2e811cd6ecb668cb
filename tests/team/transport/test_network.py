from __future__ import annotations

import asyncio

import pytest
from sentences import refused
from transports import SIMULATED, key

from mdm.errors import ConfigError, Error
from mdm.runtime import VirtualClock
from mdm.team.transport.network import Network


async def exchange(net, count=400):
    """Send messages under two keys; return what came."""
    first, second = net.transport("a"), net.transport("b")
    got = []
    second.subscribe(
        "mdm/team/a/**", lambda sample: got.append((sample.key, int(sample.body), net.network.clock.now()))
    )
    await net.open(first, second)
    for number in range(count):
        first.put(key("a", f"c{number % 2}"), b"%d" % number)
        await asyncio.sleep(0.0005)
    await asyncio.sleep(1)
    return got, second.statistics()


def run(**options):
    result = []

    async def main(net):
        result.append(await exchange(net))

    SIMULATED(main, **options)
    return result[0]


def test_one_seed_gives_one_run_and_another_another():
    chances = {"loss": 0.2, "duplication": 0.2, "reordering": 0.2, "delay": (0.001, 0.01)}
    assert run(seed=1, **chances)[0] == run(seed=1, **chances)[0] != run(seed=2, **chances)[0]


def test_losses_are_counted_at_the_receiver():
    got, statistics = run(loss=0.3, seed=3)
    assert 200 < len(got) < 360
    # the losses after the last that came are unknown to the receiver
    assert 400 - len(got) - 10 <= statistics.dropped["missing"] <= 400 - len(got)
    assert sum(statistics.lost.values()) == statistics.dropped["missing"]


def test_duplicates_are_dropped():
    got, statistics = run(duplication=0.5, seed=3)
    assert [number for _, number, _ in got] == list(range(400))
    assert 100 < statistics.dropped["repeated"] < 300


def test_what_is_overtaken_by_a_newer_of_its_key_is_dropped():
    got, statistics = run(reordering=0.5, delay=(0.001, 0.01), seed=3)
    for one in ("c0", "c1"):
        numbers = [number for name, number, _ in got if name == key("a", one)]
        assert numbers == sorted(numbers)
    assert [number for _, number, _ in got] != sorted(number for _, number, _ in got)
    assert statistics.dropped["repeated"] > 10


def test_without_reordering_all_messages_keep_their_order_whatever_their_delay():
    got, statistics = run(delay=(0, 0.05), seed=3)
    assert [number for _, number, _ in got] == list(range(400))
    assert 0 < statistics.lateness.maximum < 0.06


@pytest.mark.parametrize("seed", range(8))
def test_an_end_does_not_overtake_what_was_put_before_it(seed):
    """Nor where others make an agent look, or a new life of its name begins: it is seen behind the farewell."""

    async def main(net):
        a, b, c = (net.transport(agent) for agent in "abc")
        seen = []
        b.subscribe("mdm/team/a/**", lambda sample: seen.append(sample.body))
        b.watch(lambda live: seen.append(live.get("a")))
        await net.open(a, b)
        await asyncio.sleep(0.1)
        for number in range(5):
            a.put(key("a"), b"%d" % number)
        await a.close()
        await net.open(c)
        again = net.transport("a")
        if seed % 2:
            await net.open(again)
        await asyncio.sleep(0.2)
        assert [each for each in seen if isinstance(each, bytes)] == [b"0", b"1", b"2", b"3", b"4"]
        assert set(seen[: seen.index(b"4")]) <= {1, None, b"0", b"1", b"2", b"3"}
        assert None not in seen[seen.index(1) : seen.index(b"4")]
        assert seen[-1] == (2 if seed % 2 else None)
        assert b.live.get("a") == seen[-1]

    SIMULATED(main, delay=(0, 0.05), seed=seed)


def test_who_left_beyond_a_partition_is_hidden_by_it():
    async def main(net):
        a, b = net.transport("a"), net.transport("b")
        await net.open(a, b)
        await asyncio.sleep(0.1)
        await a.close()
        net.network.partition({"a"}, {"b"})
        b.look()
        assert set(b.live) == {"b"}

    SIMULATED(main, delay=0.05)


def test_a_partition_hides_agents_after_the_lease_and_heals():
    async def main(net):
        a, b, c = (net.transport(agent) for agent in "abc")
        got = []
        b.subscribe("mdm/team/a/**", got.append)
        await net.open(a, b, c)
        net.network.partition({"a"}, {"b", "c"})
        a.put(key("a"), b"lost")
        assert await a.ask("mdm/team/**") == {}
        await asyncio.sleep(0.9)
        assert set(b.live) == {"a", "b", "c"}
        await asyncio.sleep(0.2)
        assert (set(a.live), set(b.live), set(c.live)) == ({"a"}, {"b", "c"}, {"b", "c"})
        net.network.heal()
        await asyncio.sleep(0.01)
        assert set(a.live) == set(b.live) == {"a", "b", "c"}
        a.put(key("a"), b"comes")
        await asyncio.sleep(0.01)
        assert [sample.body for sample in got] == [b"comes"]

    SIMULATED(main)


def test_a_short_partition_is_not_noticed():
    async def main(net):
        a, b = net.transport("a"), net.transport("b")
        seen = []
        await net.open(a, b)
        a.watch(seen.append)
        net.network.partition({"a"}, {"b"})
        await asyncio.sleep(0.5)
        net.network.heal()
        await asyncio.sleep(2)
        assert len(seen) == 1

    SIMULATED(main)


def test_a_crashed_agent_is_silent_and_returns_in_a_new_life():
    async def main(net):
        a, b = net.transport("a"), net.transport("b")
        got, lives = [], []
        a.subscribe("mdm/team/b/**", got.append)
        a.watch(lambda live: lives.append(live.get("b")))
        await net.open(a, b)
        b.put(key("b"), b"on its way")
        net.network.crash("b")
        assert b.put(key("b"), b"dead") is False
        await asyncio.sleep(2)
        assert lives[-1] is None
        again = net.transport("b")
        await net.open(again)
        again.put(key("b"), b"back")
        await asyncio.sleep(0.1)
        assert (lives[-1], again.incarnation) == (2, 2)
        assert [sample.body for sample in got] == [b"on its way", b"back"]
        with refused(Error):
            net.network.crash("x")

    SIMULATED(main)


def test_messages_to_a_crashed_agent_and_its_answers_are_lost():
    async def main(net):
        a, b = net.transport("a"), net.transport("b")
        got = []
        b.subscribe("mdm/team/a/**", got.append)
        b.serve(key("b", "call"), lambda body: b"yes")
        await net.open(a, b)
        a.put(key("a"), b"")
        asked = asyncio.ensure_future(a.ask(key("b", "call"), timeout=0.5))
        await asyncio.sleep(0)
        net.network.crash("b")
        assert await asked == {}
        assert got == []

    SIMULATED(main)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"loss": 2}, "loss is a chance between 0 and 1, not 2"),
        ({"duplication": None}, "duplication is a chance"),
        ({"delay": -1}, "the delay is"),
        ({"delay": (2, 1)}, "the delay is"),
        ({"lease": "1"}, "the lease is"),
        ({"team": "a/b"}, "the name of a team"),
    ],
)
def test_wrong_options_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        Network(VirtualClock(), **options)
