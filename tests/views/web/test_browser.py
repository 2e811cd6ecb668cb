"""The page in a real browser: what it shows, and what one can do with it."""

from __future__ import annotations

import asyncio
import re
from itertools import pairwise

import browsers
import msgspec
import pytest
import shielded
from decided import ensemble, nothing
from patience import PATIENCE
from served import TOKEN, shown
from shown import a_robot
from team_file import write
from team_processes import on_free_ports, up
from told import Told, served
from transports import free_port

import mdm
from mdm import Ensemble
from mdm.models import POMDP, Factor, Space
from mdm.policies import AlphaVectors, DeterministicPolicy, FiniteStateController
from mdm.recording import Record
from mdm.snapshots import Detail, EnsembleFrame, Frame, RecordedRun
from mdm.snapshots.frame import FactorScene, LifeFrame, PredicateScene, Spread, StatisticsFrame
from mdm.team.transport.certificates import make_certificates
from mdm.testing import run_virtual

browsers.needed()
pytestmark = pytest.mark.slow  # each takes a second or two of a processor in Chromium

UNTIL = "() => document.querySelector('main .row')"


async def text(page, selector):
    return " ".join((await page.inner_text(selector)).split())


def seen(look_at, *actors, of=None, **options):
    """Run a test of a browser that looks at a live page; nothing may go wrong in it, or keep people out."""

    async def main(runtime, page):
        async with browsers.browser(**(of or {})) as (look, wrong):
            opened = await look(page.address)
            await opened.wait_for_function(UNTIL)
            found = await look_at(opened, runtime, page)
            assert await browsers.barriers(opened) == []
            assert wrong == []
            return found

    return shown(main, *actors, run=browsers.run, **options)


def test_it_shows_modes_actions_beliefs_and_faults():
    robot = ensemble()

    async def look_at(page, runtime, _):
        assert "robot" in await text(page, "[role=option]")
        assert "decides" in await text(page, ".headline")
        assert page.url.endswith("/")  # the token has left the address
        robot.publish_observation("hear-left")
        await page.wait_for_function("() => document.body.innerText.includes('hear-left')")
        belief = dict(zip(robot.controller.model.state_space.names, robot.controller.decided_by, strict=True))
        bars = await text(page, "[aria-label='Ensemble robot']")
        for state, chance in belief.items():
            assert f"{state} {100 * chance:.1f} %" in bars
        robot.report("stale", "nobody told anything")
        await page.wait_for_selector(".fault")
        assert "nobody told anything" in await text(page, ".fault")
        assert "allow a longer" in await text(page, ".fault .remedy")

    seen(look_at, robot)


def test_it_shows_what_a_shield_has_replaced():
    safe = mdm.shield(shielded.WRONG, shielded.house(), avoid="position = stairs", keep="reach position = goal")
    doing = dict.fromkeys(shielded.ACTIONS, lambda: None)
    robot = Ensemble("robot", policy=safe, model=shielded.house(), actions=doing)

    async def look_at(page, runtime, _):
        robot.publish_state(shielded.STATES.index("landing"))
        await page.wait_for_function("() => document.body.innerText.includes('in place of Straight')")
        assert "shield" in await text(page, "[role=option]")
        assert "Around shield, in place of Straight" in await text(page, "[aria-label='Ensemble robot']")
        robot.publish_state(shielded.STATES.index("hall"))
        await page.wait_for_function("() => !document.body.innerText.includes('in place of')")

    seen(look_at, robot)


def test_a_safe_mode_comes_first_with_its_cause_and_what_to_do():
    robot = ensemble(safe_action=lambda: None)

    async def look_at(page, runtime, _):
        robot.safety.alarm(mdm.messages.Fault(runtime.now(), "robot", "policy", "it is torn"))
        await page.wait_for_selector(".headline.alarm")
        told = await text(page, ".headline")
        assert "robot: is safe (policy)" in told
        assert "it is torn" in told
        assert "Correct the policy" in told

    seen(look_at, robot)


def test_a_page_that_sleeps_is_sent_nothing_and_then_the_newest():
    async def look_at(page, runtime, served):
        # The drawing of a frame that has come is kept, and not what else is to be drawn: then no frame is on its way.
        of_frames = "(draw) => { if (String(draw).includes('redraw')) globalThis.slept = draw; }"
        await page.evaluate(f"globalThis.requestAnimationFrame = {of_frames}")
        await page.wait_for_function("() => globalThis.slept", polling=50)  # which is not by drawing
        before = served._live.now
        frames = await page.evaluate("mdmPage.frame.time")
        await asyncio.sleep(1.0)
        assert await page.evaluate("mdmPage.frame.time") - frames < 0.2
        await page.evaluate("globalThis.requestAnimationFrame = (draw) => setTimeout(draw, 10); slept();")
        await page.wait_for_function(f"() => mdmPage.frame.time > {before} + 0.9")

    seen(look_at)


