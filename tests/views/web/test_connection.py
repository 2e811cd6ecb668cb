"""The page in a real browser, where what it shows breaks, ends and begins anew."""

from __future__ import annotations

import browsers
import pytest
from told import DECIDES, Told, served
from transports import free_port

from mdm.snapshots import EnsembleFrame
from mdm.snapshots.frame import CauseFrame, Judgement

browsers.needed()
pytestmark = pytest.mark.slow  # each takes a second or two of a processor in Chromium


def in_a_browser(program, **options):
    async def main():
        async with browsers.browser(**options) as (look, wrong):
            await program(look, wrong)

    browsers.run(main())


async def count(page, selector):
    return await page.locator(selector).count()


async def parts(page):
    """Return the parts of the page from top to bottom, by their tags."""
    found = "document.querySelectorAll('#page header, #page .headline, #page main, #page section:not(main *)')"
    return await page.evaluate(f"[...{found}].map((each) => each.tagName)")


WHOLE = ["HEADER", "SECTION", "MAIN"]


def test_a_team_that_ends_leaves_its_last_picture_and_one_that_begins_anew_makes_one_page():
    port = free_port()
    told = Told()

    async def program(look, wrong):
        async with served(told, port) as address:
            page = await look(address)
            await page.wait_for_selector("[role=option]")
            told.turn(("bob/patrol",))  # as agents end, one after the other
            await page.wait_for_function("() => mdmPage.selected === 'bob/patrol'")
            told.turn(())
            await page.wait_for_function("() => mdmPage.scene.ensembles.length === 0")
            await page.wait_for_function("() => document.querySelectorAll('[role=option]').length === 0")
            assert await parts(page) == WHOLE
        await page.wait_for_function("() => document.querySelector('header').innerText.includes('not connected')")
        await page.wait_for_function("() => document.querySelectorAll('[role=option]').length === 2")
        assert await parts(page) == WHOLE
        async with served(Told(began=2), port):
            await page.wait_for_function("() => document.querySelector('header').innerText.includes('● live')")
            await page.wait_for_function("() => mdmPage.scene.began === 2")
            assert await parts(page) == WHOLE
            assert await count(page, "[role=option]") == 2
        assert [each for each in wrong if not each.startswith("failed: ws")] == []

    in_a_browser(program)


def test_a_part_that_cannot_be_drawn_is_said_to_be_and_leaves_the_others():
    async def program(look, wrong):
        async with served(Told()) as address:
            page = await look(address)
            await page.wait_for_selector("[aria-label=Predicates]")
            await page.evaluate("mdmPage.whole = mdmPage.scene.predicates; mdmPage.scene.predicates = null")
            await page.wait_for_function("() => document.body.innerText.includes('the predicates cannot be drawn')")
            assert await parts(page) == WHOLE
            assert await count(page, "[role=option]") == 2
            assert await count(page, "[aria-label=Predicates]") == 0
            await page.evaluate("mdmPage.scene.predicates = mdmPage.whole")
            await page.wait_for_selector("[aria-label=Predicates]")
            await page.wait_for_selector("[aria-label=Timeline]")
            assert await parts(page) == WHOLE
            assert await count(page, "[aria-label=Predicates]") == 1 + 1  # the part, and its list
            assert len(wrong) == 1  # told in the console, once
            title = "Object.defineProperty(mdmPage.scene, 'title', {configurable: true, %s})"
            await page.evaluate(title % "get() { throw Error('torn'); }")
            await page.wait_for_function("() => document.body.innerText.includes('the page cannot be drawn: torn')")
            assert await parts(page) == ["SECTION"]
            await page.evaluate(title % "value: 'mended'")
            await page.wait_for_function("() => document.querySelectorAll('[role=option]').length === 2")
            await page.wait_for_selector("[aria-label=Timeline]")
            assert await parts(page) == WHOLE

    in_a_browser(program)


def test_a_question_is_in_sight_takes_the_focus_and_gives_it_back():
    told = Told(control=True)

    async def program(look, wrong):
        async with served(told, control=True) as address:
            page = await look(address)
            button = page.get_by_role("button", name="set false")
            await button.wait_for()
            await page.evaluate("document.querySelector('main').style.paddingTop = '3000px'")
            await button.scroll_into_view_if_needed()
            await button.focus()
            at = "document.querySelector('.content').scrollTop"
            scrolled = await page.evaluate(at)
            assert scrolled > 1000
            for leave in ("Escape", "Enter"):  # by which No is pressed, which has the focus
                await page.keyboard.press("Enter")
                await page.locator("dialog.ask").wait_for()
                box = await page.locator("dialog.ask").bounding_box()
                assert 0 <= box["y"] <= 900 - box["height"]
                assert await page.evaluate("document.activeElement.innerText") == "No"
                assert await browsers.barriers(page) == []
                await page.keyboard.press("ArrowDown")  # which chooses no ensemble meanwhile
                await page.keyboard.press(leave)
                await page.wait_for_function("() => !document.querySelector('dialog')")
                assert await page.evaluate("document.activeElement.innerText") == "set false"
                assert await page.evaluate(at) == scrolled
            assert await page.evaluate("mdmPage.selected") == "ada/patrol"
            assert told.commands == []
            assert wrong == []

    in_a_browser(program, viewport={"width": 1300, "height": 900})


