"""The page of a run and its server: its files, and the socket on which frames go out and allowed messages come in.

The page of a runtime is opened before its actors start, so that a start is seen, and closed behind their end.
"""

from __future__ import annotations

import asyncio
import importlib
import logging
import os
import sys
import time as times
from collections import deque
from contextlib import suppress
from functools import partial
from http import HTTPStatus
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from mdm.checks import is_whole
from mdm.errors import Error
from mdm.runtime import Extension, VirtualClock
from mdm.snapshots import LiveRun
from mdm.views.web.access import HEADERS, METRICS, Access, encryption
from mdm.views.web.listening import LOOPBACK, counted, listen
from mdm.views.web.metrics import Metrics
from mdm.views.web.session import Aside, Reader

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from mdm.runtime import Runtime
    from mdm.snapshots import RecordedRun
    from mdm.team.transport.access import Access as Certificate
    from mdm.views.web.session import Said
    from mdm.views.web.team import RecordedTeam, TeamRun

PORT = 8765
"""The port where none is given."""

_RATE = 20.0
"""Frames a second, at most."""
_SHARE = 0.02
"""The share of the event loop's time that frames may take: those of large systems come less often."""
_COSTS = 5
"""Frames of which the cheapest is taken as the cost: another program may have held up any of them."""
_HEARTBEAT = 1.0
"""Seconds after which a running system is looked at though nobody else looks, so that its past has no gap."""
_LARGEST = 16_384
_READERS = 32
_ASIDE = 8
"""Commands and explanations under way for one who looks, before further messages wait."""
_GREETING = 5.0
"""Seconds that one who comes has for each of the two handshakes, of TLS and of the socket."""
_PARTING = 1.0
"""Seconds that one who is sent away has to answer: a flood is not read to its end."""
_STATIC = Path(__file__).parent / "static"
_KINDS = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
    METRICS: "text/plain; version=0.0.4; charset=utf-8",
}


