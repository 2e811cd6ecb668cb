"""Who listens at a port that is in use, and which port is free: for the sentence that says so."""

from __future__ import annotations

import socket
from contextlib import suppress
from pathlib import Path

__all__ = ["holder", "in_use", "next_free"]

_LISTENS = "0A"
_PROC = Path("/proc")


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
