"""Remote channels: messages published at one agent are published at others, by key.

The key is ``mdm/<team>/<agent>/<ensemble>/<channel>``, the body the message as msgpack. An agent that comes late asks
for the last message. Lost messages are counted by the transport; the next one counts.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.errors import ConfigError, Error
from mdm.messages import Action, ActionLife, Belief, Mode, Observation, Reward, State
from mdm.runtime import Actor
from mdm.team.transport.bounds import UNREADABLE
from mdm.team.transport.keys import check_name, join

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from mdm.runtime import Channel, Subscription, Work
    from mdm.team.link import Link
    from mdm.team.transport.transport import Sample

CHANNELS: dict[str, type[Any]] = {
    "state": State,
    "observation": Observation,
    "belief": Belief,
    "action": Action,
    "reward": Reward,
    "mode": Mode,
    "lives": ActionLife,
}
"""The messages of an ensemble's own channels, by the channels' names."""

RETAINED = frozenset({"state", "belief", "reward", "mode"})
"""Channels whose last message an agent that comes late asks for."""


_NUMBERS = re.compile(r"[<>|=](b1|[iu][1248]|f[248]|c(8|16))")
"""The types of arrays that are taken: numpy reads many more names, of objects and of types that it will give up."""


class Wire:
    """Messages of a type as bytes: msgpack, with arrays by their type, shape and bytes.

    Args:
        type: A `msgspec.Struct`, or another type that msgspec can write and read.

    Raises:
        ConfigError: If it cannot.
    """

    def __init__(self, type: type[Any]) -> None:  # noqa: A002 - as channels call it
        self.type = type
        self.encode: Callable[[Any], bytes] = msgspec.msgpack.Encoder(enc_hook=_packed).encode
        try:
            decode: Callable[[bytes], Any] = msgspec.msgpack.Decoder(type, dec_hook=_unpacked).decode
        except (TypeError, NameError, NotImplementedError) as error:
            raise ConfigError(f"messages of type {type.__name__} cannot be sent to other agents: {error}") from None
        self._decode = decode

    def decode(self, body: bytes) -> Any:
        """Return the message of bytes.

        Raises:
            Error: If it is none of this type.
        """
        try:
            message = self._decode(body)
        except (*UNREADABLE, TypeError, ArithmeticError, LookupError) as error:
            raise Error(f"this is not a message of type {self.type.__name__}: {error}") from None
        if message.__class__ is not self.type:
            raise Error(f"this is not a message of type {self.type.__name__}")
        return message


def _packed(value: object) -> object:
    if isinstance(value, np.ndarray):
        return [value.dtype.str, list(value.shape), np.ascontiguousarray(value).tobytes()]
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(f"{type(value).__name__} cannot be sent")


def _unpacked(_: type, value: Any) -> Any:
    kind, shape, data = value
    if not isinstance(kind, str) or not _NUMBERS.fullmatch(kind):
        raise ValueError(f"an array of {kind!r} is not taken from others, only of numbers")
    return np.frombuffer(data, np.dtype(kind)).reshape(shape)


def typed(names: Iterable[str] | Mapping[str, type[Any]], key: str) -> dict[str, type[Any]]:
    """Return the type of each channel: as given, or of an ensemble's own channel by its name.

    Raises:
        ConfigError: If a name is none, or the type is not known.
    """
    if isinstance(names, str):
        raise ConfigError(f"{key} are a list of channels, or a mapping from channels to types, not {names!r}", key=key)
    given = dict(names.items()) if hasattr(names, "items") else dict.fromkeys(names)
    found: dict[str, type[Any]] = {}
    for name, kind in given.items():
        for chunk in str(name).split("/"):
            check_name(chunk, f"the channel {name!r}", key=key)
        known = CHANNELS.get(str(name).rsplit("/", 1)[-1])
        if kind is None and known is None:
            raise ConfigError(
                f"{name!r} is not an ensemble's own channel ({', '.join(CHANNELS)}): give its type, as a mapping",
                key=key,
            )
        found[str(name)] = known if kind is None else kind  # type: ignore[assignment]
    return found


class Exports(Actor):
    """Sends the messages on channels of this agent to the agents that import them.

    A member has one for its own ``exports``; of a member that a file makes, a task of that file starts it.

    Example::

        async def tell_poses(system):
            exports = mdm.team.Exports(system.member.link, {"robot1/pose": PoseUpdate})
            await system.runtime.start(exports)

    Args:
        link: The connection of this agent to the others.
        channels: The channels, such as ``patrol/belief``, and the types of their messages.
    """

    def __init__(self, link: Link, channels: Mapping[str, type[Any]], *, name: str = "exports") -> None:
        super().__init__(name)
        self._link = link
        self._wires = {channel: Wire(kind) for channel, kind in channels.items()}
        self._serves = False

    def on_start(self) -> None:
        """Listen to the channels, and answer who asks for their last messages."""
        above = self.parent.path if self.parent is not None else ""
        for name, wire in self._wires.items():
            retain = name.rsplit("/", 1)[-1] in RETAINED
            channel = self.runtime.channel(f"{above}/{name}" if above else name, wire.type, retain=retain)
            self.subscribe(channel, self._sender(name, wire))
            if not self._serves:
                self._link.transport.serve(self._link.key(*name.split("/")), self._answer(channel, wire))
        self._serves = True

    def _sender(self, name: str, wire: Wire) -> Callable[[Any], None]:
        key, put, encode = self._link.key(*name.split("/")), self._link.send, wire.encode
        refused: list[str] = []

        def send(message: Any) -> None:
            try:
                put(key, encode(message))
            except NotImplementedError as error:
                if not refused:
                    refused.append(str(error))
                    self.report("export", f"channel {name!r}: {error}")

        return send

    @staticmethod
    def _answer(channel: Channel[Any], wire: Wire) -> Callable[[bytes], bytes]:
        def answer(_: bytes) -> bytes:
            last = channel.last if channel.retain else None
            return b"" if not isinstance(last, wire.type) else wire.encode(last)

        return answer


class Imports(Actor):
    """Publishes here the exports of other agents, on ``<agent>/<ensemble>/<channel>`` below this agent's own path.

    A retained message is discarded when its owner is gone. A member has one for its own ``imports``; of a member that a
    file makes, a task of that file starts it.

    Example::

        async def hear_poses(system):
            imports = mdm.team.Imports(system.member.link, {"robot1/robot1/pose": PoseUpdate})
            await system.runtime.start(imports)
            imports.imported("robot1/robot1/pose").subscribe(print)

    Args:
        link: The connection of this agent to the others.
        channels: The channels, such as ``robot2/patrol/belief``, and the types of their messages.

    Raises:
        ConfigError: If one names no other agent.
    """

    def __init__(self, link: Link, channels: Mapping[str, type[Any]], *, name: str = "imports") -> None:
        super().__init__(name)
        self._link = link
        self._wires = {channel: Wire(kind) for channel, kind in channels.items()}
        for channel in channels:
            agent = channel.split("/")[0]
            link.team.check_agent(agent, key="imports")
            if agent == link.agent or channel.count("/") < 1:
                raise ConfigError(f"an import is another agent's channel, agent/ensemble/channel, not {channel!r}")
        self.malformed = 0
        self._lives: dict[str, int] = {}
        self._asking: dict[str, Work] = {}
        self._hears: list[Subscription[Any]] = []

    def on_start(self) -> None:
        """Listen to the others."""
        self._lives.clear()
        self._asking.clear()
        self._hears = [
            self._link.listen(join(self._link.team.name, *name.split("/")), self._receiver(name), self)
            for name in self._wires
        ]
        self._hears.append(self._link.watch(self._on_live, self))

    def on_stop(self) -> None:
        """Listen no more."""
        self._link.drop(self._hears)

    def imported(self, name: str) -> Channel[Any]:
        """Return the channel on which an import is published.

        Raises:
            Error: If nothing of that name is imported.
        """
        if name not in self._wires:
            raise Error(f"no channel {name!r} is imported; there are {', '.join(self._wires) or 'none'}")
        above = self.parent.path if self.parent is not None else ""
        full = f"{above}/{name}" if above else name
        return self.runtime.channel(full, self._wires[name].type, retain=name.rsplit("/", 1)[-1] in RETAINED)

    def _receiver(self, name: str) -> Callable[[Sample], None]:
        return lambda sample: self._receive(name, sample.body)

    def _receive(self, name: str, body: bytes) -> None:
        try:
            message = self._wires[name].decode(body)
        except Error as error:
            self.malformed += 1
            if self.malformed == 1:
                self.report("import", f"channel {name!r}: {error}")
            return
        self.imported(name).publish(message)

    def _on_live(self, link: Link) -> None:
        for agent in {name.split("/")[0] for name in self._wires}:
            life = link.live.get(agent)
            if life == self._lives.get(agent):
                continue
            for name in [name for name in self._wires if name.split("/")[0] == agent]:
                if name in self._asking:
                    self._asking.pop(name).cancel()
                if life is None:
                    self.imported(name).forget()
                else:
                    self._asking[name] = self.spawn(self._ask(name, agent), name=f"ask {name}")
            if life is None:
                del self._lives[agent]
            else:
                self._lives[agent] = life

    async def _ask(self, name: str, agent: str) -> None:
        """Ask for the last message, until there is an answer; a newer one may come before."""
        channel, key = self.imported(name), join(self._link.team.name, *name.split("/"))
        before = channel.published
        last = await self._link.ask_one(agent, key, b"", bytes)
        if last and channel.published == before:
            self._receive(name, last)