def test_with_tls_a_browser_that_trusts_the_certificate_sees_the_page_and_another_does_not(tmp_path):
    pytest.importorskip("cryptography")
    robot = ensemble()
    access = make_certificates(tmp_path, {"robot": ["127.0.0.1"]})["robot"]

    async def look_at(page, *_):
        assert page.url.startswith("https://")
        assert await page.evaluate("isSecureContext")
        robot.publish_observation("hear-left")
        await page.wait_for_function("() => document.body.innerText.includes('hear-left')")
        (cookie,) = await page.context.cookies()
        assert (cookie["secure"], cookie["httpOnly"], cookie["sameSite"]) == (True, True, "Strict")

    hosts = {"host": "127.0.0.1", "access": access}
    seen(look_at, robot, of={"ignore_https_errors": True}, **hosts)  # as one who trusts its authority

    async def refuse(_, page):
        async with browsers.browser() as (look, _):
            with pytest.raises(Exception, match="ERR_CERT_AUTHORITY_INVALID"):
                await look(page.address)

    shown(refuse, run=browsers.run, **hosts)


def test_commands_are_asked_twice_and_carried_out():
    robot = ensemble()

    async def look_at(page, *_):
        button = page.get_by_role("button", name="stop", exact=True)
        await button.click()
        assert robot.mode == "deciding"
        await page.get_by_role("button", name="No", exact=True).click()
        await page.wait_for_function("() => !document.querySelector('.ask')")
        await button.click()
        await page.get_by_role("button", name="Yes, stop").click()
        await page.wait_for_function("() => document.body.innerText.includes('done: stop robot')")
        assert robot.mode == "stopped"

    seen(look_at, robot, control=True)


def test_commands_of_a_team_are_said_to_concern_all_of_it_and_reach_all_of_it(tmp_path):
    """A process for each agent, each with a page, and that of the team, which the browser looks at."""
    pytest.importorskip("zenoh")
    path = write(tmp_path)
    path.write_text(on_free_ports(path.read_text().replace("port = 7600\n", "")))

    modes = "mdmPage.frame?.ensembles.map((each) => each.mode).join()"

    async def program(running):
        for agent in "ab":
            running.hear(agent=agent, event="running", actor=agent)
        lines = [record.get("text", "") for record in running.records]
        address = next(line.removeprefix("page: ").strip() for line in lines if line.startswith("page: "))
        async with browsers.browser() as (look, wrong):
            page = await look(address)
            await page.wait_for_function(f"() => {modes} === 'deciding,deciding'")
            await page.wait_for_function("() => 'ensemble joint (b)' in mdmPage.frame.team")
            assert await browsers.barriers(page) == []
            await page.get_by_role("option").filter(has_text="b/joint").click()
            await page.get_by_role("button", name="stop", exact=True).click()
            assert await text(page, ".ask b") == (
                "stop b/joint? It ends its action and decides nothing more. So do all agents of its team."
            )
            await page.get_by_role("button", name="Yes, stop").click()
            await page.wait_for_function("() => document.body.innerText.includes('done: stop b/joint')")
            await page.wait_for_function(f"() => {modes} === 'stopped,stopped'")
            assert wrong == []

    with up(path, "--page", free_port(), "--page-control") as running:
        browsers.run(program(running))


def test_without_being_asked_for_there_are_no_commands():
    robot = ensemble()

    async def look_at(page, *_):
        assert await page.get_by_role("button", name="stop", exact=True).count() == 0

    seen(look_at, robot)


def test_it_finds_back_after_a_restart():
    async def program():
        first = mdm.views.web.Page(0, token=TOKEN, announce=lambda _: None)
        async with browsers.browser() as (look, _):
            async with mdm.Runtime(log=False, page=first, signals=False) as runtime:
                await runtime.start(ensemble())
                port = int(first.address.split(":")[2].split("/")[0])
                page = await look(first.address)
                await page.wait_for_function(UNTIL)
            await page.wait_for_function("() => document.querySelector('header').innerText.includes('not connected')")
            again = mdm.views.web.Page(port, token=TOKEN, announce=lambda _: None)
            async with mdm.Runtime(log=False, page=again, signals=False) as runtime:
                await runtime.start(
                    ensemble(),
                )
                await page.wait_for_function("() => document.querySelector('header').innerText.includes('● live')")

    browsers.run(program())


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_has_room_for_all_of_it(scheme, tmp_path):
    async def look_at(page, *_):
        assert await page.evaluate("document.documentElement.scrollWidth") <= 360
        assert await page.evaluate("getComputedStyle(document.documentElement).colorScheme") == scheme

    options = {"viewport": {"width": 360, "height": 740}, "color_scheme": scheme}
    seen(look_at, mdm.load_system(a_robot(tmp_path)), of=options)


OVERLAPPING = """() => {
    const boxes = [...document.querySelectorAll('.panels .panel')].map((each) => each.getBoundingClientRect());
    return boxes.some((one, place) => boxes.slice(place + 1).some((other) => one.left < other.right
        && other.left < one.right && one.top < other.bottom && other.top < one.bottom));
}"""
FILLED = """() => {
    const bottoms = {}, boxes = [...document.querySelectorAll('.panels .panel:not(.wide)')];
    for (const each of boxes.map((box) => box.getBoundingClientRect())) {
        bottoms[each.left] = Math.max(bottoms[each.left] ?? 0, each.bottom);
    }
    return [Object.keys(bottoms).length, Math.min(...Object.values(bottoms)) / Math.max(...Object.values(bottoms))];
}"""


