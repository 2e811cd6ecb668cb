"""A browser that looks at pages: the machine's own Chromium, by Playwright's async API in the loop of the test."""

from __future__ import annotations

import asyncio
import os
import shutil
from contextlib import asynccontextmanager
from contextvars import copy_context

import pytest
from patience import PATIENCE
from processor_time import uncharged

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
INSTALL = "apt-get install --no-install-recommends chromium fonts-dejavu-core"


def needed():
    """Skip the tests of a module where there is no browser."""
    pytest.importorskip("websockets")
    pytest.importorskip("playwright")
    pytest.importorskip("axe_playwright_python")
    if CHROMIUM is None:
        pytest.skip(f"tests of the page need a browser, and there is none: {INSTALL}", allow_module_level=True)


class Shared:
    """The browser of a file of tests: to start it takes longer than most of them.

    It has threads of its own, by which a loop in virtual time would wait for input: so it ends with its file.
    """

    def __init__(self):
        self.runner = self.driver = self.chromium = None

    async def started(self):
        """Return the browser, which is started at the first call."""
        from playwright.async_api import async_playwright

        if self.chromium is None:
            arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
            with uncharged():
                self.driver = await async_playwright().start()
                self.chromium = await self.driver.chromium.launch(executable_path=CHROMIUM, args=arguments)
        return self.chromium

    def run(self, main):
        """Run a coroutine in the loop that the browser belongs to."""
        if self.runner is None:
            self.runner = asyncio.Runner()
        return self.runner.run(main, context=copy_context())

    def close(self):
        """End the browser."""

        async def end():
            if self.chromium is not None:
                await self.chromium.close()
                await self.driver.stop()

        if self.runner is not None:
            with uncharged():
                self.runner.run(end())
                self.runner.close()
            self.runner = self.driver = self.chromium = None


SHARED = Shared()
run = SHARED.run


@asynccontextmanager
async def browser(**options):
    """Take a browser that knows of nobody; yield a function that opens an address, and what has gone wrong in pages.

    It is for coroutines that `run` runs.

    Args:
        options: Of contexts, such as ``color_scheme`` and ``viewport``.
    """
    wrong = []
    started = await SHARED.started()
    context = await started.new_context(**{"viewport": {"width": 1300, "height": 900}, **options})
    context.set_default_timeout(1000 * PATIENCE)

    async def look(address):
        page = await context.new_page()
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("requestfailed", lambda request: wrong.append(f"failed: {request.url}"))
        page.on("request", lambda request: _note_foreign(request.url, address, wrong))
        await page.goto(address)
        return page

    try:
        yield look, wrong
    finally:
        await context.close()


async def barriers(page):
    """Return what axe-core finds in a page that keeps people out: what it calls serious or critical, and where."""
    from axe_playwright_python.async_playwright import Axe

    found = (await Axe().run(page)).response["violations"]
    return [
        f"{each['id']}: {node['html'][:200]}"
        for each in found
        if each["impact"] in {"serious", "critical"}
        for node in each["nodes"]
    ]


def _note_foreign(url, address, wrong):
    """Take note of a request to anywhere else than to the server of the page."""
    here = "/".join(address.split("/")[:3])
    if not url.startswith((here, "data:", here.replace("http", "ws", 1))):
        wrong.append(f"foreign: {url}")
