"""Agents that have never met: of a replicated or centralised team none acts, unless a person says so."""

from __future__ import annotations

import asyncio

import pytest
from team_robots import Robot, over_beliefs

from mdm import problems
from mdm.cli.team.status import _troubles
from mdm.team.sharing.calls import ask
from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.testing import run_virtual

MODEL = problems.dec_tiger()
AGREEING = [{"mode": "replicated"}, {"mode": "replicated", "period": 0.5}, {"mode": "centralised", "period": 0.5}]


class Pair:
    """Two robots that cannot hear each other."""

    def __init__(self, runtime, theirs=None, **options):
        self.runtime = runtime
        self.network = Network(runtime.clock, team="tigers")
        self.network.partition({"ada"}, {"bob"})
        self.team = Team("tigers", ["ada", "bob"], **options)
        self.others = self.team if theirs is None else Team("tigers", theirs, **options)

    async def begin(self, *names, seconds=10.0):
        self.robots = [await self.robot(name) for name in names]
        await asyncio.sleep(seconds)
        return self.robots

    async def robot(self, name):
        def build(robot, agent):
            return over_beliefs(MODEL)(robot, agent, safe_action=robot.act("SAFE"))

        team = self.team if name == "ada" else self.others
        return await Robot(team, name, self.network, build).start(self.runtime)


@pytest.mark.parametrize("options", AGREEING)
def test_two_that_have_never_met_wait_safe_until_they_meet(options):
    async def main(runtime):
        pair = Pair(runtime, **options)
        robots = await pair.begin("ada", "bob")
        for robot, other in zip(robots, ("bob", "ada"), strict=True):
            assert robot.did == ["SAFE"]
            [cause] = [cause for cause in robot.ensemble.causes if cause.kind == "missing_teammate"]
            assert (robot.ensemble.mode, cause.detail) == ("safe", f"never met: {other}")
            assert robot.role == "waiting"
            [told] = [fault for fault in robot.faults if fault.kind == "missing_teammate"]
            assert "was never met: " in told.detail
            assert told.detail.endswith(f"until a start that is asked for here, {robot.name} decides nothing")
        pair.network.heal()
        await asyncio.sleep(5.0)
        assert [robot.ensemble.mode for robot in robots] == ["deciding"] * 2
        assert all(robot.did[1:] for robot in robots)

    run_virtual(main)


@pytest.mark.parametrize("options", AGREEING)
def test_a_person_s_start_lets_one_decide_alone(options):
    async def main(runtime):
        pair = Pair(runtime, **options)
        [ada] = await pair.begin("ada")
        asker = pair.network.transport("console")
        pair.network.heal()
        await asker.open()
        [status] = (await ask(asker, pair.team, "status")).values()
        assert (status["unmet"], status["mode"]) == (["bob"], "safe")
        told = {one.agent: one.confirmed for one in await pair.team.start(transport=asker, seconds=3.0)}
        assert told == {"ada": True, "bob": False}
        await asyncio.sleep(3.0)
        assert (ada.ensemble.mode, ada.role) == ("deciding", "leading")
        assert ada.did[1:]
        [status] = (await ask(asker, pair.team, "status")).values()
        assert status["unmet"] == []
        bob = await pair.robot("bob")
        await asyncio.sleep(3.0)
        assert bob.ensemble.mode == "deciding"

    run_virtual(main)


def test_who_was_stopped_before_its_end_and_comes_back_alone_starts_alone(tmp_path):
    async def main(runtime):
        pair = Pair(runtime, state=tmp_path)
        pair.network.heal()
        ada, bob = await pair.begin("ada", "bob")
        ada.ensemble.stop()
        await asyncio.sleep(1.0)
        await runtime.stop(ada.member)
        await runtime.stop(bob.member)
        [ada] = await pair.begin("ada")
        assert (ada.ensemble.mode, ada.did) == ("stopped", [])
        ada.ensemble.start()
        await asyncio.sleep(3.0)
        assert (ada.ensemble.mode, ada.did) == ("deciding", ["listen"])

    run_virtual(main)


def test_who_has_met_the_other_goes_on_without_it():
    async def main(runtime):
        pair = Pair(runtime, period=0.5)
        pair.network.heal()
        ada, _ = await pair.begin("ada", "bob")
        pair.network.crash("bob")
        await asyncio.sleep(3.0)
        assert (ada.ensemble.mode, ada.role) == ("deciding", "leading")

    run_virtual(main)


@pytest.mark.parametrize("options", AGREEING)
@pytest.mark.parametrize("wrong", ["address", "order", "name", "port"])
def test_with_wrong_addresses_nobody_moves_and_who_asks_is_told(options, wrong):
    """What `test_wrong_addresses` tries with processes: a wrong address reaches nobody, a port is one agent's alone."""

    async def main(runtime):
        pair = Pair(runtime, ["bob", "ada"] if wrong == "order" else None, **options)
        if wrong == "name":
            pair.others = Team("tigres", ["ada", "bob"], **options)
            elsewhere = Network(runtime.clock, team="tigres")
            pair.network.transport, ours = (
                lambda name: (elsewhere.transport if name == "bob" else ours)(name),
                pair.network.transport,
            )
        if wrong != "address":
            pair.network.heal()
        robots = await pair.begin("ada", *(["bob"] if wrong != "port" else []))
        assert {act for robot in robots for act in robot.did} <= {"SAFE"}
        assert "deciding" not in {robot.ensemble.mode for robot in robots}
        if wrong == "address":
            pair.network.partition({"ada", "console"}, {"bob"})
        asker = pair.network.transport("console")
        await asker.open()
        found = {agent: {"joint": told} for agent, told in (await ask(asker, pair.team, "status")).items()}
        assert list(_troubles(found))

    run_virtual(main)


@pytest.mark.parametrize("mode", ["replicated", "centralised"])
def test_three_wait_for_two(mode):
    async def main(runtime):
        model = problems.fire_fighting(2, 3, 2)
        network = Network(runtime.clock, team="fire")
        team = Team("fire", ["one", "two", "three"], mode=mode, period=0.5)

        def build(robot, agent):
            return over_beliefs(model)(robot, agent, safe_action=robot.act("SAFE"))

        one = await Robot(team, "one", network, build).start(runtime)
        await asyncio.sleep(10.0)
        assert (one.did, one.role, one.ensemble.mode) == (["SAFE"], "waiting", "safe")
        two = await Robot(team, "two", network, build).start(runtime)
        await asyncio.sleep(5.0)
        assert [one.ensemble.mode, two.ensemble.mode] == ["deciding"] * 2

    run_virtual(main)


def test_who_communicates_decides_on_what_it_knows_and_says_so():
    async def main(runtime):
        [ada] = await Pair(runtime, mode="communicating", period=0.5).begin("ada")
        assert ada.ensemble.mode == "deciding"
        [told] = [fault for fault in ada.faults if fault.kind == "missing_teammate"]
        assert told.detail.endswith("; ada decides on what it knows")

    run_virtual(main)


@pytest.mark.parametrize("options", AGREEING)
def test_one_that_a_person_has_released_waits_for_its_team_s_word_when_it_meets_it(options):
    async def main(runtime):
        pair = Pair(runtime, **options)
        ada, _ = await pair.begin("ada", "bob")
        modes = []
        runtime.modes.subscribe(lambda mode: modes.append(mode.mode) if mode.ensemble == ada.ensemble.path else None)
        ada.ensemble.release()
        await asyncio.sleep(2.0)
        modes.clear()
        pair.network.heal()
        await asyncio.sleep(3.0)
        assert modes == ["stopped", "deciding"]

    run_virtual(main)
