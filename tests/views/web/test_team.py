"""Several agents on one page, each of which has a page of its own."""

from __future__ import annotations

import asyncio
import json
import re
import time
from contextlib import AsyncExitStack, asynccontextmanager

import msgspec
import pytest
from decided import VECTORS, nothing
from patience import PATIENCE
from sentences import refused
from served import TOKEN
from shown import a_robot

import mdm
from mdm import Ensemble, Error, Runtime
from mdm.problems import tiger
from mdm.snapshots import Event, Frame
from mdm.snapshots.frame import Judgement
from mdm.views.web import Page, PageServer
from mdm.views.web.client import opened
from mdm.views.web.team import TeamRun

pytest.importorskip("websockets")


def agent(name):
    return Ensemble(name, policy=VECTORS, model=tiger(), actions=dict.fromkeys(range(3), nothing))


def page():
    return Page(0, token=TOKEN, announce=lambda _: None)


async def until(holds):
    """Wait until something holds, which takes real time."""
    async with asyncio.timeout(PATIENCE):
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
                await until(lambda: team.frame({"ada", "bob"}).statistics.ended.get("bob") == {"succeeded": 2})
                statistics = team.frame({"ada", "bob"}).statistics
                assert statistics.ended["ada"] == {"succeeded": 1}
                assert statistics.latencies["bob"].count == 2
                assert {"inputs handled (ada)", "inputs handled (bob)"} <= statistics.counts.keys()
                await until(lambda: any(event.kind == "fault" for event in team.ring))
                events = [msgspec.json.decode(each, type=Event) for each in team.ring.after(0, 1000)[0]]
                assert [event.detail for event in events if event.kind == "fault"] == ["nothing was told"]
                assert {event.source for event in events if event.kind == "mode"} == {"ada", "bob"}
                why = await team.explain("bob")
                assert why.epoch == 1
                assert "there is no ensemble 'carl'" in (await team.explain("carl")).text
                assert [each.title for each in await team.draw("bob")] == ["actions over beliefs in 2 states"]
                assert "there is no ensemble 'carl'" in (await team.draw("carl"))[0].remarks[0]
            await until(lambda: "agent bob" in team.frame().team)
            gone = team.frame()
            assert gone.missing == ("bob",)
            assert gone.headline.startswith("bob: does not answer, since 00:0")
            last = {(event.kind, event.source): event for event in team.ring}
            assert (last["mode", "bob"].name, last["mode", "bob"].detail) == ("stopped", "agent 'bob' does not answer")
            assert last["mode", "ada"].name == "deciding"
            assert [each.mode for each in gone.ensembles] == ["deciding", "stopped"]
            assert gone.team["agent bob"]["link"] == "lost"
            await team.stop()

    asyncio.run(program())


def test_the_worst_of_all_agents_is_the_headline_with_its_time_by_the_page_s_own_clock():
    async def fail():
        raise RuntimeError("the gripper is jammed")

    ada, bob = agent("ada"), Ensemble("bob", policy=VECTORS, model=tiger(), actions=dict.fromkeys(range(3), fail))

    async def program(team):
        assert team.frame().headline == ""
        for number in range(4):
            bob.publish_observation(("hear-left", "hear-right")[number % 2])
            await until(lambda number=number: bob.action.num_ended >= number + 1)
        await until(lambda: team.frame().headline)
        frame = team.frame()
        assert re.fullmatch(r"bob: listen has failed \d times, never succeeded, since 00:0\d\.\d", frame.headline)
        assert (frame.judgements[0].of, frame.judgements[0].subject) == ("bob", "listen")
        assert 0 <= frame.judgements[0].since <= frame.time

    commanded(program, ada, bob)


def test_an_agent_that_is_lost_for_a_moment_tells_nothing_twice():
    ada = agent("ada")

    async def program(team):
        ada.report("stale", "nothing was told")
        await until(lambda: any(event.kind == "fault" for event in team.ring))
        team._agents[0]._socket.abort()
        await until(lambda: [event.name for event in team.ring if event.kind == "mode"][-2:] == ["stopped", "deciding"])
        assert len([event for event in team.ring if event.kind == "fault"]) == 1
        team._agents[0]._heard = (2**63, 100)  # of a process before, by a clock that was set back since
        team._agents[0]._socket.abort()
        await until(lambda: len([event for event in team.ring if event.kind == "fault"]) == 2)

    commanded(program, ada)