def test_panels_fill_each_width_without_lying_over_each_other_and_stay_closed(tmp_path):
    async def look_at(page, *_):
        for width, columns in ((390, 1), (1300, 3), (1920, 4)):
            await page.set_viewport_size({"width": width, "height": 900})
            await page.wait_for_function(f"() => ({FILLED})()[0] === {columns} && !({OVERLAPPING})()")
            assert (await page.evaluate(FILLED))[1] > 0.5
            assert await page.evaluate("document.documentElement.scrollWidth") <= width
            assert await page.evaluate("document.documentElement.scrollHeight") <= 900  # what scrolls is the content
        await page.get_by_role("button", name="Close Ensembles").click()
        await page.wait_for_function("() => !document.querySelector('[role=option]')")
        await page.reload()
        await page.wait_for_selector("[aria-label=Predicates]")
        assert await page.locator("[role=option]").count() == 0
        await page.get_by_role("button", name="Open Ensembles").click()
        await page.wait_for_selector("[role=option]")

    seen(look_at, mdm.load_system(a_robot(tmp_path)))


def test_a_robot_that_fails_says_so_first_and_keeps_nobody_out_in_either_scheme_at_any_width():
    async def grip():
        raise RuntimeError("the gripper does not close")

    robot = Ensemble(
        "robot", policy=DeterministicPolicy([0, 1]), actions={0: grip, 1: mdm.bind(nothing, then="decide")}
    )

    async def look_at(page, *_):
        for state in (0, 1) * 4:
            robot.publish_state(state)
            await asyncio.sleep(0.05)
        await page.wait_for_selector(".headline.alarm")
        told = await text(page, ".headline .line >> nth=0")
        assert told.startswith("✕ robot: 0 has failed")
        assert "never succeeded" in told
        assert "the gripper does not close" in told
        for scheme in ("light", "dark"):
            await page.emulate_media(color_scheme=scheme)
            for width in (390, 1300, 1920):
                await page.set_viewport_size({"width": width, "height": 900})
                assert await page.evaluate("document.documentElement.scrollWidth") <= width
            assert await browsers.barriers(page) == []

    seen(look_at, robot)


def test_a_thousand_ensembles_are_drawn_as_far_as_they_are_in_sight():
    actors = [
        Ensemble(f"robot{number:03}", policy=DeterministicPolicy([0, 0]), actions={0: lambda: None})
        for number in range(1000)
    ]

    async def look_at(page, *_):
        await page.wait_for_function("() => mdmPage.scene.ensembles.length === 1000")
        assert await page.locator("[role=option]").count() < 40
        await page.wait_for_function("() => document.querySelector('.headline').innerText.includes('the same of')")
        assert await page.locator(".headline .line").count() <= 2
        await page.get_by_label("Find an ensemble").fill("robot77")
        await page.wait_for_function("() => document.querySelectorAll('[role=option]').length === 10")
        await page.locator("[role=option]").last.click()
        await page.wait_for_function("() => mdmPage.selected === 'robot779'")
        await page.wait_for_function("() => document.querySelector('[aria-label=\"Ensemble robot779\"]')")

    seen(look_at, *actors)


def test_a_belief_of_a_hundred_thousand_states_shows_the_likeliest():
    import numpy as np
    from scipy.sparse import identity

    size = 100_000
    chances = np.full(size, 0.25 / (size - 1))
    chances[4321] = 0.75
    stays = identity(size, format="csr")
    model = POMDP(
        transitions=[stays],
        observations=[np.ones((size, 1))],
        rewards=np.zeros((size, 1)),
        discount=0.9,
        initial_belief=chances,
    )
    robot = Ensemble("robot", policy=AlphaVectors([np.zeros(size)], [0]), model=model, actions={0: lambda: None})

    async def look_at(page, *_):
        await page.wait_for_function("() => document.body.innerText.includes('100,000 states')")
        told = await text(page, "[aria-label='Ensemble robot']")
        assert "75.0 %" in told
        assert "4321" in told
        assert "fairly sure: 75.0 % for 4321" in told
        bins = await page.eval_on_selector_all(
            "[aria-label='Ensemble robot'] .bins span",
            "(all) => all.map((each) => [each.title, each.offsetLeft, each.offsetHeight])",
        )
        # a quarter of it on the many, and the rest on one: on a logarithmic axis far apart
        (many, left, low), (one, right, high) = bins
        assert "99,999 states" in many
        assert "75.0 % together" in one
        assert low / high == pytest.approx(1 / 3, abs=0.05)
        assert right - left > 10 * 14

    seen(look_at, robot)