class PageServer:
    """Serves the page of a running system, or of a record, at the loopback address, or with TLS at another one.

    Args:
        source: The run.
        port: Where it listens; 0 for any that is free.
        host: A name or an address of this machine; ``0.0.0.0`` for all of its addresses.
        access: The certificate that it shows, by TLS: without one it listens at a loopback address alone.
        live: Whether the source is a running system.
        control: Whether commands are taken.
        token: The secret of its address; by default that of the environment's ``MDM_PAGE_TOKEN``, else a random one.
        renew: Reads the source again, in a thread, for each page that is loaded: a record may have grown since.
        metrics: Those of the running system; None for a record, and for a team, each of whose agents has its own.

    Raises:
        Error: If ``websockets`` is not installed, a host that is not loopback has no certificate, or one that browsers
            would not trust.
    """

    def __init__(
        self,
        source: LiveRun | TeamRun | RecordedRun | RecordedTeam,
        *,
        port: int = PORT,
        host: str = LOOPBACK[0],
        access: Certificate | None = None,
        live: bool,
        control: bool = False,
        token: str | None = None,
        renew: Callable[[], RecordedRun | RecordedTeam] | None = None,
        metrics: Metrics | None = None,
    ) -> None:
        self._source: Any = source
        self._metrics = metrics
        self._renew = renew
        self._port = port
        self._encryption = encryption(host, access)
        self._live = live
        self._control = control
        self._token = token or os.environ.get("MDM_PAGE_TOKEN") or None
        self._access: Access | None = None
        self._server: Any = None
        self._files = {
            f"/{path.relative_to(_STATIC).as_posix()}": path for path in _STATIC.rglob("*") if path.suffix in _KINDS
        }
        self._readers: set[Reader] = set()
        self._next: asyncio.Future[tuple[int, bytes]] | None = None
        self._due = 0.0
        self._made = 0.0
        self._costs: deque[float] = deque(maxlen=_COSTS)
        self._beat: asyncio.TimerHandle | None = None
        self._websockets = websockets()

    async def open(self) -> None:
        """Listen.

        Raises:
            Error: If the port is in use, or the host none of this machine.
        """
        logger = logging.getLogger("mdm.page")
        logger.disabled = True  # what strangers send is no news
        host, context, names = self._encryption
        listening = await listen(host, self._port)
        try:
            self._access = Access(listening.getsockname()[1], self._token, names=names)
            self._server = await self._websockets.serve(
                self._serve,
                sock=listening,
                ssl=context,
                create_connection=counted(self._websockets.Connection),
                process_request=self._answer,
                compression=None,
                max_size=_LARGEST,
                max_queue=4,
                open_timeout=_GREETING,
                close_timeout=_PARTING,
                server_header=None,
                logger=logger,
            )
        except BaseException:
            listening.close()
            raise
        if self._live:
            self._watch()

    def show(self, source: RecordedRun | RecordedTeam) -> None:
        """Show a later reading of the same record, also to those who look at it already."""
        self._source = source
        for reader in self._readers:
            reader.source = source

    async def close(self) -> None:
        """Listen no more, and part with everybody."""
        if self._beat is not None:
            self._beat.cancel()
        if self._next is not None and not self._next.done():
            self._next.cancel()
        if self._server is not None:
            self._server.close()
            with suppress(TimeoutError):
                await asyncio.wait_for(self._server.wait_closed(), 1.0)

    @property
    def address(self) -> str:
        """The address by which the page opens, with its secret."""
        if self._access is None:
            raise Error("a page that is not open has no address")
        return self._access.address

    # -- Requests ------------------------------------------------------------------------------------------------

    def _answer(self, connection: Any, request: Any) -> Any:
        """Return the answer to a request; None where it opens a socket, and may."""
        assert self._access is not None
        path = urlsplit(request.path).path
        given = {name: request.headers.get_all(name) for name in ("Host", "Origin", "Cookie", "Authorization")}
        headers = {name: values[0] if len(values) == 1 else "" for name, values in given.items() if values}
        socket = path == "/socket"
        refusal = self._access.refusal(request.path, headers, socket=socket)
        if refusal is not None:
            refused = self._response(connection, refusal.status, refusal.text.encode(), ".txt")
            if refusal.status == HTTPStatus.UNAUTHORIZED:
                refused.headers["WWW-Authenticate"] = 'Bearer realm="mdm"'
            return refused
        if path == METRICS:
            return self._measured(connection)
        if socket:
            if len(self._readers) >= _READERS:
                return self._response(connection, 503, b"Too many look at this page.\n", ".txt")
            return None
        if path == "/" and self._access.brings_token(request.path):
            response = self._response(connection, 303, b"", ".txt")
            response.headers["Location"] = "/"
            response.headers["Set-Cookie"] = self._access.set_cookie
            return response
        file = self._files.get("/index.html" if path == "/" else path)
        if file is None:
            return self._response(connection, 404, b"There is no such file.\n", ".txt")
        return self._response(connection, 200, file.read_bytes(), file.suffix)

    async def _measured(self, connection: Any) -> Any:
        if self._metrics is None:
            told = "Metrics are of a running system: a record has none, and of a team the page of each agent.\n"
            return self._response(connection, 404, told.encode(), ".txt")
        try:
            return self._response(connection, 200, await self._metrics.text(), METRICS)
        except Exception as error:  # the robot goes on without its page
            told = f"The page has failed: {type(error).__name__}: {error}\n"
            return self._response(connection, 500, told.encode(errors="replace"), ".txt")

    @staticmethod
    def _response(connection: Any, status: int, body: bytes, suffix: str) -> Any:
        response = connection.respond(HTTPStatus(status), "")
        response.body = body
        del response.headers["Content-Length"]
        del response.headers["Content-Type"]
        for name, value in {"Content-Length": str(len(body)), "Content-Type": _KINDS[suffix], **HEADERS}.items():
            response.headers[name] = value
        return response

    # -- The socket ----------------------------------------------------------------------------------------------

    async def _serve(self, connection: Any) -> None:
        reader: Reader | None = None
        aside: set[asyncio.Task[None]] = set()
        try:
            if self._renew is not None:
                self._source = await asyncio.to_thread(self._renew)
            reader = Reader(self._source, self._newest if self._live else None, control=self._control and self._live)
            self._readers.add(reader)
            await connection.send(reader.greeting(), text=True)
            async for message in connection:
                said = reader.read(message)
                if not isinstance(said, Aside):
                    await self._say(connection, reader, said)
                    continue
                if len(aside) >= _ASIDE:
                    await asyncio.wait(aside, return_when=asyncio.FIRST_COMPLETED)
                task = asyncio.create_task(self._say(connection, reader, said))
                aside.add(task)
                task.add_done_callback(aside.discard)
        except Error as error:
            await connection.close(1008, _reason(str(error)))
        except self._websockets.ConnectionClosed:
            pass
        finally:
            for task in aside:
                task.cancel()
            if reader is not None:
                self._readers.discard(reader)

    async def _say(self, connection: Any, reader: Reader, said: Said) -> None:
        """Answer a message; a failure ends the talk, and the robot goes on."""
        try:
            for answer in await reader.answers(said):
                await connection.send(answer, text=True)
        except Error as error:
            await connection.close(1008, _reason(str(error)))
        except self._websockets.ConnectionClosed:
            pass
        except Exception as error:
            await connection.close(1011, _reason(f"the page has failed: {type(error).__name__}: {error}"))

    # -- Frames of a running system ------------------------------------------------------------------------------

    async def _newest(self) -> tuple[int, bytes]:
        """Return the next frame, which is made once for all who wait for it, behind the number of its scene."""
        if self._next is None:
            loop = asyncio.get_running_loop()
            self._next = loop.create_future()
            loop.call_at(max(self._due, loop.time()), self._make)
        return await asyncio.shield(self._next)

    def _make(self) -> None:
        future, self._next = self._next, None
        if future is None or future.done():
            return
        before = times.perf_counter()
        try:
            close = dict.fromkeys(path for reader in self._readers for path in reader.close)
            encoded = self._source.encoded(close)
        except Exception as error:  # the robot goes on without its page
            future.set_exception(Error(f"the page has failed: {type(error).__name__}: {error}"))
            return
        loop = asyncio.get_running_loop()
        self._costs.append(times.perf_counter() - before)
        self._made = loop.time()
        self._due = self._made + pause(self._costs)
        future.set_result((self._source.generation, encoded))

    def _watch(self) -> None:
        loop = asyncio.get_running_loop()
        if loop.time() - self._made >= _HEARTBEAT:
            with suppress(Exception):  # whoever looks sees the error
                self._source.frame(())
            self._made = loop.time()
        if isinstance(self._source, LiveRun):
            with suppress(Exception):
                self._source.glance()
        self._beat = loop.call_later(1 / _RATE, self._watch)


