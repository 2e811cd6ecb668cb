"""A record as one file, opened by a browser from the disk."""

from __future__ import annotations

import asyncio
import base64
import gzip
import json
import re

import browsers
import pytest
from shown import a_robot

import mdm
from mdm.recording import Record
from mdm.snapshots import RecordedRun
from mdm.testing import run_virtual
from mdm.views.web import file
from mdm.views.web.file import page_file


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("record")

    async def main(runtime):
        await runtime.start(mdm.load_system(a_robot(folder)))
        await asyncio.sleep(20)

    run_virtual(main, record=folder / "run.mcap")
    system = mdm.load_system(folder / "robot.toml")
    return RecordedRun(Record(folder / "run.mcap"), ensembles=system.ensembles)


def told(page):
    """Return what a page that is one file is told."""
    packed = re.search(rb'id="record">([^<]+)<', page)[1]
    return json.loads(gzip.decompress(base64.b64decode(packed)))


def test_its_pictures_are_those_of_the_record_at_all_that_happened(run):
    page = page_file(run)
    found = told(page)
    assert b'src="' not in page.replace(b'src="data:', b"")
    assert {each["time"] for each in found["frames"]} >= {each["time"] for each in found["events"]}
    for frame in found["frames"][::7]:
        shown = run.frame(frame["time"], ["top", "top/walk"])
        assert [each.get("action", "") for each in frame["ensembles"]] == [each.action for each in shown.ensembles]
        assert frame["details"]["top"].get("state") == shown.details["top"].state
    assert [each["path"] for each in found["scene"]["ensembles"]] == ["top", "top/walk"]
    assert page_file(run) == page


def test_of_a_part_of_the_time_it_has_no_more(run):
    found = told(page_file(run, 5.0, 8.0))
    assert (found["scene"]["first"], found["scene"]["last"]) == (5.0, 8.0)
    assert {5.0 <= each["time"] <= 8.0 for each in found["frames"]} == {True}
    assert max(each["time"] for each in found["events"] if each["kind"] != "life") <= 8.0


def test_it_is_no_larger_than_it_may_be(run, monkeypatch):
    whole = len(page_file(run))
    monkeypatch.setattr(file, "HOURLY", whole - 1)
    assert len(page_file(run)) < whole


def test_it_explains_and_draws_some_of_many_decisions(run, monkeypatch):
    monkeypatch.setattr(file, "_LOOKS", 8)
    looks = told(page_file(run))["close"]["top"]["looks"]
    decided = run.lanes(0.0, 20.0, ["top"], [], 1000)
    assert 3 <= len(looks) <= 5
    assert {each["time"] for each in looks[1:]} <= {each.time for each in decided}
    for look in looks:
        drawn = asyncio.run(run.draw("top", look["time"]))
        assert [each["title"] for each in look["pictures"]] == [each.title for each in drawn]
        lit = [shape.get("lit", False) for shape in look["pictures"][0]["shapes"]]
        assert lit == [each.lit for each in drawn[0].shapes]
        assert look["why"]["text"] == asyncio.run(run.explain("top", look["time"])).text


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_a_browser_opens_it_without_a_server_and_steps_through_it(run, tmp_path):
    path = tmp_path / "run.html"
    path.write_bytes(page_file(run))

    async def main():
        async with browsers.browser() as (look, wrong):
            page = await look(path.as_uri())
            await page.wait_for_function("() => globalThis.mdmPage?.history.asked && mdmPage.frame")
            assert await page.get_by_role("heading", name="run.mcap").count() == 1
            times = []
            for key in ("d", "n", "n", "m"):
                before = await page.evaluate("mdmPage.frame.time")
                await page.keyboard.press(key)
                await page.wait_for_function(f"() => mdmPage.frame.time > {before}")
                times.append(await page.evaluate("mdmPage.frame.time"))
            after = run.step("decision", 0.0)
            assert times[0] == pytest.approx(after)
            assert times[1] == pytest.approx(run.step("change", after))
            await page.get_by_label("Policy of top").locator("svg g.lit").first.wait_for()
            assert await page.evaluate("mdmPage.link") == "open"
            assert wrong == []

    browsers.run(main())