def test_an_agent_that_has_not_come_yet_is_named():
    ada = agent("ada")

    async def program():
        ada_page = page()
        async with Runtime(log=False, page=ada_page, watchdog=None, signals=False) as runtime:
            await runtime.start(ada)
            team = TeamRun({"bob": "http://127.0.0.1:1/?token=" + TOKEN, "ada": ada_page.address})
            assert team.frame().missing == ("bob", "ada")
            team.open()
            await until(lambda: team.frame().missing == ("bob",))
            frame = team.frame()
            assert [each.mode for each in frame.ensembles] == ["deciding"]
            assert frame.team["agent bob"]["process"] == "has not answered yet"
            await team.stop()

    asyncio.run(program())


def test_what_agents_judge_stands_on_the_page_of_the_team_and_once():
    team = TeamRun(dict.fromkeys(["ada", "bob", "cyd"], "http://127.0.0.1:1/?token=" + TOKEN))
    assert (team.frame().judgements, team.frame().headline) == ((), "")
    lost = Judgement("apart", "bob", "", "wrong", 1, 4.0, "is lost: the team is apart")
    over = Judgement("late", "ada", "", "look", 5, 1.0, "missed 5 ticks", until=3.0)
    idle = Judgement("idle", "cyd", "", "look", 1, 2.0, "has nothing to do")
    for each, own in zip(team._agents, [(over,), (idle, over), (lost, idle)], strict=True):
        each.scene = msgspec.structs.replace(team.scene(), began=team.began + 2 * 10**9)
        each.frame = Frame(6.0, (), (), (), judgements=own, headline=str(own[0]) if own[0] is not over else "")
    frame = team.frame()
    assert [each.rule for each in frame.judgements] == ["apart", "idle", "late"]
    assert frame.headline == "bob: is lost: the team is apart, since 00:06.0"
    team._agents[2].frame = team._agents[1].frame = None  # who does not answer judges nothing any more
    assert ([each.until for each in team.frame().judgements], team.frame().headline) == ([5.0], "")


def commanded(program, *robots, control=True):
    """Run a coroutine function with the pages of some robots on one, that takes commands, and the robots."""

    async def run():
        async with AsyncExitStack() as stack:
            pages = {}
            for robot in robots:
                own = Page(0, token=TOKEN, announce=lambda _: None, control=control)
                runtime = Runtime(log=False, page=own, watchdog=None, signals=False)
                await (await stack.enter_async_context(runtime)).start(robot)
                pages[robot.name] = own.address
            team = TeamRun(pages, control=True)
            team.open()
            stack.push_async_callback(team.stop)
            await until(lambda: len(team.scene().ensembles) >= len(robots))
            await program(team)

    asyncio.run(run())


def test_a_command_reaches_the_agent_concerned_and_no_other():
    ada, bob = agent("ada"), agent("bob")

    async def program(team):
        await team.command("stop", "bob")
        assert (ada.mode, bob.mode) == ("deciding", "stopped")
        await team.command("start", "bob")
        await team.command("stop", "ada")
        assert (ada.mode, bob.mode) == ("stopped", "deciding")
        for command, ensemble in (("explode", "bob"), ("stop", "carl")):
            with refused(Error):
                await team.command(command, ensemble)
        assert (ada.mode, bob.mode) == ("stopped", "deciding")

    commanded(program, ada, bob)


def test_what_an_agent_s_page_refuses_is_told():
    ada = agent("ada")

    async def program(team):
        with refused(Error):
            await team.command("stop", "ada")
        assert ada.mode == "deciding"

    commanded(program, ada, control=False)


def test_predicates_are_set_at_their_agent_as_far_as_its_page_lets_them(tmp_path):
    one, two = mdm.load_system(a_robot(tmp_path)), mdm.load_system(a_robot(tmp_path))
    for system, name in ((one, "one"), (two, "two")):
        system.name = name

    async def program(team):
        settable = [each.name for each in team.scene().predicates if each.settable]
        assert settable == ["one: Low", "two: Low"]
        await team.sense("two: Low", value=True)
        assert (one.predicates.value("Low"), two.predicates.value("Low")) == (False, True)
        await team.sense("two: Low", value=None)
        assert two.predicates.value("Low") is None
        for name in ("two: Near", "Low", "three: Low"):  # a sensor tells the first
            with refused(Error):
                await team.sense(name, value=True)

    commanded(program, one, two)


