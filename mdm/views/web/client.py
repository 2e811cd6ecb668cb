"""A client of a page's socket, as its own page in a browser is one: for terminals, and for the page of a team."""

from __future__ import annotations

import importlib
import os
import ssl
from contextlib import asynccontextmanager
from http.cookies import SimpleCookie
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

import msgspec

from mdm.errors import Error
from mdm.views.web.access import trusting

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

_NO_ADDRESS = "give the address that the program has printed, with its token"
_UNKNOWN_ISSUER = {18, 19, 20}  # of OpenSSL: signed by itself, at the end or on the way, or by nobody who is known
_WAITS = 5.0


def _client(module: str) -> Any:
    try:
        return importlib.import_module(f"websockets.{module}")
    except ImportError:
        raise Error("a page's client needs websockets: pip install rich websockets") from None


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

    def abort(self) -> None:
        """Hang up at once, on a page that does not answer."""
        self._connection.transport.abort()


@asynccontextmanager
async def opened(address: str, *, authority: str | None = None) -> AsyncIterator[Socket]:
    """Open the socket of a page.

    Args:
        address: The page's, with its secret, or without where ``MDM_PAGE_TOKEN`` has it.
        authority: Of a page with TLS, the file of the authority that has signed its certificate; by default it is one
            that this machine trusts.

    Raises:
        Error: If it is no address, nothing answers there, its certificate is not trusted, or the page refuses it.
    """
    here, origin, cookie = _parts(address)
    encrypted = origin.startswith("https:")
    try:
        connection = await _client("asyncio.client").connect(
            f"{'wss' if encrypted else 'ws'}://{here}/socket",
            ssl=trusting(authority) if encrypted else None,
            origin=origin,
            additional_headers={"Cookie": cookie},
            compression=None,
            max_size=None,
            open_timeout=_WAITS,
        )
    except _client("exceptions").InvalidHandshake:
        raise Error(f"{here} refuses to be watched: its address, or token, is another one") from None
    except ssl.SSLCertVerificationError as error:
        way = ": name who has signed it, by --authority FILE" if error.verify_code in _UNKNOWN_ISSUER else ""
        raise Error(f"the certificate of {here} is not trusted ({error.verify_message}){way}") from None
    except (OSError, TimeoutError) as error:
        hangs_up = isinstance(error, ssl.SSLError | ConnectionError) and not isinstance(error, ConnectionRefusedError)
        if encrypted and hangs_up:
            raise Error(f"{here} does not speak TLS: does its address begin with http://?") from None
        raise Error(f"nothing answers at {here}: is the program running?") from None
    try:
        yield Socket(connection)
    finally:
        await connection.close()


def _parts(address: str) -> tuple[str, str, str]:
    """Return the host and port of an address, its origin, and the cookie with its secret.

    Raises:
        Error: If it is no address, or has no secret.
    """
    try:
        parts = urlsplit(address)
        port = parts.port or {"http": 80, "https": 443}[parts.scheme]
    except (KeyError, ValueError):
        raise Error(_NO_ADDRESS) from None
    token = parse_qs(parts.query).get("token", [""])[0] or os.environ.get("MDM_PAGE_TOKEN", "")
    if not parts.hostname or not token:
        raise Error(_NO_ADDRESS)
    cookie: SimpleCookie = SimpleCookie({f"mdm-{port}": token})
    return parts.netloc, f"{parts.scheme}://{parts.netloc}", cookie.output(header="", sep=";").strip()
