"""The socket that listens for a page: at which address, and for how many."""

from __future__ import annotations

import asyncio
import socket
from contextlib import suppress
from http.client import HTTPException

import pytest
from sentences import refused
from served import TOKEN, get, port_of

import mdm
from mdm import Error
from mdm.views.web import Page
from mdm.views.web.listening import Crowd, listen
from mdm.views.web.session import Allowance

pytest.importorskip("websockets")


def test_a_host_of_another_machine_or_of_none_is_refused():
    async def main():
        for host in ("192.0.2.77", "robot.invalid", "robot\0"):
            with refused(Error):
                await listen(host, 0)

    asyncio.run(main())


def test_a_name_that_stands_for_the_loopback_address_here_is_refused(monkeypatch):
    """As that of a machine on Debian, of which others could not reach the page."""
    told = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.1.1", 0))]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: told)
    with refused(Error):
        asyncio.run(listen("robot.test", 0))


def test_a_name_of_several_addresses_is_that_of_the_first_of_ipv4(monkeypatch):
    six = (socket.AF_INET6, socket.SOCK_STREAM, 6, "", ("::1", 0, 0, 0))
    four = (socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", 0))
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: [six, four])
    with asyncio.run(listen("localhost", 0)) as listening:
        assert listening.getsockname()[0] == "127.0.0.1"


@pytest.mark.parametrize("loop", ["asyncio", "uvloop"])
def test_who_holds_connections_is_held_to_some_and_the_page_opens_again(loop):
    async def program():
        page = Page(0, token=TOKEN, announce=lambda _: None)
        async with mdm.Runtime(log=False, page=page, watchdog=None, signals=False):
            held = [await asyncio.open_connection("127.0.0.1", port_of(page)) for _ in range(140)]
            ended = [asyncio.create_task(reader.read()) for reader, _ in held]
            done = ()
            while len(done) < 12:
                done, _ = await asyncio.wait(ended, return_when=asyncio.FIRST_COMPLETED)
                await asyncio.sleep(0.1)
            assert sum(each.done() for each in ended) == 12  # those above 128 are closed, the others wait for a request
            for _, writer in held:
                writer.close()
            await asyncio.gather(*ended, return_exceptions=True)
            for _ in range(100):  # until the page has been told that they have gone
                with suppress(ConnectionError, HTTPException):
                    return (await get(page, "/"))[0]
            return None

    with asyncio.Runner(loop_factory=pytest.importorskip(loop).new_event_loop) as runner:
        assert runner.run(program()) == 200


def test_who_comes_too_often_is_sent_away(monkeypatch):
    now = [0.0]
    timed = lambda rate, burst: Allowance(rate, burst, lambda: now[0])
    monkeypatch.setattr("mdm.views.web.listening.Allowance", timed)
    crowd = Crowd()

    def comes():
        is_in = crowd.enter()
        if is_in:
            crowd.leave()
        return is_in

    assert all(comes() for _ in range(250))
    assert not comes()
    now[0] = 1.0
    assert sum(comes() for _ in range(60)) == 50
