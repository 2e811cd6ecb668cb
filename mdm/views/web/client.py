"""A client of a page's socket, as its own page in a browser is one: for terminals, and for the page of a team."""

from __future__ import annotations

import importlib
import os
from contextlib import asynccontextmanager
from http.cookies import SimpleCookie
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

import msgspec

from mdm.errors import Error

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

__all__ = ["Socket", "opened"]

_WAITS = 5.0


def _client(module: str) -> Any:
    try:
        return importlib.import_module(f"websockets.{module}")
    except ImportError:
        raise Error("a page's client needs websockets: pip install 'markov-decision-making[watch]'") from None


class Socket:
    """An open socket of a page.

    Args:
        connection: The connection.
    """

    def __init__(self, connection: Any) -> None:
        self._connection = connection

    async def say(self, message: dict[str, Any]) -> None:
        """Send a message.

        Raises:
            Error: If the page is closed.
        """
        try:
            await self._connection.send(msgspec.json.encode(message).decode())
        except _client("exceptions").ConnectionClosed:
            raise Error("the program has ended, or has closed its page") from None

    async def receive(self) -> str | bytes:
        """Return the next message.

        Raises:
            Error: If the page is closed.
        """
        try:
            received: str | bytes = await self._connection.recv()
        except _client("exceptions").ConnectionClosed:
            raise Error("the program has ended, or has closed its page") from None
        return received


@asynccontextmanager
async def opened(address: str) -> AsyncIterator[Socket]:
    """Open the socket of a page.

    Args:
        address: The page's, with its secret, or without where ``MDM_PAGE_TOKEN`` has it.

    Raises:
        Error: If it is no address, nothing answers there, or the page refuses it.
    """
    parts = urlsplit(address)
    token = parse_qs(parts.query).get("token", [""])[0] or os.environ.get("MDM_PAGE_TOKEN", "")
    if not parts.netloc or not token:
        raise Error("give the address that the program has printed, with its token")
    cookie: SimpleCookie = SimpleCookie({f"mdm-{parts.port or 80}": token})
    try:
        connection = await _client("asyncio.client").connect(
            f"ws://{parts.netloc}/socket",
            origin=f"http://{parts.netloc}",
            additional_headers={"Cookie": cookie.output(header="", sep=";").strip()},
            compression=None,
            max_size=None,
            open_timeout=_WAITS,
        )
    except _client("exceptions").InvalidHandshake:
        raise Error(f"{parts.netloc} refuses to be watched: its address, or token, is another one") from None
    except (OSError, TimeoutError):
        raise Error(f"nothing answers at {parts.netloc}: is the program running?") from None
    try:
        yield Socket(connection)
    finally:
        await connection.close()