def test_a_record_is_stepped_through_by_keyboard_alone(tmp_path):
    async def run(runtime):
        await runtime.start(mdm.load_system(a_robot(tmp_path)))
        await asyncio.sleep(40)

    run_virtual(run, record=tmp_path / "run.mcap")
    record = Record(tmp_path / "run.mcap")
    first = record.span[0]
    system = mdm.load_system(a_robot(tmp_path))
    run_ = RecordedRun(record, system, ensembles=system.ensembles, predicates=system.predicates)

    async def program():
        async with served(run_) as address, browsers.browser() as (look, wrong):
            page = await look(address)
            await page.wait_for_function(UNTIL)
            for key, topic in (("d", "decisions"), ("n", "decisions"), ("f", "faults"), ("m", "modes")):
                found, before = set(), {}
                for each in record.messages([topic]):
                    if key != "n" or before.get(each.message.ensemble) != each.message.action:
                        found.add(round((each.time - first) / 1e9, 6))
                    if key == "n":
                        before[each.message.ensemble] = each.message.action
                times = sorted(found)
                at = await page.evaluate("mdmPage.frame.time")
                after = next(time for time in times if time > at)
                await page.keyboard.press(key)
                await page.wait_for_function(f"() => Math.abs(mdmPage.frame.time - {after}) < 1e-5")
                before = next((time for time in reversed(times) if time < after), None)
                if before is not None:
                    await page.keyboard.press(f"Shift+{key}")
                    await page.wait_for_function(f"() => Math.abs(mdmPage.frame.time - {before}) < 1e-5")
            told = "mdmPage.why && mdmPage.why.decided === mdmPage.frame.details.top.decided"
            await page.keyboard.press("w")
            await page.wait_for_function(f"() => {told}")
            before = await page.evaluate("mdmPage.why.decided")
            for _ in range(30):  # until the next decision is one of this ensemble: it is told anew
                await page.keyboard.press("d")
                await page.wait_for_function(f"() => {told}")
                if await page.evaluate("mdmPage.why.decided") != before:
                    break
            else:
                raise AssertionError("it goes on to tell of the decision before")
            await page.get_by_label("Time", exact=True).focus()
            await page.keyboard.press("End")
            await page.wait_for_function(f"() => Math.abs(mdmPage.frame.time - {run_.last}) < 0.01")
            await page.keyboard.press("Home")
            await page.wait_for_function("() => mdmPage.frame.time < 0.01")
            await page.locator("h1").click()
            await page.keyboard.press("Space")
            await page.wait_for_function("() => mdmPage.frame.time > 0.5")
            await page.keyboard.press("Space")
            await page.wait_for_function("() => !mdmPage.playing")
            events = await page.evaluate("mdmPage.cursor")
            assert events == len(run_.after(0, 10**9, rare=True)[0])
            assert await browsers.barriers(page) == []
            assert wrong == []

    browsers.run(program())


def test_the_arrows_choose_an_ensemble_wherever_the_focus_is(tmp_path):
    async def look_at(page, *_):
        await page.locator("h1").click()
        for key, path in (("ArrowDown", "top/walk"), ("ArrowDown", "top/walk"), ("ArrowUp", "top")):
            await page.keyboard.press(key)
            await page.wait_for_function(f"() => mdmPage.selected === '{path}'")
        await page.get_by_label("Tree of ensembles").focus()
        await page.keyboard.press("ArrowDown")
        await page.wait_for_function("() => mdmPage.selected === 'top/walk'")

    seen(look_at, mdm.load_system(a_robot(tmp_path)))


def test_a_judgement_is_told_at_the_top_and_goes_when_it_is_over():
    async def nothing():
        pass

    robot = Ensemble(
        "robot",
        policy=DeterministicPolicy([0, 1]),
        actions={0: mdm.Binding(nothing, then="decide", pause=0.05), 1: lambda: None},
    )

    async def look_at(page, *_):
        robot.publish_state(1)  # a page that took long to open has seen it wait for its state
        await page.wait_for_function("() => !document.querySelector('.headline .judged')")
        robot.publish_state(0)
        await page.wait_for_selector(".headline .judged")
        assert "? robot: decided 0" in await text(page, ".headline")
        assert "? repeats" in await text(page, "[role=option]")
        robot.publish_state(1)
        await page.wait_for_function("() => !document.querySelector('.headline .judged')")

    seen(look_at, robot)


def test_predicates_that_the_chosen_ensemble_decides_on_come_first_and_have_lanes(tmp_path):
    async def look_at(page, *_):
        for key, mine in (("ArrowUp", "Low"), ("ArrowDown", "Near")):
            await page.keyboard.press(key)
            await page.wait_for_function(
                f"() => document.querySelector('[aria-label=Predicates] .name').innerText === '{mine}'"
            )
            rows = await page.locator("[aria-label=Predicates] [role=listitem]").all_inner_texts()
            assert len(rows) == 4
            assert "the others" in rows[1]
        await page.wait_for_function("() => mdmPage.history.predicates.get('Near')?.length > 1")
        statuses = await page.evaluate("mdmPage.history.predicates.get('Near').map((each) => each.status)")
        assert all(one != other for one, other in pairwise(statuses))
        assert "2 ensembles, 1 predicate, " in await page.get_attribute(".timeline canvas", "aria-label")

    seen(look_at, mdm.load_system(a_robot(tmp_path)))


