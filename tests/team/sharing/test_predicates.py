"""Predicates and events of other agents, in formulas and factors."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import msgspec
import pytest
from sentences import refused
from team_robots import over_beliefs

import mdm
from mdm import P, problems
from mdm.messages import EventUpdate, PredicateUpdate
from mdm.team.link import Link
from mdm.team.sharing.predicates import Change, PredicatePublisher, PredicateSubscriber, Reply, Request
from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.testing import probe, run_virtual


class Walker:
    """A robot with a sensor and an event, that looks at those of the other one."""

    def __init__(self, team, name, network, declare=None, **options):
        self.did = []
        self.manager = mdm.PredicateManager()
        self.moving = self.manager.sensor("IsMoving", initial=False)
        self.arrived = self.manager.event("Arrived")
        self.manager.define("BothMove", P("robot1/IsMoving") & P("robot2/IsMoving"))
        self.met = self.manager.event("robot2/Arrived")
        if declare is not None:
            declare(self.manager)
        self.ensemble = over_beliefs(problems.dec_tiger())(
            self, team.names.index(name), predicates=self.manager, **options
        )
        self.member = team.member(name, self.ensemble, transport=network.transport(name))

    def act(self, name):
        return lambda: self.did.append(name)


def walkers():
    return Team("walk", ["robot1", "robot2"], max_age=1.0)


async def two(runtime, network, declare=None, **options):
    pair = [Walker(walkers(), name, network, declare, **options) for name in walkers().names]
    for walker in pair:
        await runtime.start(walker.member)
    await asyncio.sleep(0.5)
    return pair


def test_formulas_use_those_of_others_and_the_own_ones_by_their_full_names():
    async def main(runtime):
        network = Network(runtime.clock, team="walk")
        one, two_ = await two(runtime, network)
        for walker in (one, two_):
            assert walker.manager.values()["robot1/IsMoving"] is False
            assert walker.manager.values()["robot2/IsMoving"] is False
        two_.moving.set(True)
        await asyncio.sleep(0.1)
        assert one.manager.value("robot2/IsMoving") is True
        assert one.manager.value("BothMove") is False
        one.moving.set(True)
        await asyncio.sleep(0.1)
        assert one.manager.value("BothMove") is True
        assert two_.manager.value("BothMove") is True

    run_virtual(main)


def test_events_of_others_are_raised_here():
    async def main(runtime):
        network = Network(runtime.clock, team="walk")
        one, two_ = await two(runtime, network)
        heard = {walker: probe(walker.manager.events) for walker in (one, two_)}
        two_.arrived.fire()
        one.arrived.fire()
        await asyncio.sleep(0.1)
        assert [update.events for update in heard[one] if "robot2/Arrived" in update.events] == [("robot2/Arrived",)]
        assert [update.events for update in heard[two_] if "robot2/Arrived" in update.events] == [("robot2/Arrived",)]

    run_virtual(main)


def test_they_are_unknown_when_their_owner_is_gone_or_silent_and_known_when_it_is_back():
    async def main(runtime):
        network = Network(runtime.clock, team="walk", lease=3.0)
        one, two_ = await two(runtime, network)
        network.partition({"robot1"}, {"robot2"})
        await asyncio.sleep(1.6)  # the lease is not over: it is its age that makes it unknown
        assert one.manager.value("robot2/IsMoving") is None
        assert one.manager.value("robot1/IsMoving") is False
        two_.moving.set(True)
        network.heal()
        await asyncio.sleep(3.0)
        assert one.manager.value("robot2/IsMoving") is True
        await runtime.stop(two_.member)
        await asyncio.sleep(0.5)
        assert one.manager.value("robot2/IsMoving") is None
        back = Walker(walkers(), "robot2", network)
        await runtime.start(back.member)
        await asyncio.sleep(1.0)
        assert one.manager.value("robot2/IsMoving") is False

    run_virtual(main)


@pytest.mark.parametrize("seed", range(4))
def test_what_is_lost_on_the_way_is_made_good(seed):
    async def main(runtime):
        network = Network(runtime.clock, team="walk", loss=0.3, seed=seed, delay=(0.001, 0.02))
        one, two_ = await two(runtime, network)
        for moving in (True, False, True, True, False, True):
            two_.moving.set(moving)
            await asyncio.sleep(0.3)
        network.loss = 0.0
        await asyncio.sleep(2.5)
        assert one.manager.value("robot2/IsMoving") is True

    run_virtual(main)


@pytest.mark.parametrize(("loss", "known"), [(0.1, 20), (0.2, 17)])
@pytest.mark.parametrize("seed", range(12))
def test_a_lossy_network_that_heals_is_soon_made_good(seed, loss, known):
    """Of five messages one is lost: once in 600 four in a row are, and for a quarter of a second nothing is known."""

    async def main(runtime):
        network = Network(runtime.clock, team="walk", loss=loss, seed=seed, delay=(0.001, 0.02))
        one, two_ = await two(runtime, network)
        for moving in (True, False):
            network.partition({"robot1"}, {"robot2"})
            await asyncio.sleep(5.0)
            assert one.manager.value("robot2/IsMoving") is None
            two_.moving.set(moving)
            network.heal()
            await asyncio.sleep(1.0)
            values = []
            for _ in range(20):
                await asyncio.sleep(0.1)
                values.append(one.manager.value("robot2/IsMoving"))
            assert (not moving) not in values
            assert values.count(moving) >= known

    run_virtual(main)


def test_a_change_that_is_lost_is_made_good_within_a_quarter_of_the_greatest_age():
    async def main(runtime):
        network = Network(runtime.clock, team="walk", delay=0.01)
        one, two_ = await two(runtime, network)
        network.loss = 1.0
        two_.moving.set(True)
        await asyncio.sleep(0.02)
        network.loss = 0.0
        assert one.manager.value("robot2/IsMoving") is False
        await asyncio.sleep(0.27)
        assert one.manager.value("robot2/IsMoving") is True

    run_virtual(main)


def test_a_manager_that_begins_anew_soon_knows_those_of_all_agents_again():
    async def main(runtime):
        network = Network(runtime.clock, team="walk")
        one, two_ = await two(runtime, network, supervision=mdm.Restart())
        two_.moving.set(True)
        await asyncio.sleep(0.1)
        one.manager.fail(RuntimeError("a fault"))
        await asyncio.sleep(1.0)
        assert one.ensemble.life == "running"
        one.moving.set(True)
        await asyncio.sleep(0.1)
        assert one.manager.value("robot2/IsMoving") is True
        assert one.manager.value("BothMove") is True

    run_virtual(main)


def test_a_name_that_the_other_agent_does_not_have_is_told():
    async def main(runtime):
        network = Network(runtime.clock, team="walk")
        faults = probe(runtime.faults)
        await two(runtime, network, lambda manager: manager.define("Typo", P("robot2/IsMovin")))
        assert any("no predicate or event 'IsMovin'" in fault.detail and "IsMoving" in fault.detail for fault in faults)

    run_virtual(main)


def test_a_predicate_of_no_agent_is_refused():
    async def main(runtime):
        network = Network(runtime.clock, team="walk")
        with refused(mdm.ConfigError):
            Walker(walkers(), "robot1", network, lambda manager: manager.define("X", P("robot7/IsMoving")))

    run_virtual(main)


def test_garbage_harms_nobody():
    async def main(runtime):
        network = Network(runtime.clock, team="walk")
        one, two_ = await two(runtime, network)
        transport = two_.member.link.transport
        for body in (b"", b"\xc1", b"\x94\x01\x01\x80\x90", b"\x93\xc0\xc0\xc0"):
            transport.put("mdm/walk/robot2/predicates/changes", body)
            transport.put("mdm/walk/robot2/beat", body, priority="step")
            transport.put("mdm/walk/robot2/joint/agreement/all", body, priority="step")
            await transport.ask("mdm/walk/robot1/predicates/follow", body)
        await asyncio.sleep(1.0)
        two_.moving.set(True)
        await asyncio.sleep(1.5)
        assert one.manager.value("robot2/IsMoving") is True
        assert one.member.life == "running"

    run_virtual(main)


def told_of(manager, network, team=None):
    """What tells others of a manager's predicates, which lives beside it, and what it puts on its link."""
    put = []
    link = Link(team or walkers(), network.transport("robot1"), name="link")
    link.send = lambda key, body, **_: put.append(body) or True
    return PredicatePublisher(link, [manager]), put


