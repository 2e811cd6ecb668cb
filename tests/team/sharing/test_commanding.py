"""Commands to a whole team: every agent is told, and says what it is by then."""

from __future__ import annotations

import asyncio

import pytest
from sentences import refused
from team.sharing.test_commanding_outcomes import MODES, NAMES, Squad

import mdm
from mdm.team.sharing.commanding import command
from mdm.team.team import Team
from mdm.testing import run_virtual


async def squad_and_asker(runtime, mode):
    squad = await Squad(runtime, mode).begin()
    asker = squad.network.transport("console")
    await asker.open()
    return squad, asker


@pytest.mark.parametrize("mode", MODES)
def test_every_agent_confirms_what_it_is(mode):
    async def main(runtime):
        squad, asker = await squad_and_asker(runtime, mode)
        for name, after in (("stop", "stopped"), ("start", "deciding"), ("reset", "deciding"), ("release", "deciding")):
            told = await getattr(squad.team, name)(transport=asker)
            assert [(one.agent, one.confirmed, one.mode, one.problem) for one in told] == [
                (agent, True, after, None) for agent in NAMES
            ]
            assert squad.modes == [after] * 3
            assert {one.ensemble for one in told} == {"joint"}
            assert all((one.term is None) == (mode == "centralised") and one.step is not None for one in told)

    run_virtual(main)


@pytest.mark.parametrize("mode", MODES)
def test_an_agent_that_is_cut_off_from_the_others_stops_as_well(mode):
    async def main(runtime):
        squad, asker = await squad_and_asker(runtime, mode)
        await squad.cut("r0")
        told = await squad.team.stop(transport=asker)
        assert [(one.agent, one.confirmed) for one in told] == [(agent, True) for agent in NAMES]
        assert squad.modes == ["stopped"] * 3
        await squad.heal()
        assert squad.modes == ["stopped"] * 3
        assert await squad.begun(5.0) == [0, 0, 0]
        assert all(one.confirmed for one in await squad.team.start(transport=asker))
        assert all(await squad.begun(5.0))

    run_virtual(main)


@pytest.mark.parametrize("mode", MODES)
def test_an_agent_that_cannot_be_reached_is_named_within_the_time(mode):
    async def main(runtime):
        squad, asker = await squad_and_asker(runtime, mode)
        squad.network.partition({"r0"}, {"r1", "r2", "console"})
        await asyncio.sleep(3.0)
        began = runtime.clock.now()
        told = {one.agent: one for one in await command(asker, squad.team, "stop", seconds=3.0)}
        assert (runtime.clock.now() - began) / 1e9 < 6.0
        assert (told["r0"].confirmed, told["r0"].problem) == (False, "it does not answer")
        assert [told[agent].confirmed for agent in ("r1", "r2")] == [True, True]

    run_virtual(main)


def test_who_cannot_start_says_why():
    async def main(runtime):
        squad, asker = await squad_and_asker(runtime, "replicated")
        await squad.team.stop(transport=asker)
        await squad.cut("r0")
        told = {one.agent: one for one in await squad.team.start(transport=asker, seconds=2.0)}
        assert [told[agent].confirmed for agent in NAMES] == [False, True, True]
        assert told["r0"].problem == "it is stopped; the start is pending, since it is waiting"
        with refused(mdm.Error):
            await command(asker, squad.team, "dance")

    run_virtual(main)


def test_one_reset_that_all_are_asked_for_is_one_step():
    async def main(runtime):
        squad, asker = await squad_and_asker(runtime, "replicated")
        await squad.team.reset(transport=asker)
        commands = [commit.command for commit in squad.robots["r1"].commits if commit.command]
        assert commands == ["begin", "reset"]

    run_virtual(main)


def test_a_team_knows_where_its_agents_listen():
    team = Team("tigers", [("left", "tcp/10.0.0.1:7000"), "right"])
    assert team.endpoints("tls") == {"left": "tcp/10.0.0.1:7000", "right": "tls/127.0.0.1:7448"}
