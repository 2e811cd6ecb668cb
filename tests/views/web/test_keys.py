"""The keys of the page, in a real browser, wherever the focus is."""

from __future__ import annotations

import browsers
import pytest
from told import Kept, Told, served

browsers.needed()
pytestmark = pytest.mark.slow  # each takes a second or two of a processor in Chromium


def in_a_browser(program, **options):
    async def main():
        async with browsers.browser(**options) as (look, wrong):
            await program(look, wrong)
            assert wrong == []

    browsers.run(main())


async def at(page, second):
    await page.wait_for_function(f"() => Math.abs(mdmPage.frame.time - {second}) < 1e-6")


@pytest.mark.parametrize("of", ["Time", pytest.param("Speed", marks=pytest.mark.slow)])
def test_the_keys_of_a_record_work_at_its_own_controls(of):
    kept = Kept()

    async def program(look, _):
        async with served(kept) as address:
            page = await look(address)
            await page.wait_for_selector("[role=option]")
            await page.get_by_label(of, exact=True).focus()
            for key, second in (("d", 2), ("n", 4), ("f", 6), ("m", 8), ("j", 10), ("Shift+d", 8)):
                await page.keyboard.press(key)
                await at(page, second)
            assert kept.commands == [
                *((kind, False) for kind in ("decision", "change", "fault", "mode", "judgement")),
                ("decision", True),
            ]
            await page.keyboard.press("w")
            await page.wait_for_function("() => mdmPage.why")
            if of == "Speed":  # which keeps the keys by which it chooses
                await page.keyboard.press("ArrowDown")
                await page.wait_for_function("() => mdmPage.speed === 2")
                return
            await page.keyboard.press("ArrowRight")
            await at(page, 9)
            await page.keyboard.press("ArrowLeft")
            await page.keyboard.press("ArrowLeft")
            await at(page, 7)
            await page.keyboard.press("ArrowDown")
            await page.wait_for_function("() => mdmPage.selected === 'bob/patrol'")
            await page.keyboard.press("ArrowUp")
            await page.wait_for_function("() => mdmPage.selected === 'ada/patrol'")
            await page.keyboard.press("Space")
            await page.wait_for_function("() => mdmPage.playing && mdmPage.frame.time > 7.2")
            await page.keyboard.press("Space")
            await page.wait_for_function("() => !mdmPage.playing")

    in_a_browser(program)


def test_a_click_on_the_name_of_a_lane_chooses_its_ensemble_and_leaves_the_time():
    async def program(look, _):
        async with served(Kept()) as address:
            page = await look(address)
            await page.wait_for_selector("[role=option]")
            await page.keyboard.press("d")
            await at(page, 2)
            canvas = page.locator(".timeline canvas")
            await canvas.click(position={"x": 20, "y": 24 + 46 + 12})
            await page.wait_for_function("() => mdmPage.selected === 'bob/patrol'")
            await canvas.click(position={"x": 20, "y": 8})  # beside the names
            await at(page, 2)
            await canvas.click(position={"x": 400, "y": 24 + 12})
            await page.wait_for_function("() => mdmPage.frame.time > 5")
            assert await page.evaluate("mdmPage.selected") == "bob/patrol"

    in_a_browser(program)


def test_the_focus_and_the_answer_to_why_come_into_sight_above_the_bar_of_a_record():
    async def program(look, _):
        async with served(Kept(tuple(f"robot{number:02}" for number in range(14)))) as address:
            page = await look(address)
            await page.wait_for_selector("[role=option]")
            bar = "document.querySelector('.controls').getBoundingClientRect().top"

            async def is_in_sight(selector):
                box = f"document.querySelector('{selector}').getBoundingClientRect()"
                await page.wait_for_function(f"() => {box}.top >= 0 && {box}.bottom <= {bar}")

            await page.locator("[aria-label='Zoom in']").focus()
            for _ in range(30):
                await page.keyboard.press("Tab")
                if await page.evaluate("!document.activeElement.closest('main')"):
                    break
                assert await page.evaluate(f"document.activeElement.getBoundingClientRect().top < {bar}")
                if await page.evaluate("document.activeElement.matches('input, button')"):
                    assert await page.evaluate(f"document.activeElement.getBoundingClientRect().bottom <= {bar}")
            await page.evaluate("document.querySelector('.content').scrollTo(0, 0)")
            await page.keyboard.press("w")
            await page.wait_for_function("() => document.body.innerText.includes('There is no ensemble robot00')")
            await is_in_sight("[aria-label^=Why] .empty")

    in_a_browser(program, viewport={"width": 390, "height": 500})


def test_the_list_of_keys_has_those_that_do_something_and_a_step_says_where_there_is_none():
    async def keys(page):
        await page.wait_for_selector("[role=option]")
        await page.keyboard.press("?")
        await page.wait_for_selector("[aria-label=Keys]")
        return (await page.locator("[aria-label=Keys] dt").all_inner_texts()), await page.inner_text(
            "[aria-label=Keys]"
        )

    async def program(look, _):
        async with served(Told()) as address:
            listed, words = await keys(await look(address))
            assert listed == ["space", "↑", "↓", "+", "-", "w", "l", "?", "0"]
            assert "freeze" in words
            assert "shift" not in words
        async with served(Kept()) as address:
            page = await look(address)
            listed, words = await keys(page)
            assert listed[:5] == ["d", "n", "f", "m", "j"]
            assert "With shift, d, n, f, m and j" in words
            assert "freeze" not in words
            for key, words in (("Shift+d", "no earlier decision"), ("Shift+m", "no earlier change of a mode")):
                await page.keyboard.press(key)
                await page.wait_for_function(f"() => document.querySelector('.ended').innerText === '{words}'")
            await page.wait_for_function("() => document.querySelector('.ended').innerText === ''")

    in_a_browser(program)