def test_what_has_stopped_tells_no_more_of_a_manager_that_goes_on():
    async def main(runtime):
        manager = mdm.PredicateManager()
        moving, arrived = manager.sensor("IsMoving", initial=False), manager.event("Arrived")
        await runtime.start(manager)
        told, put = told_of(manager, Network(runtime.clock, team="walk"))
        await runtime.start(told)
        told.reply(Request(("IsMoving",), ("Arrived",)))
        moving.set(True)
        arrived.fire()
        assert len(put) == 2
        heard = [runtime.channel(f"{manager.path}/{name}", kind) for name, kind in CHANNELS]
        assert [channel.statistics().subscribers for channel in heard] == [1, 1]
        await runtime.stop(told)
        moving.set(False)
        arrived.fire()
        assert len(put) == 2
        assert [channel.statistics().subscribers for channel in heard] == [0, 0]

    run_virtual(main)


def test_what_has_stopped_listens_to_the_other_agents_no_more():
    async def main(runtime):
        one, _ = await two(runtime, Network(runtime.clock, team="walk"))
        followed = next(child for child in one.member.children if child.name.startswith("robot2 for"))
        link = one.member.link
        heard = [*link._watching, *(each for known in link._heard.values() for each in known)]
        await runtime.stop(followed)
        left = [*link._watching, *(each for known in link._heard.values() for each in known)]
        assert [each for each in heard if each.actor is followed] != []
        assert [each for each in left if each.actor is followed] == []

    run_virtual(main)


