"""A browser that looks: its messages, how often they may come, and which frames it gets.

A browser says that it has drawn a frame before it gets another: one is in flight, and the newest one is sent. A browser
that sleeps says nothing and gets nothing, and events wait for it in their ring.
"""

from __future__ import annotations

import asyncio
import time as times
from typing import TYPE_CHECKING, Annotated, Any

import msgspec

from mdm.errors import Error
from mdm.snapshots.reducer import PARTS

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

_MOST_EVENTS = 3_000
"""Events that a message has at most."""
_CLOSE = 16

Path = Annotated[str, msgspec.Meta(max_length=1_000)]
Paths = Annotated[tuple[Path, ...], msgspec.Meta(max_length=_CLOSE)]
Time = Annotated[int, msgspec.Meta(ge=0, lt=1 << 62)]
Cursor = Annotated[int, msgspec.Meta(ge=0, le=1 << 53)]


class _Said(msgspec.Struct, frozen=True, tag_field="say", tag=str.lower, forbid_unknown_fields=True):
    pass


class _Shown(_Said, frozen=True, kw_only=True):
    cursor: Cursor = 0
    close: Paths = ()


class Drawn(_Shown, frozen=True):
    """A frame was drawn: send the next one, of ensembles at close range, with the events behind a cursor."""


class At(_Shown, frozen=True):
    """Send a record's frame of a second."""

    time: float


class Step(_Shown, frozen=True):
    """Send a record's frame of the next decision, fault or mode behind a second, or of the one before it."""

    kind: str
    time: float
    back: bool = False


class Why(_Said, frozen=True):
    """Tell why an ensemble has decided as it did, last or at a second of a record."""

    ensemble: Path
    time: float | None = None


class Draw(_Said, frozen=True):
    """Draw an ensemble's policy as it decided last or at a second of a record, with some folded nodes opened."""

    ensemble: Path
    time: float | None = None
    opened: Annotated[tuple[Annotated[int, msgspec.Meta(ge=0, le=1 << 53)], ...], msgspec.Meta(max_length=100)] = ()


class Course(_Said, frozen=True):
    """Tell how an ensemble's decisions went from a second of a record to another one."""

    ensemble: Path
    first: float
    last: float


class Lanes(_Said, frozen=True):
    """Send the lanes of a record from a second to another one, in so many parts at most."""

    first: float
    last: float
    paths: Paths
    predicates: Paths
    most: Annotated[int, msgspec.Meta(ge=1, le=10_000)]


class Command(_Said, frozen=True):
    """Command an ensemble; not after a time, in nanoseconds since 1970, by which whoever asks waits no longer."""

    command: Path
    ensemble: Path
    before: Time | None = None


class Sense(_Said, frozen=True):
    """Set a predicate; not after a time, in nanoseconds since 1970, by which whoever asks waits no longer."""

    predicate: Path
    value: bool | None
    before: Time | None = None


Aside = Why | Draw | Course | Command | Sense
"""Messages whose answers may take their time, beside the frames."""

Said = Drawn | At | Step | Why | Draw | Course | Lanes | Command | Sense

_decode = msgspec.json.Decoder(Said).decode
_encode = msgspec.json.Encoder().encode


class Allowance:
    """How many messages may come: so many a second, and some more at once.

    Args:
        rate: A second.
        burst: At once.
        clock: Tells seconds.
    """

    def __init__(self, rate: float, burst: float, clock: Callable[[], float] = times.monotonic) -> None:
        self._rate, self._burst, self._clock = rate, burst, clock
        self._left, self._since = burst, clock()

    def take(self) -> bool:
        """Whether another message may come."""
        now = self._clock()
        self._left = min(self._burst, self._left + (now - self._since) * self._rate)
        self._since = now
        if self._left < 1:
            return False
        self._left -= 1
        return True