def test_what_ensembles_do_tells_which_are_above_each_other():
    paths = ("ada/patrol", "bob/patrol", "bob/patrol/leg")
    lives = [(LifeFrame(action, 3.0),) for action in ("GoEast", "Leg", "GoWest")]
    run = Told(paths)
    run.turn(paths, tuple([EnsembleFrame("deciding", 2.0, live=live) for live in lives]))

    async def program():
        async with served(run) as address, browsers.browser() as (look, wrong):
            page = await look(address)
            await page.wait_for_selector(".headline .deciding")
            told = await text(page, ".headline span")
            assert told == "ada/patrol: GoEast; bob/patrol: Leg \u203a bob/patrol/leg: GoWest"
            assert wrong == []

    browsers.run(program())


def test_a_factor_told_by_places_says_by_which_predicate_and_that_the_map_tells_it():
    class Patrol(Told):
        def scene(self):
            factor = FactorScene("position", ("Hall", "Lab"), ("Hall.reached", "Lab.reached"))
            (of,) = super().scene().ensembles
            told = "told by the robot's pose on the map, unknown after 0.5 s"
            predicates = tuple(PredicateScene(f"{room}.reached", told) for room in ("Hall", "Lab"))
            of = msgspec.structs.replace(of, factors=(factor,))
            return msgspec.structs.replace(super().scene(), ensembles=(of,), predicates=predicates)

        def frame(self, close=()):
            detail = Detail(state="Lab", factors=(("position", "Lab"),))
            team = {"agent ada": {"is": "this agent"}, "ensemble patrol": {"the leader's term": "3"}}
            return Frame(12.0, self._frames, (False, True), (0.0, 0.0), details={"patrol": detail}, team=team)

    async def program():
        async with served(Patrol(("patrol",))) as address, browsers.browser() as (look, wrong):
            page = await look(address)
            await page.wait_for_selector(".chip")
            assert await text(page, ".chip") == "position Lab ← Lab.reached, told by the robot's pose on the map"
            team = await text(page, "[aria-label=Team]")
            assert "3" in team
            assert "One agent leads for a term" in team
            assert wrong == []

    browsers.run(program())


def test_a_team_is_a_graph_and_faults_and_latencies_are_gathered():
    class Team(Told):
        def frame(self, close=()):
            lost = {"link": "lost", "last heard": "9.0 s ago", "messages lost": "30 of 90"}
            team = {
                "agent ada (ada)": {"is": "this agent"},
                "agent bob (ada)": {"link": "live", "last heard": "0.1 s ago", "round trip": "2 ms"},
                "agent cyd (ada)": lost,
                "ensemble patrol (ada)": {"this agent is": "leading", "led by": "ada", "the leader's term": "3"},
                "agent cyd": {"link": "lost", "process": "does not answer"},
            }
            spread = Spread(4, 2e-4, 2e-3, 2e-3, ((2e-4, 3), (2e-3, 1)))
            return Frame(
                *(12.0, self._frames, (True, None), (0.0, 0.0)),
                statistics=StatisticsFrame({"inputs handled": 4.0}, {"ada/patrol": spread}, {}),
                team=team,
            )

    run = Team()
    waits = EnsembleFrame("deciding", 1.0, waiting=("a pause of 3.2 s",))
    idle = tuple([EnsembleFrame("deciding", 2.0, idle=since) for since in (11.0, 5.0)])  # one between two decisions
    run.turn(("ada/patrol", "bob/patrol", "cyd/patrol"), (waits, *idle))
    for number in range(196):
        run.ring.add(1.0 + number / 100, "fault", f"robot{number}", "idle", detail="idle for 5 s: nothing")
    for action in ("A", "B"):
        run.ring.add(3.0, "fault", "bob/patrol", "action", detail=f"action {action!r} failed")

    async def program():
        async with served(run) as address, browsers.browser() as (look, wrong):
            page = await look(address)
            await page.wait_for_function("() => mdmPage.history.faults.length === 198")
            links = await page.get_attribute(".links", "aria-label")
            assert links == (
                "ada and bob: live, heard 0.1 s ago, 2 ms there and back; "
                "ada and cyd: lost, heard 9.0 s ago, 30 of 90 messages lost"
            )
            nodes = await page.eval_on_selector_all(
                ".links g text:last-child", "(all) => all.map((each) => each.innerHTML)"
            )
            assert nodes[-3:] == ["ada, leads", "bob", "✕ cyd"]
            faults = await page.locator(".fault").all_inner_texts()
            assert len(faults) == 3
            (idle,) = [" ".join(each.split()) for each in faults if "idle" in each]
            assert idle.startswith("⚠ idle \u00d7196 robot0, robot1, robot2 and 193 more")
            ticks = await page.eval_on_selector_all(
                ".histogram .ticks span", "(all) => all.map((each) => [each.innerText, each.offsetLeft])"
            )
            assert [text for text, _ in ticks] == ["200 µs", "500 µs", "1 ms", "2 ms"]
            places = dict(ticks)
            assert places["2 ms"] - places["1 ms"] == pytest.approx(places["1 ms"] - places["500 µs"], abs=3)
            waits, rests = [" ".join(each.split()) for each in await page.locator(".headline .line").all_inner_texts()]
            assert waits == "… ada/patrol waits for a pause of 3.2 s"  # for how long nobody knows
            assert rests == "\u2013 cyd/patrol has nothing to do since 7.0 s"
            rows = await page.locator("[role=option]").all_inner_texts()
            assert [row.split()[2] for row in rows] == ["waiting", "deciding", "idle"]
            assert await browsers.barriers(page) == []
            assert wrong == []

    browsers.run(program())