@pytest.mark.parametrize("max_age", [0.5, 1.0, 3.0])
def test_all_values_are_sent_four_times_within_the_greatest_age(max_age):
    async def main(runtime):
        manager = mdm.PredicateManager()
        manager.sensor("IsMoving", initial=False)
        await runtime.start(manager)
        team = Team("walk", ["robot1", "robot2"], max_age=max_age)
        publisher, put = told_of(manager, Network(runtime.clock, team="walk"), team)
        await runtime.start(publisher)
        publisher.reply(Request(("IsMoving",), ()))
        await asyncio.sleep(5.05 * max_age)
        return [msgspec.msgpack.decode(body, type=Change).time / 1e9 for body in put]

    times = run_virtual(main)
    assert times == pytest.approx([number * max_age / 4 for number in range(len(times))])
    assert len(times) == 21


CHANNELS = [("updates", PredicateUpdate), ("events", EventUpdate)]


@pytest.mark.parametrize(
    ("number", "known"),
    [
        (4, None),  # what has changed since came before it
        (5, True),  # of the same change, and yet it tells of what nobody had asked for by then
        (6, True),
    ],
)
def test_a_reply_counts_unless_it_is_older_than_what_was_heard_meanwhile(number, known):
    async def main(runtime):
        manager = mdm.PredicateManager()
        manager.define("Goes", P("robot2/IsMoving"))
        names = Request(("IsMoving",), ())
        link = Link(walkers(), Network(runtime.clock, team="walk").transport("robot1"), name="link")
        await runtime.start(link)
        asked = asyncio.get_running_loop().create_future()
        link.ask_one = lambda *_: asked
        heard = {}
        link.listen = lambda _, handler, __: heard.setdefault("sample", handler)
        link.watch = lambda handler, _: heard.setdefault("live", handler)
        link.drop = lambda _: None
        followed = PredicateSubscriber(link, "robot2", manager, names, PredicatePublisher(link, []), name="followed")
        followed.prepare(runtime)
        await runtime.start(manager)
        await runtime.start(followed)
        link.live = {"robot2": 7}
        heard["live"](link)
        await asyncio.sleep(0)  # it has asked
        change = msgspec.msgpack.encode(Change(5, 0, {"Other": False}))
        heard["sample"](SimpleNamespace(body=change, incarnation=7))
        asked.set_result(Reply(number, {"IsMoving": True}, {}))
        await asyncio.sleep(0.1)
        assert manager.value("robot2/IsMoving") is known

    run_virtual(main)


def test_nobody_has_an_agent_look_for_names_without_end():
    """To look for similar names takes time, and the loop waits for it."""
    manager = mdm.PredicateManager()
    for number in range(100):
        manager.sensor(f"Door{number}")
    transport = SimpleNamespace(serve=lambda key, answer: None)
    told = PredicatePublisher(SimpleNamespace(key=lambda *parts: "/".join(parts), transport=transport), [manager])
    told._listen = lambda: None
    assert told._answer(msgspec.msgpack.encode([[f"Door{number}x" for number in range(2000)], []])) == b""
    answer = msgspec.msgpack.decode(told._answer(msgspec.msgpack.encode([[f"Door{n}x" for n in range(1000)], []])))
    assert len(answer[2]) == 1000
    assert 0 < sum(1 for hint in answer[2].values() if hint) <= 16
