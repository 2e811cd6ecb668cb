"""A client of a page's socket, with a page that answers, refuses, or is not there."""

from __future__ import annotations

import asyncio
import json

import pytest
from sentences import refused
from served import TOKEN, shown

from mdm import Error
from mdm.team.transport.certificates import make_certificates
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


def test_a_page_with_tls_is_watched_by_who_trusts_its_authority(tmp_path):
    pytest.importorskip("cryptography")
    robot = make_certificates(tmp_path / "robot", {"robot": ["127.0.0.1"]})["robot"]
    other = make_certificates(tmp_path / "other", {"robot": ["127.0.0.1"]})["robot"]

    async def main(_, page):
        async with opened(page.address, authority=robot.authority) as socket:
            assert "scene" in json.loads(await socket.receive())
        port = page.address.split(":")[2].split("/")[0]
        for address, authority, words in (
            (page.address, other.authority, "is not trusted .*: name who has signed it, by --authority FILE"),
            (page.address, None, "is not trusted .*: name who has signed it"),
            (page.address.replace("127.0.0.1", "localhost"), robot.authority, "is not trusted .*localhost"),
            (page.address.replace("https", "http"), None, "refuses to be watched"),
            (f"https://127.0.0.1:{port}/?token=another-one-of-some-length", robot.authority, "refuses to be watched"),
        ):
            with pytest.raises(Error, match=words):
                async with opened(address, authority=authority):
                    raise AssertionError("it has opened")

    shown(main, host="127.0.0.1", access=robot)


def test_a_page_without_tls_is_not_one_with_it():
    async def main(_, page):
        with pytest.raises(Error, match="does not speak TLS: does its address begin with http"):
            async with opened(page.address.replace("http", "https")):
                raise AssertionError("it has opened")

    shown(main)


@pytest.mark.parametrize("address", ["", "ftp://127.0.0.1/?token=x", "http://[::1/?token=x", "http://a:b/?token=x"])
def test_what_is_no_address_is_told(address):
    async def main():
        async with opened(address):
            raise AssertionError("it has opened")

    with pytest.raises(Error, match="give the address that the program has printed"):
        asyncio.run(main())


def test_a_page_that_closes_is_told():
    async def main(_, page):
        async with opened(page.address) as socket:
            await socket.receive()
            await page.close()
            with refused(Error):
                await socket.receive()

    shown(main)
