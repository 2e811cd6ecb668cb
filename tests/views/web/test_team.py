"""Several agents on one page, each of which has a page of its own."""

from __future__ import annotations

import asyncio

import msgspec
import pytest
from decided import VECTORS, nothing
from served import TOKEN

from mdm import Ensemble, Runtime
from mdm.problems import tiger
from mdm.snapshots import Event
from mdm.views.web import Page
from mdm.views.web.team import TeamRun

pytest.importorskip("websockets")


def agent(name):
    return Ensemble(name, policy=VECTORS, model=tiger(), actions=dict.fromkeys(range(3), nothing))


def page():
    return Page(0, token=TOKEN, announce=lambda _: None)


async def until(holds):
    """Wait until something holds, which takes real time."""
    async with asyncio.timeout(20):
        while not holds():
            await asyncio.sleep(0.02)


def test_all_agents_are_laid_beside_each_other_and_one_that_ends_says_so():
    ada, bob = agent("ada"), agent("bob")

    async def program():
        ada_page, bob_page = page(), page()
        async with Runtime(log=False, page=ada_page, watchdog=None, signals=False) as runtime:
            await runtime.start(ada)
            async with Runtime(log=False, page=bob_page, watchdog=None, signals=False) as other:
                await other.start(bob)
                team = TeamRun({"ada": ada_page.address, "bob": bob_page.address})
                team.open()
                await until(lambda: [each.path for each in team.scene().ensembles] == ["ada", "bob"])
                bob.publish_observation("hear-left")
                bob.report("stale", "nothing was told")
                await until(lambda: len(team.frame({"ada", "bob"}).details) == 2)
                await until(lambda: team.frame({"ada", "bob"}).details["bob"].observation == "hear-left")
                frame = team.frame({"ada", "bob"})
                assert [each.mode for each in frame.ensembles] == ["deciding", "deciding"]
                assert all(abs(each.since - frame.time) < 30 for each in frame.ensembles)
                assert frame.details["ada"].observation is None
                await until(lambda: any(event.kind == "fault" for event in team.ring))
                events = [msgspec.json.decode(each, type=Event) for each in team.ring.after(0, 1000)[0]]
                assert [event.detail for event in events if event.kind == "fault"] == ["nothing was told"]
                assert {event.source for event in events if event.kind == "mode"} == {"ada", "bob"}
                why = await team.explain("bob")
                assert why.epoch == 1
                assert "there is no ensemble 'carl'" in (await team.explain("carl")).text
            await until(lambda: "agent bob" in team.frame().team)
            gone = team.frame()
            assert [each.mode for each in gone.ensembles] == ["deciding", "stopped"]
            assert gone.team["agent bob"]["link"] == "lost"
            await team.stop()

    asyncio.run(program())
