"""The doctor: the topics, services and actions of a file, held against ROS' running graph."""

from __future__ import annotations

import asyncio
import importlib
import os
from collections.abc import Sequence
from functools import partial
from importlib import metadata
from typing import TYPE_CHECKING, Any, cast

import msgspec

from mdm.config import load_system
from mdm.errors import Error
from mdm.ros2.link import Link
from mdm.ros2.messages import plain
from mdm.ros2.rclpy_wire import RclpyWire
from mdm.ros2.tables import Ros2Reader, Ros2Table
from mdm.ros2.wire import Peer, Quality, Role
from mdm.runtime import Runtime, run

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from mdm.ros2.wire import Wire

_WANTED: dict[str, Role] = {"subscribe": "publisher", "publish": "subscription", "call": "service", "action": "action"}
"""Who has the other end of that which a method of the wire makes."""
_DOES = {"publisher": "publishes", "subscription": "subscribes to", "service": "serves", "action": "serves"}


class Part(msgspec.Struct):
    """A topic, a service or an action that a file names, and who has its other end.

    Attributes:
        role: Who is wanted there.
        name: As the file has it; after a look over rclpy, that which ROS has.
        peers: Who is.
        heard: The newest message of a topic, shortened; None where none came.
        problems: Why it does not work, each with the way out.
    """

    role: Role
    name: str
    kind: str
    quality: Quality | None = None
    peers: Sequence[Peer] = ()
    heard: Any = None
    problems: Sequence[str] = ()

    def judge(self) -> Iterator[str]:
        """Yield its problems."""
        does = f"{_DOES[self.role]} {self.name}"
        if not self.peers:
            yield f"nobody {does} ({self.kind}): start the node that does, or correct the name, in the file or by remap"
        for peer in self.peers:
            if peer.kind != self.kind:
                yield f"{peer.node} {does} as {peer.kind}, and the file says {self.kind}: correct its type"
            if peer.quality is None or self.quality is None:
                continue
            hears = self.role == "publisher"
            offered, wanted = (peer.quality, self.quality) if hears else (self.quality, peer.quality)
            for option, weak in (("reliability", "best_effort"), ("durability", "volatile")):
                asked = getattr(wanted, option)
                if getattr(offered, option) == weak != asked:
                    way = f'qos = {{ {option} = "{weak if hears else asked}" }}'
                    yield f"{peer.node} {does}, but {weak} is offered and {asked} wanted: nothing comes, so say {way}"


class Noting:
    """A wire on which is noted which handles are made; messages are kept, and go nowhere else."""

    def __init__(self, wire: Wire) -> None:
        self.wire = wire
        self.parts: list[Part] = []

    def __getattr__(self, method: str) -> Any:
        made = getattr(self.wire, method)
        if method not in _WANTED:
            return made

        def note(name: str, kind: str, *rest: Any) -> Any:
            part = Part(_WANTED[method], name, kind, rest[-1] if rest else None)
            self.parts.append(part)
            return made(name, kind, *((partial(setattr, part, "heard"), *rest[1:]) if method == "subscribe" else rest))

        return note

    async def look(self, seconds: float) -> list[Part]:
        """Return all parts, judged when each is there and heard, or after so many seconds."""
        loop = asyncio.get_running_loop()
        async with Runtime(log=False) as runtime:
            await self.wire.open(runtime)
            try:
                end, missing = loop.time() + seconds, True
                while missing and loop.time() < end:
                    await asyncio.sleep(0.1)
                    for part in self.parts:
                        part.peers = self.wire.peers(part.role, part.name)
                    missing = any(not p.peers or (p.role == "publisher" and p.heard is None) for p in self.parts)
                for part in self.parts:
                    part.name = getattr(self.wire, "resolve", str)(part.name)
                    part.problems, part.heard = [*part.judge()], None if part.heard is None else plain(part.heard, 8)
            finally:
                await self.wire.close()
        return self.parts


class _Reader(Ros2Reader):
    """Reads a file onto a wire that notes, without reports and services."""

    def _open(self, table: Ros2Table) -> None:
        super()._open(msgspec.structs.replace(table, services=False, diagnostics=False, decisions=False))
        if self._link is not None:
            self._link = Link(cast("Wire", Noting(self._link.wire)), self._reading.predicates)


def examine(path: str | Path, *, agent: str | None = None, seconds: float = 5.0) -> list[Part]:
    """Return the parts of a file that are ROS', judged by the running graph; the file's functions are imported.

    Args:
        path: The file.
        agent: Of a team's file, which agent's.
        seconds: How long to look.

    Raises:
        ConfigError: With all problems of the file, also of types that are not there.
        Error: If it has no table ``ros2``.
    """
    extensions = load_system(path, agent=agent, tables={"ros2": _Reader}).extensions
    wires = [each.wire for each in extensions if isinstance(each, Link)]
    if not wires:
        raise Error(f"{path} has no table [ros2], which names a robot's part of ROS 2")
    return run(lambda: cast("Noting", wires[0]).look(seconds))


def surroundings() -> dict[str, str]:
    """Return rclpy's version, and the distribution, middleware, domain and discovery range of this environment.

    Raises:
        WireError: If rclpy cannot be imported.
    """
    RclpyWire("mdm")
    versions = (each.version for each in metadata.distributions() if each.name in {"rclpy", "ros-rclpy"})
    return {
        "rclpy": next(versions, "unknown"),
        "middleware": importlib.import_module("rclpy.utilities").get_rmw_implementation_identifier(),
        "distribution": os.environ.get("ROS_DISTRO", "unknown (ROS_DISTRO is not set)"),
        "domain": os.environ.get("ROS_DOMAIN_ID", "0"),
        "discovery": os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET"),
    }
