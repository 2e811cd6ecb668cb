"""The server of a page, asked over real sockets."""

from __future__ import annotations

import asyncio
import json

import pytest
from served import TOKEN, get, shown, socket
from shown import a_robot

import mdm
from mdm.views.web.server import _reason, pause

websockets = pytest.importorskip("websockets")


def test_its_files_come_with_headers_that_let_nothing_else_in():
    async def main(_, page):
        for path, kind in (("/", "text/html"), ("/page.js", "text/javascript"), ("/vendor/uplot.css", "text/css")):
            status, headers, body = await get(page, path)
            assert (status, headers["Content-Type"].split(";")[0]) == (200, kind)
            assert len(body) == int(headers["Content-Length"]) > 100
            policy = headers["Content-Security-Policy"]
            assert "default-src 'none'" in policy
            assert "frame-ancestors 'none'" in policy
            assert "unsafe" not in policy
            assert headers["X-Content-Type-Options"] == "nosniff"
            assert headers["Referrer-Policy"] == "no-referrer"
            assert headers["Cache-Control"] == "no-store"
            assert "Access-Control-Allow-Origin" not in headers

    shown(main)


def test_nothing_beside_its_files_is_served():
    async def main(_, page):
        for path in (
            "/../server.py",
            "/static/../page.js",
            "/%2e%2e/server.py",
            "/vendor/",
            "//etc/passwd",
            "/page.js/",
        ):
            assert (await get(page, path))[0] == 404, path

    shown(main)


def test_the_token_becomes_a_cookie_and_leaves_the_address():
    async def main(_, page):
        status, headers, _ = await get(page, f"/?token={TOKEN}", Cookie=None)
        assert (status, headers["Location"]) == (303, "/")
        cookie = headers["Set-Cookie"].split(";")[0]
        assert (await get(page, "/", Cookie=cookie))[0] == 200

    shown(main)


def test_strangers_are_refused():
    async def main(_, page):
        assert (await get(page, "/", Cookie=None))[0] == 403
        assert (await get(page, "/page.js", Cookie=None))[0] == 403
        assert (await get(page, "/?token=wrong", Cookie=None))[0] == 403
        assert (await get(page, "/", Host="evil.example"))[0] == 421
        assert (await get(page, "/", Host=None))[0] in {400, 421}
        for change in ({"origin": "http://evil.example"}, {"origin": None}, {"cookie": "mdm=1"}):
            with pytest.raises(websockets.exceptions.InvalidStatus) as told:
                await socket(page, **change)
            assert told.value.response.status_code == 403

    shown(main)


def test_a_frame_is_sent_when_the_one_before_was_drawn():
    async def main(runtime, page):
        async with socket(page) as browser:
            assert "scene" in json.loads(await browser.recv())
            times = []
            for _ in range(4):
                await browser.send(json.dumps({"say": "drawn"}))
                times.append(json.loads(await browser.recv())["frame"]["time"])
            assert times == sorted(set(times))
            with pytest.raises(TimeoutError):  # nothing comes unasked, however long it sleeps
                await asyncio.wait_for(browser.recv(), 0.3)
            before = runtime.now()
            await browser.send(json.dumps({"say": "drawn"}))
            newest = json.loads(await browser.recv())["frame"]["time"]
            assert newest * 1e9 >= before - page._live._epoch  # the newest, not what was missed

    shown(main)


def test_two_browsers_get_the_same_frame():
    async def main(_, page):
        async with socket(page) as one, socket(page) as two:
            await one.recv()
            await two.recv()
            await asyncio.gather(*(browser.send(json.dumps({"say": "drawn"})) for browser in (one, two)))
            first, second = [json.loads(await browser.recv())["frame"]["time"] for browser in (one, two)]
            assert first == second

    shown(main)


@pytest.mark.parametrize("message", ["x" * 60_000, "{}", json.dumps({"say": "at", "time": 1})])
def test_what_is_no_message_closes_the_socket_and_the_robot_goes_on(message):
    async def main(runtime, page):
        async with socket(page) as browser:
            await browser.recv()
            await browser.send(message)
            with pytest.raises(websockets.exceptions.ConnectionClosed) as told:
                await browser.recv()
            assert told.value.rcvd.code in {1008, 1009}
        async with socket(page) as browser:
            assert "scene" in json.loads(await browser.recv())
        assert runtime.root.life == "running"

    shown(main)


def test_a_flood_of_commands_is_cut_off():
    async def main(_, page):
        with pytest.raises(websockets.exceptions.ConnectionClosed):
            async with socket(page) as browser:
                await browser.recv()
                for _ in range(10_000):
                    await browser.send(json.dumps({"say": "command", "command": "reset", "ensemble": "robot"}))
                    if browser.state.name != "OPEN":
                        break
                while True:
                    await browser.recv()

    shown(main, control=True)


def test_a_reader_that_comes_later_gets_what_happened_before(tmp_path):
    async def main(_, page):
        async with socket(page) as browser:
            await browser.recv()
            await browser.send(json.dumps({"say": "drawn", "close": ["top", "top/walk"]}))
            told = json.loads(await browser.recv())
            assert {"mode", "life"} <= {event["kind"] for event in told["events"]}
            assert told["cursor"] == told["events"][-1]["number"]

    shown(main, mdm.load_system(a_robot(tmp_path)))


def test_what_the_page_cannot_show_is_told_and_the_robot_goes_on():
    async def main(runtime, page):
        page._live.frame = None  # which cannot be called
        async with socket(page) as browser:
            await browser.recv()
            await browser.send(json.dumps({"say": "drawn"}))
            with pytest.raises(websockets.exceptions.ConnectionClosed) as told:
                await browser.recv()
            assert "the page has failed" in told.value.rcvd.reason
        assert runtime.root.life == "running"

    shown(main)


def test_frames_come_by_what_one_costs_and_not_by_what_has_held_one_up():
    assert pause([0.0001]) == pytest.approx(0.05)  # 20 a second, at most
    assert pause([0.004] * 5) == pytest.approx(0.2)  # a fiftieth of the time
    assert pause([0.004] * 4 + [0.5]) == pytest.approx(0.2)
    assert pause([0.5]) == 1.0  # as often as it is looked at though nobody looks


@pytest.mark.parametrize("text", ["caf\udce9" * 100, "é" * 100, "目" * 200, "all is well"], ids=ascii)
def test_a_socket_is_closed_for_any_reason(text):
    found = _reason(text).encode()
    assert len(found) <= 123
    assert found.startswith(text.encode("ascii", "backslashreplace")[:90])