def test_where_the_program_has_ended_nothing_looks_alive_and_no_command_is_offered():
    told = Told(control=True)

    async def program(look, wrong):
        async with served(told, control=True) as address:
            page = await look(address)
            await page.wait_for_selector(".headline.calm")
            assert await page.get_by_role("button", name="set false").is_enabled()
            await page.get_by_role("button", name="stop", exact=True).click()
            await page.wait_for_selector("dialog")
        await page.wait_for_selector(".headline.cut")
        banner = await page.inner_text(".headline")
        assert "✕ not connected" in banner
        assert "decide" not in banner
        await page.wait_for_function("() => !document.querySelector('dialog')")
        assert "grayscale" in await page.evaluate("getComputedStyle(document.querySelector('main')).filter")
        for name in ("start", "stop", "reset", "release", "set false", "Why this action?", "freeze"):
            assert await page.get_by_role("button", name=name, exact=True).first.is_disabled()
        assert await page.evaluate("document.documentElement.scrollWidth") <= 390
        badge = await page.locator("header .badge").bounding_box()
        assert badge["x"] + badge["width"] <= 390
        assert await browsers.barriers(page) == []

    in_a_browser(program, viewport={"width": 390, "height": 844})


def test_the_headline_has_the_sign_and_the_colour_of_that_which_it_says():
    stopped, idle = EnsembleFrame("stopped", 1.0), EnsembleFrame("deciding", 1.0, idle=2.0)
    looks = Judgement("repeats", "ada/patrol", "Go", "look", 12, 1.0, "decided Go 12 times")
    fails = Judgement("fails", "bob/patrol", "Go", "wrong", 3, 2.0, "Go has failed 3 times, never succeeded")
    two = ("ada/patrol", "bob/patrol")
    told = Told()

    async def program(look, wrong):
        async with served(told) as address:
            page = await look(address)
            for frames, judged, kind, words in (
                ((DECIDES, DECIDES), (), "calm", "▶ all 2 ensembles decide"),
                ((stopped, stopped), (), "rests", "○ every ensemble is stopped"),
                ((stopped, DECIDES), (), "calm", "▶ 1 of 2 ensembles decide"),
                ((idle, idle), (), "waits", "\N{EN DASH} ada/patrol has nothing to do"),
                ((DECIDES, DECIDES), (looks,), "waits", f"? {looks}"),
                ((DECIDES, DECIDES), (fails, looks), "alarm", f"✕ {fails}"),
            ):
                told.turn(two, frames, judged)
                await page.wait_for_function(
                    f"() => document.querySelector('.headline.{kind} strong')?.innerText.trim() === '{words}'"
                )
                assert await browsers.barriers(page) == []
            painted = "getComputedStyle(document.querySelector('%s')).backgroundColor"
            assert await page.evaluate(painted % ".headline") != await page.evaluate(painted % ".headline .look")
            rests = Judgement("idle", "ada/patrol", "", "look", 1, 2.0, "has nothing to do")
            told.turn(two, (idle, DECIDES), (rests,))
            await page.wait_for_function(f"() => document.querySelector('.headline').innerText.includes('{rests}')")
            assert await page.locator(".headline .line").count() == 1  # which says it once
            assert wrong == []

    in_a_browser(program)


def test_what_was_said_of_a_run_goes_with_it_and_that_a_command_is_done_after_some_seconds():
    port = free_port()
    told = Told(control=True)

    async def stop(page):
        await page.get_by_role("button", name="stop", exact=True).click()
        await page.get_by_role("button", name="Yes, stop").click()
        await page.wait_for_selector("text=✓ done: stop ada/patrol")

    async def program(look, wrong):
        async with served(told, port, control=True) as address:
            page = await look(address)
            await page.wait_for_selector("[role=option]")
            await stop(page)
            await page.wait_for_function("() => !document.body.innerText.includes('✓ done')")
            await page.get_by_role("button", name="Why this action?").click()
            await page.wait_for_function("() => mdmPage.why")
            await stop(page)
        await page.wait_for_selector(".headline.cut")
        assert await page.evaluate("Boolean(mdmPage.said && mdmPage.why)")
        async with served(Told(began=2, control=True), port, control=True):
            await page.wait_for_function("() => mdmPage.scene.began === 2")
            assert await page.evaluate("[mdmPage.said, mdmPage.why]") == [None, None]
            await page.wait_for_function("() => !document.body.innerText.includes('Nothing tells why')")

    in_a_browser(program)


def test_the_commands_that_would_do_nothing_now_are_not_offered_and_say_why():
    stopped = EnsembleFrame("stopped", 1.0)
    safe = EnsembleFrame("safe", 1.0, causes=(CauseFrame("policy", "it is torn", 1.0),))
    told = Told(("ada/patrol",), control=True)

    async def program(look, wrong):
        async with served(told, control=True) as address:
            page = await look(address)
            for frame, sign, offered in (
                (DECIDES, "▶", {"stop", "reset"}),
                (stopped, "○", {"start"}),
                (safe, "■", {"start", "stop", "reset", "release"}),
            ):
                told.turn(("ada/patrol",), (frame,))
                badge = page.get_by_label("Ensemble ada/patrol").locator(".badge", has_text=sign)
                await badge.wait_for()
                for word in ("start", "stop", "reset", "release"):
                    button = page.get_by_role("button", name=word, exact=True)
                    assert await button.is_enabled() == (word in offered), (sign, word)
                    assert bool(await button.get_attribute("title")) == (word not in offered)
            await page.get_by_role("button", name="release", exact=True).click()
            assert await page.inner_text(".ask b") == (
                "release ada/patrol? It leaves its safe mode: you answer for its causes, and the robot may move."
            )
            assert wrong == []

    in_a_browser(program)