def test_a_lane_of_a_predicate_says_from_when_on_it_is_known():
    class Late(Told):
        def frame(self, close=()):
            return Frame(12.0, self._frames, (True, None), (6.0, 9.0))

    async def program():
        async with served(Late()) as address, browsers.browser() as (look, wrong):
            page = await look(address)
            await page.wait_for_selector("[role=option]")
            await page.keyboard.press("0")  # all of the time
            canvas = page.locator(".timeline canvas")
            box = await canvas.bounding_box()
            for share, row, words in (
                (0.25, 0, "ada: Near is not known before 00:06.0"),
                (0.75, 0, "ada: Near true from 00:06.0"),
                (0.6, 1, "bob: Near is not known before 00:09.0"),
                (0.9, 1, "bob: Near unknown from 00:09.0"),
            ):
                place = {"x": 118 + (box["width"] - 118) * share, "y": 24 + 2 * 46 + 18 * row + 8}
                await canvas.hover(position=place)
                await page.wait_for_function(f"() => document.querySelector('.tip')?.innerText === '{words}'")
            assert wrong == []

    browsers.run(program())


def test_the_timeline_tells_of_what_the_pointer_is_on(tmp_path):
    async def run(runtime):
        await runtime.start(mdm.load_system(a_robot(tmp_path)))
        await asyncio.sleep(40)

    run_virtual(run, record=tmp_path / "run.mcap")
    system = mdm.load_system(a_robot(tmp_path))
    recorded = RecordedRun(
        Record(tmp_path / "run.mcap"), system, ensembles=system.ensembles, predicates=system.predicates
    )
    recorded.restore()

    async def program():
        async with served(recorded) as address, browsers.browser() as (look, wrong):
            page = await look(address)
            await page.wait_for_function(UNTIL)
            await page.wait_for_function(
                "() => mdmPage.history.faults.length > 0 && mdmPage.history.predicates.size > 0"
            )
            await page.keyboard.press("f")
            await page.wait_for_function("() => mdmPage.frame.time > 0")
            await page.wait_for_function("() => document.querySelector('.timeline .told').innerText.includes('⚠')")
            await page.get_by_label("Draw a signal").select_option("predicate Low")
            await page.wait_for_selector("[aria-label='Predicate Low over time'] .u-over")
            canvas = await page.locator(".timeline canvas").bounding_box()
            fault = recorded.step("fault", 0.0)
            across = canvas["x"] + 118 + (canvas["width"] - 118) * fault / recorded.last
            middle = canvas["x"] + 118 + (canvas["width"] - 118) * 0.5
            for x, y, words in (
                (across, 18, "⚠"),  # faults
                (middle, 30, "top decides from"),  # its mode
                (middle, 44, "0:"),  # a life of an action
                (middle, 24 + 2 * 46 + 8, "Low false from"),  # the predicate of the chosen ensemble
            ):
                async with asyncio.timeout(PATIENCE):  # what lies above may still move the timeline
                    place = {"x": x - canvas["x"], "y": y}
                    while not await page.evaluate(f"document.querySelector('.tip')?.innerText.includes('{words}')"):
                        await page.locator(".timeline canvas").hover(position=place)
            await page.mouse.move(5, 5)
            await page.wait_for_function("() => !document.querySelector('.tip')")
            await page.keyboard.press("n")
            told = await text(page, ".timeline .told")
            assert re.match(r"[0-9:.]+ top decided [01], decision [0-9]+, ", told)
            assert "in state" in told
            assert await browsers.barriers(page) == []
            assert wrong == []

    browsers.run(program())