class Reader:
    """One browser, or terminal.

    Args:
        source: The run that it looks at.
        newest: Of a running system, returns the number of the newest frame's scene, and the frame, encoded, when one is
            due; None for a record.
        control: Whether it may command.

    Attributes:
        source: The run, in place of which a later reading of the same record may come.
        close: The ensembles that it looks at closely.
    """

    def __init__(
        self, source: Any, newest: Callable[[], Awaitable[tuple[int, bytes]]] | None, *, control: bool
    ) -> None:
        self.source = source
        self._newest = newest
        self._control = control
        self._generation = -1
        self._messages = Allowance(120, 240)
        self._commands = Allowance(5, 10)
        self._explaining = asyncio.Lock()
        self._looking_back = asyncio.Lock()
        self.close: tuple[str, ...] = ()

    def greeting(self) -> bytes:
        """Return the scene, encoded."""
        scene = self.source.scene()
        self._generation = getattr(self.source, "generation", 0)
        return b'{"scene":' + _encode(scene) + b"}"

    def read(self, text: str | bytes) -> Said:
        """Return a message.

        Raises:
            Error: If it is none, or too many came.
        """
        if not self._messages.take():
            raise Error("too many messages")
        try:
            said: Said = _decode(text)
        except msgspec.MsgspecError as error:
            raise Error(f"a message is none: {error}") from None
        if isinstance(said, Command | Sense) and not self._commands.take():
            raise Error("too many commands")
        return said

    async def answers(self, said: Said) -> list[bytes]:
        """Return the answers to a message.

        Raises:
            Error: If it asks for something that does not exist, or the frame cannot be made.
        """
        if isinstance(said, Command | Sense):
            return [_encode(await self._commanded(said))]
        if isinstance(said, Why):
            async with self._explaining:  # in the order in which they were asked for
                why = await self.source.explain(said.ensemble, said.time)
            return [_encode({"why": why, "ensemble": said.ensemble})]
        if isinstance(said, Draw):
            async with self._explaining:
                drawn = await self.source.draw(said.ensemble, said.time, said.opened)
            return [_encode({"pictures": drawn, "ensemble": said.ensemble})]
        if isinstance(said, Course):
            if self._newest is not None:
                raise Error("a running system has no past")
            async with self._looking_back:  # which reads the record, so that there is one at a time
                course = await self.source.course(said.ensemble, said.first, said.last)
            told = {"course": course, "ensemble": said.ensemble, "first": said.first, "last": said.last}
            return [_encode(told)]
        if self._newest is not None:
            if not isinstance(said, Drawn):
                raise Error("a running system has no past")
            self.close = said.close
            return await self._live(said, self._newest)
        if isinstance(said, Drawn):
            return []
        if isinstance(said, Lanes):
            events = self.source.lanes(said.first, said.last, said.paths, said.predicates, min(said.most, PARTS))
            return [_encode({"lanes": events, "asked": said})]
        return self._of_record(said)

    def _of_record(self, said: At | Step) -> list[bytes]:
        self.close = said.close
        seconds = self.source.step(said.kind, said.time, back=said.back) if isinstance(said, Step) else said.time
        more = self._generation != getattr(self.source, "generation", 0)  # is known by now
        answers = [self.greeting()] if more else []
        frame = _encode(self.source.frame(seconds, said.close))
        return [*answers, _message(frame, *self.source.after(said.cursor, _MOST_EVENTS, rare=True))]

    async def _live(self, said: Drawn, newest: Callable[[], Awaitable[tuple[int, bytes]]]) -> list[bytes]:
        generation, frame = await newest()
        while generation != self.source.generation:  # by now there is another scene, of which the frame is none
            generation, frame = await newest()
        answers = []
        if self._generation != self.source.generation:
            answers.append(self.greeting())
        events, cursor = self.source.ring.after(said.cursor, _MOST_EVENTS)
        kept = b"" if said.cursor else b',"kept":' + _encode(self.source.ring.kept)  # of all that comes now
        return [*answers, _message(frame, events, cursor, kept)]

    async def _commanded(self, said: Command | Sense) -> dict[str, str]:
        if not self._control:
            return {"refused": "this page takes no commands: its program was started without --page-control"}
        if said.before is not None and times.time_ns() > said.before:
            return {"refused": "this command has come too late"}
        try:
            if isinstance(said, Command):
                going = self.source.command(said.command, said.ensemble)
            else:
                going = self.source.sense(said.predicate, said.value)
            if going is not None:
                await going
        except Error as error:
            return {"refused": str(error)}
        if isinstance(said, Command):
            return {"done": f"{said.command} {said.ensemble}"}
        return {"done": f"{said.predicate} is {'unknown' if said.value is None else str(said.value).lower()}"}


def _message(frame: bytes, events: list[bytes], cursor: int, more: bytes = b"") -> bytes:
    """Return a message of parts that are encoded already."""
    end = b'],"cursor":%d%b}' % (cursor, more)
    return b"".join((b'{"frame":', frame, b',"events":[', b",".join(events), end))
