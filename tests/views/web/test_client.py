"""A client of a page's socket, with a page that answers, refuses, or is not there."""

from __future__ import annotations

import json

import pytest
from sentences import refused
from served import TOKEN, shown

from mdm import Error
from mdm.views.web.client import opened

pytest.importorskip("websockets")


def test_it_says_and_receives_what_a_browser_does(monkeypatch):
    monkeypatch.setenv("MDM_PAGE_TOKEN", TOKEN)

    async def main(_, page):
        for address in (page.address, page.address.split("?")[0]):  # the secret may be in the environment
            async with opened(address) as socket:
                assert "scene" in json.loads(await socket.receive())
                await socket.say({"say": "drawn"})
                assert "frame" in json.loads(await socket.receive())

    shown(main)


def test_what_cannot_be_opened_is_told_in_a_sentence(monkeypatch):
    monkeypatch.delenv("MDM_PAGE_TOKEN", raising=False)

    async def main(_, page):
        here = page.address.split("?")[0]
        for address, words in (
            (f"{here}?token=another-one-of-some-length", "refuses to be watched"),
            ("http://127.0.0.1:1/?token=x", "nothing answers at 127.0.0.1:1"),
        ):
            with pytest.raises(Error, match=words):
                async with opened(address):
                    raise AssertionError("it has opened")
        with refused(Error):
            async with opened("127.0.0.1"):
                raise AssertionError("it has opened")

    shown(main)


def test_a_page_that_closes_is_told():
    async def main(_, page):
        async with opened(page.address) as socket:
            await socket.receive()
            await page.close()
            with refused(Error):
                await socket.receive()

    shown(main)