def test_over_time_is_of_the_whole_record_though_nobody_has_gone_through_it_and_of_the_time_that_is_zoomed_to(tmp_path):
    robot, heard = ensemble(), []

    async def run(runtime):
        await runtime.start(robot)
        for number in range(100):
            await asyncio.sleep(1)
            robot.publish_observation("hear-right" if number % 7 == 3 else "hear-left")
            heard.append((runtime.now() / 1e9, *robot.controller.decided_by))

    run_virtual(run, record=tmp_path / "run.mcap")
    record = Record(tmp_path / "run.mcap")
    began = record.span[0] / 1e9
    chances = {round(time - began, 3): dict(zip("lr", belief, strict=True)) for time, *belief in heard}

    async def program():
        async with served(RecordedRun(record)) as address, browsers.browser() as (look, wrong):
            page = await look(address)
            await page.wait_for_function("() => mdmPage.course?.course")
            await page.wait_for_selector("[aria-label='Over time'] .u-over")
            course = await page.evaluate("mdmPage.course.course")
            left = course["beliefs"][course["states"].index("tiger-left")]
            assert len(course["times"]) == 101
            for time, chance in list(zip(course["times"], left, strict=True))[1:]:
                assert chance == pytest.approx(chances[round(time, 3)]["l"], abs=1e-4)
            assert await page.get_by_role("button", name="keep to now").count() == 0
            await page.get_by_label("Draw a signal").select_option("states in doubt")
            await page.wait_for_selector("[aria-label='States in doubt over time'] .u-over")
            doubt = [2**each for each in course["entropies"]]
            assert min(doubt) >= 1
            assert max(doubt) == pytest.approx(2)
            for _ in range(3):
                await page.keyboard.press("+")
            await page.wait_for_function("() => mdmPage.course.last < 20")
            assert len(await page.evaluate("mdmPage.course.course.times")) == 13
            over = "[aria-label='Over time'] .u-over"
            async with asyncio.timeout(PATIENCE):  # the chart is made again for the time that is zoomed to
                while not await page.evaluate("Math.abs(mdmPage.frame.time - 6.25) < 0.2"):
                    width = await page.evaluate(f'document.querySelector("{over}").clientWidth')
                    await page.locator(over).first.click(position={"x": width / 2, "y": 20})
            assert await browsers.barriers(page) == []
            assert wrong == []

    browsers.run(program())


def test_a_key_and_a_button_lead_to_where_something_first_looked_odd_and_the_timeline_marks_it(tmp_path):
    spans = iter([2.0, 3.0, 2.0, 1e9])

    async def go():
        await asyncio.sleep(next(spans))

    robot = Ensemble("robot", policy=DeterministicPolicy([0]), actions={0: mdm.Binding(go, then="decide", pause=0.2)})

    async def run(runtime):
        await runtime.start(robot)
        robot.publish_state(0)
        await asyncio.sleep(60)

    run_virtual(run, record=tmp_path / "run.mcap")
    begins = 2.0 + 3.0 + 2.0 + 3 * 0.2 + 10.0

    async def program():
        recorded = RecordedRun(Record(tmp_path / "run.mcap"))
        async with served(recorded) as address, browsers.browser() as (look, wrong):
            page = await look(address)
            await page.wait_for_function(UNTIL)
            assert await page.locator(".headline .judged").count() == 0
            await page.get_by_role("button", name="judgement ▶").click()
            await page.wait_for_function(f"() => Math.abs(mdmPage.frame.time - {begins}) < 1e-6")
            await page.wait_for_selector(".headline .judged")
            assert "robot: 0 has lasted for more than 10 s, since 00:07.6" in await text(page, ".headline")
            await page.keyboard.press("j")
            await page.wait_for_function("() => document.querySelector('.ended').innerText.includes('no further')")
            canvas = await page.locator(".timeline canvas").bounding_box()
            place = {"x": 118 + (canvas["width"] - 118) * begins / recorded.last + 5, "y": 30}
            await page.locator(".timeline canvas").hover(position=place)
            await page.wait_for_function("() => document.querySelector('.tip')?.innerText.includes('hangs from 00:17')")
            assert await browsers.barriers(page) == []
            assert wrong == []

    browsers.run(program())


def test_a_record_in_the_dark_keeps_nobody_out(tmp_path):
    async def run(runtime):
        await runtime.start(mdm.load_system(a_robot(tmp_path)))
        await asyncio.sleep(10)

    run_virtual(run, record=tmp_path / "run.mcap")

    async def program():
        recorded = RecordedRun(Record(tmp_path / "run.mcap"))
        async with served(recorded) as address, browsers.browser(color_scheme="dark") as (look, wrong):
            page = await look(address)
            await page.wait_for_function(UNTIL)
            assert await browsers.barriers(page) == []
            assert wrong == []

    browsers.run(program())