def test_more_commands_than_an_agent_takes_are_refused_before_it_hangs_up():
    ada = agent("ada")

    async def program(team):
        answers = await asyncio.gather(*(team.command("reset", "ada") for _ in range(30)), return_exceptions=True)
        refusals = [str(each) for each in answers if each is not None]
        assert set(refusals) == {"too many commands for agent 'ada': wait a second"}
        assert 8 <= answers.count(None) < 30
        assert team.frame().ensembles[0].mode == "deciding"  # whom the page goes on to see

    commanded(program, ada)


@asynccontextmanager
async def hanging(scene, frame=None):
    """Serve the page of an agent that hangs once it has shown itself; yield its address, and what it was asked."""
    from websockets.asyncio.server import serve

    asked = []

    def note(message):
        if message["say"] != "drawn":
            asked.append(message)

    async def show(connection):
        await connection.send(msgspec.json.encode({"scene": scene}), text=True)
        if frame is not None:
            await connection.send(msgspec.json.encode({"frame": frame}), text=True)
        async for message in connection:
            note(json.loads(message))

    async with serve(show, "127.0.0.1", 0, close_timeout=0.1) as server:
        port = next(iter(server.sockets)).getsockname()[1]
        yield f"http://127.0.0.1:{port}/?token={TOKEN}", asked


def test_an_agent_that_hangs_refuses_in_time_and_keeps_nobody_else_waiting(monkeypatch):
    monkeypatch.setattr("mdm.views.web.team._WAITS", 2.0)
    monkeypatch.setattr("mdm.views.web.team._VALID", 1.0)
    ada = agent("ada")

    async def program(team):
        bob = [msgspec.structs.replace(each, path="bob") for each in team.scene().ensembles]
        async with hanging(msgspec.structs.replace(team.scene(), ensembles=tuple(bob))) as (address, asked):
            both = TeamRun({"ada": team._agents[0]._address, "bob": address}, control=True)
            server = PageServer(both, port=0, live=True, control=True, token=TOKEN)
            await server.open()
            both.open()
            await until(lambda: len(both.scene().ensembles) == 2)
            async with opened(server.address) as browser:
                await browser.receive()
                await browser.say({"say": "command", "command": "stop", "ensemble": "bob"})
                await browser.say({"say": "command", "command": "stop", "ensemble": "ada"})
                await browser.say({"say": "drawn"})
                answers = [json.loads(await browser.receive()) for _ in range(2)]
                assert {"done": "stop ada"} in answers
                assert any("frame" in each for each in answers)
                assert ada.mode == "stopped"
                late = json.loads(await browser.receive())
                assert late["refused"].startswith("agent 'bob' does not answer")
                (message,) = asked
                assert 0 <= time.time_ns() - message.pop("before") < 60e9  # its time is over
                assert message == {"say": "command", "command": "stop", "ensemble": "bob"}
            await both.stop()
            await server.close()

    commanded(program, ada)


def test_an_agent_whose_process_is_held_is_lost(monkeypatch):
    monkeypatch.setattr("mdm.views.web.team._SILENT", 0.5)

    async def program(team):
        await until(lambda: team.frame().missing == ())
        async with hanging(team.scene(), team.frame()) as (address, _):
            held = TeamRun({"ada": address})
            held.open()
            await until(lambda: held.frame().missing == () and held.scene().ensembles)
            await until(lambda: held.frame().missing == ("ada",))
            (told,) = [event.detail for event in held.ring if event.kind == "mode"]
            assert told == "agent 'ada' does not answer"
            await held.stop()

    commanded(program, agent("ada"))


def test_an_agent_that_is_gone_refuses_at_once():
    ada = agent("ada")

    async def program(team):
        await team.stop()
        gone = TeamRun({"ada": "http://127.0.0.1:1/?token=" + TOKEN}, control=True)
        gone._agents[0].scene = team.scene()
        with refused(Error):
            await gone.command("stop", "ada")

    commanded(program, ada)
