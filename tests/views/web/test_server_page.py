"""The page of a runtime: how it opens and closes."""

from __future__ import annotations

import asyncio
import importlib
import re
import socket
import sys

import pytest
from sentences import refused
from served import get, port_of, shown

from mdm import Error, Runtime, WallClock
from mdm.testing import run_virtual
from mdm.views.web import Page

pytest.importorskip("websockets")


def test_a_port_alone_will_do(capsys):
    async def program():
        async with Runtime(log=False, page=0, watchdog=None, signals=False) as runtime:
            return runtime.page.address

    address = asyncio.run(program())
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\?token=[\w-]{30,}", address)
    assert capsys.readouterr().err == f"page: {address}\n"


def test_it_listens_at_the_loopback_alone_and_no_longer_than_its_runtime():
    async def main(_, page):
        (listening,) = page._server._server.sockets
        assert listening.getsockname()[0] == "127.0.0.1"
        assert (await get(page, "/"))[0] == 200
        return port_of(page)

    port = shown(main)
    with socket.socket() as tried, pytest.raises(OSError):
        tried.connect(("127.0.0.1", port))


def test_a_port_in_use_names_another_and_nothing_is_left_open():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]

        async def program():
            async with Runtime(log=False, page=port, clock=WallClock(), signals=False):
                raise AssertionError("it has opened")

        with pytest.raises(Error, match=rf"port {port} is in use by .*; port \d+ is free"):
            asyncio.run(program())


def test_virtual_time_has_no_page():
    async def main(_):
        raise AssertionError("it has opened")

    with refused(Error):
        run_virtual(main, page=Page(0))


@pytest.mark.parametrize("port", [-1, 65_536, "8765", 1.5, True])
def test_what_is_no_port_is_refused(port):
    with pytest.raises(Error, match="port is a whole number"):
        Runtime(page=port, log=False, clock=WallClock())


def test_without_its_extra_a_page_says_which(monkeypatch):
    real = importlib.import_module

    def missing(name, *rest):
        if name.startswith("websockets"):
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(importlib, "import_module", missing)

    async def program():
        async with Runtime(log=False, page=Page(0), clock=WallClock(), signals=False):
            raise AssertionError("it has opened")

    with refused(Error):
        asyncio.run(program())


def test_a_runtime_without_a_page_loads_none():
    code = (
        "import asyncio, sys, mdm\nasync def main():\n async with mdm.Runtime(log=False): pass\nasyncio.run(main())\n"
    )
    code += "print([name for name in sys.modules if name.startswith(('mdm.views', 'mdm.snapshots', 'websockets'))])"
    import subprocess

    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