def test_why_is_told_with_the_decision_that_it_is_of():
    robot = ensemble()

    async def look_at(page, *_):
        robot.publish_observation("hear-left")
        await page.wait_for_function("() => mdmPage.frame.ensembles[0].epoch === 1")
        await page.keyboard.press("w")
        why = page.get_by_label("Why decision 1 at 00:")
        await why.wait_for()
        assert "since then" not in await why.inner_text()
        bars = await page.evaluate(
            """Object.fromEntries([...document.querySelectorAll('.why .track.axis')].slice(0, 3).map((track) =>
            [track.previousSibling.innerText, track.querySelector('.fill').clientWidth / track.clientWidth]))"""
        )
        # 85 % for the tiger on the left: 0 to listen, -75 and -5 to open, on an axis from -75 to 0
        assert bars == pytest.approx({"listen": 0, "open-right": 5 / 75, "open-left": 1}, abs=0.02)
        assert "ahead of open-right by 5" in await why.inner_text()
        stacks = "[...document.querySelectorAll('.stack')].map((each) => each.getAttribute('aria-label'))"
        before, after = await page.evaluate(stacks)
        assert "tiger-left 50.0 %" in before
        assert "tiger-left 85.0 %" in after
        assert await page.locator(".why .arrow").count() == 2
        assert await page.locator(".why .then").inner_text() == "⟶ open-right"
        ticks = (
            "import('./words.js').then((words) => [50.1, 50.15].map((time) => words.clock(time, words.digits(0.05))))"
        )
        assert await page.evaluate(ticks) == ["00:50.10", "00:50.15"]  # however far one zooms, each is another one
        tints = "import('./words.js').then(({ tint }) => %s.map((name) => tint(mdmPage.scene, 'robot', name)))"
        assert await page.evaluate(tints % "mdmPage.scene.ensembles[0].actions") == ["a0", "a1", "a2"]
        assert await page.evaluate("import('./words.js').then(({ colour }) => colour('robot') !== colour('bad'))")
        robot.publish_observation("hear-left")
        await page.wait_for_function("() => mdmPage.frame.ensembles[0].epoch === 2")
        await why.filter(has_text="since then it has decided again").wait_for()

    seen(look_at, robot)


def test_it_draws_the_policy_with_the_branch_that_was_taken_lit():
    table = DeterministicPolicy([0, 2, 1, 2] * 2 + [0, 0, 1, 1], 3)
    factors = [
        Factor("room", ["hall", "lab", "attic"]),
        Factor("door", ["open", "shut"]),
        Factor("load", ["no", "yes"]),
    ]
    table.state_space = Space(factors)
    robot = Ensemble("robot", policy=table, actions=dict.fromkeys(range(3), lambda: None))
    rows = [[min(node + 1, 99)] * 2 for node in range(100)]
    plan = Ensemble("plan", policy=FiniteStateController([0] * 100, rows), actions={0: lambda: None})
    lit = "[...document.querySelectorAll('.policy .box.lit')].map((box) => box.textContent)"
    ways = {"hall open yes": "2", "attic shut no": "1"}

    async def look_at(page, *_):
        for state, action in ways.items():
            robot.publish_state(table.state_space.index(state))
            await page.wait_for_function(f"() => {lit}.some((text) => text.endsWith('{action}{action}'))")
        assert re.fullmatch(r"asks for (\w+)\1", (await page.evaluate(lit))[0])
        await page.click("[role=option] >> text=plan")
        fold = page.locator(".policy [role=button]")
        await fold.wait_for()
        before = await page.locator(".policy .box").count()
        await fold.focus()
        await page.keyboard.press("Enter")
        await page.wait_for_function(f"() => document.querySelectorAll('.policy .box').length > {before}")

    seen(look_at, robot, plan)


def test_lanes_that_are_too_close_to_draw_are_marked_and_refined_as_one_zooms(tmp_path):
    def nothing():
        pass

    async def run(runtime):
        manager = mdm.PredicateManager("predicates")
        sensor = manager.sensor("On", initial=False)
        policy = DeterministicPolicy([0, 1])
        states, actions = [mdm.StateFactor("on", ["On"])], {0: nothing, 1: nothing}
        await runtime.start(Ensemble("robot", policy=policy, states=states, actions=actions, predicates=manager))
        for step in range(3_000):
            sensor.set(step % 2 == 0)
            await asyncio.sleep(0.1)

    run_virtual(run, record=tmp_path / "run.mcap")
    recorded = RecordedRun(Record(tmp_path / "run.mcap"))
    decided = "mdmPage.history.lane('robot').decisions"

    async def main():
        async with served(recorded) as address, browsers.browser() as (look, wrong):
            page = await look(address)
            await page.wait_for_function("() => mdmPage.history.asked")
            assert await page.evaluate("mdmPage.history.thinned")
            counts = await page.evaluate(f"{decided}.map((each) => each.count ?? 1)")
            assert sum(counts) == len(recorded._ensembles["robot"].decisions.times)
            assert len(counts) < 2_000
            assert set(await page.evaluate(f"{decided}.map((each) => each.status ?? '')")) <= {"", "several"}
            await page.locator("canvas").first.focus()
            while await page.evaluate("mdmPage.history.thinned"):
                await page.keyboard.press("+")
                await asyncio.sleep(0.05)
            first, last = await page.evaluate("[mdmPage.history.asked.first, mdmPage.history.asked.last]")
            times = await page.evaluate(f"{decided}.map((each) => each.time)")
            own = [time / 1e9 for time in recorded._ensembles["robot"].decisions.times]
            start = recorded._epoch / 1e9
            assert [time for time in times if first <= time] == pytest.approx(
                [time - start for time in own if first <= time - start <= last]
            )
            assert wrong == []

    browsers.run(main())
