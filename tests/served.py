"""A running robot with a page, and those who ask it: by HTTP with Python's own client, and by the socket."""

from __future__ import annotations

import asyncio
import http.client

from decided import ensemble
from patience import PATIENCE

from mdm import Runtime
from mdm.views.web import Page

TOKEN = "token-of-these-tests-0"


def shown(main, *actors, run=asyncio.run, **options):
    """Run a coroutine function with a runtime that has a page, and its page; return its result."""

    async def program():
        page = Page(0, token=TOKEN, announce=lambda _: None, **options)
        async with Runtime(log=False, page=page, watchdog=None, signals=False) as runtime:
            for actor in actors or (ensemble(),):
                await runtime.start(actor)
            return await main(runtime, page)

    return run(program())


def port_of(page):
    return int(page.address.split(":")[2].split("/")[0])


async def get(page, path, **headers):
    """Ask for a file; return the status, the headers and the body. A header that is None is left out."""

    def ask():
        port = port_of(page)
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE)
        given = {"Host": f"127.0.0.1:{port}", "Cookie": f"mdm-{port}={TOKEN}"} | headers
        connection.putrequest("GET", path, skip_host=True, skip_accept_encoding=True)
        for name, value in given.items():
            if value is not None:
                connection.putheader(name, value)
        connection.endheaders()
        answer = connection.getresponse()
        found = answer.status, dict(answer.headers), answer.read()
        connection.close()
        return found

    return await asyncio.to_thread(ask)


def socket(page, **changes):
    """Open the socket of a page, as its own browser does; keyword arguments change the origin or the cookie."""
    client = __import__("websockets.asyncio.client", fromlist=["connect"])
    port = port_of(page)
    headers = {"Cookie": changes.get("cookie", f"mdm-{port}={TOKEN}")}
    origin = changes.get("origin", f"http://127.0.0.1:{port}")
    return client.connect(
        f"ws://127.0.0.1:{port}/socket", origin=origin, additional_headers=headers, compression=None, max_size=None
    )
