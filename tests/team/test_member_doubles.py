"""Two robots of one name: told by those who hear of both, and by the status of the team."""

from __future__ import annotations

import asyncio
from contextlib import asynccontextmanager
from types import SimpleNamespace

import msgspec
import pytest
from team_robots import over_beliefs, started

from mdm import Runtime, problems
from mdm.cli.team import status as cli
from mdm.errors import Error
from mdm.team import member
from mdm.team.sharing import calls
from mdm.team.sharing.calls import ask
from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.testing import probe, run_virtual

ELSEWHERE = "tcp/10.0.0.9:7447"
TOLD = f"two robots are called 'ada': at tcp/127.0.0.1:7447 and {ELSEWHERE}"


class Pair:
    """A running team of ada and bob, and somebody who asks them."""

    @classmethod
    async def begin(cls, runtime, **options):
        pair = cls()
        pair.network = Network(runtime.clock, team="tigers")
        pair.team = Team("tigers", ["ada", "bob"], **options)
        pair.robots = await started(runtime, pair.team, pair.network, over_beliefs(problems.dec_tiger()))
        pair.console = pair.network.transport("console")
        await pair.console.open()
        await asyncio.sleep(2.0)
        return pair

    async def double(self, body):
        return set((await self.console.ask("mdm/tigers/*/double", body)).values())

    def told(self):
        return [[fault.detail for fault in robot.faults if fault.kind == "duplicate"] for robot in self.robots]

    async def status(self):
        found = {name: {"joint": status} for name, status in (await ask(self.console, self.team, "status")).items()}
        return cli._doubles(found, self.team)


def who(name, life=99, where=ELSEWHERE):
    return msgspec.msgpack.encode((name, life, where))


@pytest.mark.parametrize("mode", ["replicated", "centralised", "communicating"])
def test_another_process_of_a_live_agent_s_name_is_told_for_as_long_as_it_asks(mode):
    async def main(runtime):
        pair = await Pair.begin(runtime, mode=mode, period=0.5)
        assert await pair.status() == []
        for _ in range(3):
            assert await pair.double(who("ada")) == {b"tcp/127.0.0.1:7447"}
            await asyncio.sleep(10.0)
            assert await pair.status() == [TOLD.replace("'", "")]
        assert pair.told() == [[], [TOLD]]  # of its own name an agent's transport tells
        await asyncio.sleep(30.0)
        assert await pair.status() == []
        await pair.double(who("ada"))
        assert pair.told() == [[], [TOLD] * 2]

    run_virtual(main)


@pytest.mark.parametrize("case", ["itself", "nobody here", "lost", "nonsense"])
def test_who_has_no_double_is_told_so(case):
    async def main(runtime):
        pair = await Pair.begin(runtime)
        ada = pair.robots[0].transport
        if case == "lost":  # one that was started again, and has not met the other yet
            pair.network.crash("ada")
            await asyncio.sleep(3.0)
        asked = {"itself": who("ada", ada.incarnation), "nobody here": who("eve"), "nonsense": b"\xc1"}
        answers = await pair.double(asked.get(case, who("ada")))
        assert answers == {b""}
        assert [fault for told in pair.told() for fault in told] == []

    run_virtual(main)


@pytest.mark.parametrize("met", [False, True])
def test_who_has_met_nobody_asks_at_all_endpoints_again_and_again(monkeypatch, met):
    """Where its own endpoint is another one, nobody connects to it."""

    async def main(runtime):
        pair = await Pair.begin(runtime, period=0.5)
        asks = []

        def session(team, agent, *_):
            transport = Network(runtime.clock, team="tigers").transport(agent)
            transport.identity = who(agent, 99)
            return transport

        @asynccontextmanager
        async def instead(team, access, agent):
            asks.append((runtime.now() / 1e9, team, access, agent))
            if len(asks) == 1:
                raise Error("no route to host")
            yield pair.console, ()

        monkeypatch.setattr(member, "_session", session)
        monkeypatch.setattr(calls, "asking", instead)
        build, nothing = over_beliefs(problems.dec_tiger()), SimpleNamespace(act=lambda _: lambda: None)
        async with Runtime(log=None) as elsewhere:
            faults, began = probe(elsewhere.faults), elsewhere.now() / 1e9
            alone = pair.team.member("ada", build(nothing, 0))
            await elsewhere.start(alone)
            alone.link.met = met
            await asyncio.sleep(60.0)
        told = [fault.detail for fault in faults if fault.kind == "duplicate"]
        if met:
            assert (asks, told, pair.told()) == ([], [], [[], []])
            return
        assert [time - began for time, *_ in asks] == pytest.approx(
            [4.0 + 10.0 * number for number in range(6)], abs=0.1
        )
        assert {tuple(rest) for _, *rest in asks} == {(pair.team, None, "ada")}
        assert told == ["two robots are called 'ada': at tcp/127.0.0.1:7447 and tcp/127.0.0.1:7447"]
        assert pair.told() == [[], [TOLD]]

    run_virtual(main)