def check_port(port: Any) -> int:
    """Return a port that is given.

    Raises:
        Error: If it is none.
    """
    if not is_whole(port) or not 0 <= port < 65_536:
        raise Error(f"a page's port is a whole number up to 65535, not {port!r}")
    return int(port)


def _print(address: str) -> None:
    print(f"page: {address}", file=sys.stderr, flush=True)  # noqa: T201 - else nobody could open it


class Page(Extension):
    """A live page of a running system, for browsers of this machine, or with a certificate for those of others.

    Hand it to a `Runtime`, or a port alone where the defaults will do. It listens at the loopback address, or with TLS
    at another one, and is read alone, unless it takes commands. No decision waits for it longer than for one snapshot.

    Args:
        port: Where it listens; 0 for any port that is free.
        host: Where it listens: a name or an address of this machine; ``0.0.0.0`` for all of its addresses.
        access: The certificate that it shows to browsers, which names the host, its key, and the authority that they
            trust, as agents of a team have them.
        control: Take commands: start, stop, reset and release of ensembles, and predicates that no sensor tells.
        title: The title of the page.
        token: The secret in its address; by default that of the environment's ``MDM_PAGE_TOKEN``, by which an open page
            finds back after a restart, else a random one.
        announce: Called with the address; by default it is printed on standard error.

    Raises:
        Error: If ``websockets`` is not installed, which the extra ``page`` brings, the port is none, or a host that is
            not loopback has no certificate, or one that browsers would not trust.
    """

    name = "the page"

    def __init__(
        self,
        port: int = PORT,
        *,
        host: str = LOOPBACK[0],
        access: Certificate | None = None,
        control: bool = False,
        title: str = "",
        token: str | None = None,
        announce: Callable[[str], object] = _print,
    ) -> None:
        port = check_port(port)
        self._served = partial(PageServer, port=port, host=host, access=access, live=True, control=control, token=token)
        encryption(host, access)
        self._control = control
        self._title = title
        self._announce = announce
        self._live: LiveRun | None = None
        self._server: PageServer | None = None

    async def open(self, runtime: Runtime) -> None:
        """Show a runtime, which begins.

        Raises:
            Error: If the port is in use, the host none of this machine, or the runtime's time virtual.
        """
        if isinstance(runtime.clock, VirtualClock):
            raise Error("a page needs real time: record a run in virtual time, and show it by mdm page FILE.mcap")
        live = LiveRun(runtime, title=self._title, control=self._control)
        server = self._served(live, metrics=Metrics(runtime))
        await server.open()
        live.open()
        self._live, self._server = live, server
        self._announce(server.address)

    async def close(self) -> None:
        """Show nothing more."""
        if self._server is not None:
            await self._server.close()
        if self._live is not None:
            self._live.close()
        self._live = self._server = None

    @property
    def address(self) -> str:
        """The address by which it opens, with its secret.

        Raises:
            Error: If it is not open.
        """
        if self._server is None:
            raise Error("a page that is not open has no address")
        return self._server.address


def page_of(given: Any) -> Any:
    """Return the page that is given as itself, or by its port."""
    return given if hasattr(given, "open") and hasattr(given, "close") else Page(given)


def pause(costs: Collection[float]) -> float:
    """Return for how many seconds no frame is made, by the costs of the last ones."""
    return min(max(1 / _RATE, min(costs) / _SHARE), _HEARTBEAT)


def _reason(text: str) -> str:
    """Return why a socket is closed, as the protocol takes it: 123 bytes at most."""
    return text.encode("ascii", "backslashreplace")[:100].decode()


def websockets() -> Any:
    """Return the parts of websockets that serve.

    Raises:
        Error: If it is not installed.
    """
    try:
        serving = importlib.import_module("websockets.asyncio.server")
        errors = importlib.import_module("websockets.exceptions")
    except ImportError:
        raise Error("a page needs websockets: pip install websockets") from None
    return SimpleNamespace(
        serve=serving.serve, Connection=serving.ServerConnection, ConnectionClosed=errors.ConnectionClosed
    )
