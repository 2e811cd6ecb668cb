"""The page of a runtime: opened before its actors start, so that a start is seen, and closed behind their end."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from mdm.checks import is_whole
from mdm.errors import Error
from mdm.runtime import Extension, VirtualClock
from mdm.snapshots import LiveRun
from mdm.views.web.access import encryption
from mdm.views.web.listening import LOOPBACK
from mdm.views.web.server import PORT, PageServer

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.runtime import Runtime
    from mdm.team.transport.access import Access

__all__ = ["Page", "check_port", "page_of"]


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
        title: What the page is called.
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
        access: Access | None = None,
        control: bool = False,
        title: str = "",
        token: str | None = None,
        announce: Callable[[str], object] = _print,
    ) -> None:
        self._port = check_port(port)
        encryption(host, access)
        self._host, self._access = host, access
        self._control = control
        self._title = title
        self._token = token
        self._announce = announce
        self._live: LiveRun | None = None
        self._server: PageServer | None = None

    async def open(self, runtime: Runtime) -> None:
        """Show a runtime, which begins.

        Raises:
            Error: If the port is in use, the host none of this machine, or the runtime's time virtual.
        """
        if isinstance(runtime.clock, VirtualClock):
            raise Error("a page needs real time: a run in virtual time is recorded, and shown by mdm page FILE.mcap")
        live = LiveRun(runtime, title=self._title, control=self._control)
        server = PageServer(
            live,
            port=self._port,
            host=self._host,
            access=self._access,
            live=True,
            control=self._control,
            token=self._token,
        )
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
