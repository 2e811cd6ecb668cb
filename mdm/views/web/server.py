"""The server of a page: its files, and the socket on which frames go out and nothing else comes in than is allowed."""

from __future__ import annotations

import asyncio
import importlib
import logging
import os
import time as times
from collections import deque
from contextlib import suppress
from http import HTTPStatus
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from mdm.errors import Error
from mdm.views.web.access import HEADERS, Access, encryption
from mdm.views.web.listening import LOOPBACK, counted, listen
from mdm.views.web.session import Aside, Reader

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from mdm.team.transport.access import Access as Certificate
    from mdm.views.web.session import LiveSource, RecordSource, Said

__all__ = ["PORT", "PageServer", "pause"]

PORT = 8765
"""The port where none is given."""

_RATE = 20.0
"""Frames a second, at most."""
_SHARE = 0.02
"""The share of the event loop's time that frames may take: those of large systems come less often."""
_COSTS = 5
"""Frames by the cheapest of which it is judged what one costs: another program may have held up any of them."""
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
}


class PageServer:
    """Serves the page of a running system, or of a record, at the loopback address, or with TLS at another one.

    Args:
        source: What is shown.
        port: Where it listens; 0 for any that is free.
        host: A name or an address of this machine; ``0.0.0.0`` for all of its addresses.
        access: The certificate that it shows, by TLS: without one it listens at a loopback address alone.
        live: Whether the source is a running system.
        control: Whether commands are taken.
        token: The secret of its address; by default that of the environment's ``MDM_PAGE_TOKEN``, else a random one.
        renew: Returns the source anew, in a thread, for each page that is loaded: a record may have grown since.

    Raises:
        Error: If ``websockets`` is not installed, a host that is not loopback has no certificate, or one that browsers
            would not trust.
    """

    def __init__(
        self,
        source: LiveSource | RecordSource,
        *,
        port: int = PORT,
        host: str = LOOPBACK[0],
        access: Certificate | None = None,
        live: bool,
        control: bool = False,
        token: str | None = None,
        renew: Callable[[], RecordSource] | None = None,
    ) -> None:
        self._source: Any = source
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
        given = {name: request.headers.get_all(name) for name in ("Host", "Origin", "Cookie")}
        headers = {name: values[0] if len(values) == 1 else "" for name, values in given.items() if values}
        socket = path == "/socket"
        refusal = self._access.refusal(request.path, headers, socket=socket)
        if refusal is not None:
            return self._response(connection, refusal.status, refusal.text.encode(), ".txt")
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
        """Answer a message; what cannot be answered ends the talk, and the robot goes on."""
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
            with suppress(Exception):  # which is told to whoever looks
                self._source.frame(())
            self._made = loop.time()
        self._beat = loop.call_later(_HEARTBEAT, self._watch)


def pause(costs: Collection[float]) -> float:
    """Return for how many seconds no frame is made, by what the last ones have cost."""
    return min(max(1 / _RATE, min(costs) / _SHARE), _HEARTBEAT)


def _reason(text: str) -> str:
    """Return why a socket is closed, as the protocol takes it: 123 bytes at most."""
    return text.encode("ascii", "backslashreplace")[:100].decode()


def websockets() -> Any:
    """Return what serves sockets.

    Raises:
        Error: If it is not installed.
    """
    try:
        serving = importlib.import_module("websockets.asyncio.server")
        errors = importlib.import_module("websockets.exceptions")
    except ImportError:
        raise Error("a page needs websockets: pip install 'markov-decision-making[page]'") from None
    return SimpleNamespace(
        serve=serving.serve, Connection=serving.ServerConnection, ConnectionClosed=errors.ConnectionClosed
    )
