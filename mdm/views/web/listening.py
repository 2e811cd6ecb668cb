"""Where a page listens, and for how many: so many connections at once, and so many a second; others are closed.

A page for other machines is reached by strangers, before they have told any secret: their connections, and handshakes,
are to cost a robot neither its files nor its time.
"""

from __future__ import annotations

import asyncio
import errno
import ipaddress
import os
import socket
from contextlib import suppress
from pathlib import Path
from typing import Any

from mdm.errors import Error
from mdm.views.web.session import Allowance

LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""The names by which a machine calls itself, and nobody else."""

_MOST = 128
"""Connections at once: 32 who look, and each of them at several files."""
_RATE = 50.0
_BURST = 250.0
"""Connections a second, and some more at once: a browser asks for some twenty files, by a connection each."""
_LISTENS = "0A"
_PROC = Path("/proc")


class Crowd:
    """Counts connections, so that no more are taken than a robot can afford."""

    def __init__(self) -> None:
        self._inside = 0
        self._allowance = Allowance(_RATE, _BURST)

    def enter(self) -> bool:
        """Whether one more connection may come; it counts from now on until it leaves."""
        if self._inside >= _MOST or not self._allowance.take():
            return False
        self._inside += 1
        return True

    def leave(self) -> None:
        """Count a connection no more."""
        self._inside -= 1


class Listening(socket.socket):
    """A socket that listens, and takes no more than a robot can afford, where the event loop has it accept."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._taken: list[socket.socket] = []
        self._crowd = Crowd()

    def accept(self) -> tuple[socket.socket, Any]:
        """Take a connection.

        Raises:
            ConnectionAbortedError: If it was one too many, and is closed: the event loop takes that for a caller who
                has hung up.
        """
        connection, address = super().accept()
        for each in [each for each in self._taken if each.fileno() < 0]:
            self._taken.remove(each)
            self._crowd.leave()
        if not self._crowd.enter():
            connection.close()
            raise ConnectionAbortedError(errno.ECONNABORTED, "too many connections")
        self._taken.append(connection)
        return connection, address


class Counted(asyncio.Protocol):
    """A connection that is counted from its beginning, of an event loop that accepts without a socket of Python's.

    Such a loop reports a connection behind its handshake of TLS, where there is one: until then it counts nowhere.

    Attributes:
        crowd: Counts connections.
    """

    crowd: Crowd
    _counts = False

    def connection_made(self, transport: Any) -> None:
        """Take a connection in, or close it."""
        self._counts = self.crowd.enter()
        if self._counts:
            super().connection_made(transport)
        else:
            transport.abort()

    def connection_lost(self, error: Exception | None) -> None:
        """Count it no more."""
        if self._counts:
            self._counts = False
            self.crowd.leave()
            super().connection_lost(error)


def counted(base: type[Any]) -> type[Any]:
    """Return the class of connections of a page by that of websockets: counted, where the running loop takes it to."""
    if isinstance(asyncio.get_running_loop(), asyncio.BaseEventLoop):  # which has `Listening` accept
        return base
    return type("Connection", (Counted, base), {"crowd": Crowd()})


async def listen(host: str, port: int) -> Listening:
    """Listen at a host; of a name with several addresses, at the first one, of IPv4 where there is one.

    Args:
        host: A name or an address.
        port: The port; 0 for any that is free.

    Raises:
        Error: If this machine cannot listen there, or could be reached by nobody else by that name.
    """
    try:
        found = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, ValueError):
        raise Error(f"the page cannot be opened: no host {host!r} is known here (0.0.0.0 is all addresses)") from None
    family, _, _, _, place = min(found, key=lambda each: each[0] != socket.AF_INET)
    address = str(place[0])
    if is_loopback(address) and not is_loopback(host):
        raise Error(
            f"the page cannot be opened: {host} is {address} here, where no other machine reaches it (0.0.0.0 is all "
            "addresses)"
        )
    listening = Listening(family, socket.SOCK_STREAM)
    try:
        if os.name == "posix":  # elsewhere it would share the port
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.setblocking(False)
        listening.bind(place)
        listening.listen()
    except OSError as error:
        listening.close()
        raise Error(f"the page cannot be opened: {_reason(error, host, address, port)}") from None
    return listening


def is_loopback(host: str) -> bool:
    """Whether a name or an address stands for the machine itself, on all machines."""
    if host in LOOPBACK:
        return True
    with suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return False


def _reason(error: OSError, host: str, address: str, port: int) -> str:
    if error.errno == errno.EADDRINUSE:
        return in_use(port, address)
    if error.errno == errno.EADDRNOTAVAIL:
        return f"this machine does not have the address {address}{'' if host == address else f', which {host} is'}"
    return f"nobody may listen at {host}, port {port}: {error.strerror}"


def in_use(port: int, address: str = "127.0.0.1") -> str:
    """Return that a port of an address is in use, by whom where that can be known, and which one is free."""
    found = holder(port)
    free = next_free(port, address)
    other = "" if free is None else f"; port {free} is free"
    return f"port {port} is in use{'' if found is None else f' by {found}'}{other}"


def next_free(port: int, address: str = "127.0.0.1", most: int = 100) -> int | None:
    """Return the next port of an address at which nothing listens; None where there is none among so many."""
    for other in range(port + 1, min(port + 1 + most, 65_536)):
        with socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET) as tried:
            tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            with suppress(OSError):
                tried.bind((address, other))
                return other
    return None


def holder(port: int) -> str | None:
    """Return the process that listens at a port, as ``python (process 1234)``; None where that cannot be known."""
    inodes = {inode for table in ("tcp", "tcp6") for inode in _listening(_PROC / "net" / table, port)}
    if not inodes:
        return None
    wanted = {f"socket:[{inode}]" for inode in inodes}
    for process in _PROC.glob("[0-9]*"):
        with suppress(OSError):  # of other users, or ended meanwhile
            for descriptor in (process / "fd").iterdir():
                with suppress(OSError):
                    if str(descriptor.readlink()) in wanted:
                        name = (process / "comm").read_text(encoding="utf-8", errors="replace").strip()
                        return f"{name} (process {process.name})"
    return "another user's process"


def _listening(table: Path, port: int) -> set[str]:
    """Return the inodes of the sockets that listen at a port."""
    found = set()
    with suppress(OSError):
        for line in table.read_text(encoding="ascii", errors="replace").splitlines()[1:]:
            fields = line.split()
            if fields[3] == _LISTENS and int(fields[1].rpartition(":")[2], 16) == port:
                found.add(fields[9])
    return found
