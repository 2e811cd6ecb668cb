"""The copy: one agent's copy of a decision process that a team runs together.

It puts the agents' parts of a step together and has its ensemble's control layer decide on them, in the same call: the
same steps give the same decisions at every agent. It knows nothing of who agreed on the steps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import msgspec

from mdm.errors import ModelError
from mdm.messages import Control, Observation, State
from mdm.models.digest import of_bytes
from mdm.team.configuration import facts
from mdm.team.transport.bounds import UNREADABLE, Name, Number, Offset, can_be
from mdm.team.transport.transport import PROTOCOL

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from typing import Literal

    from mdm.actors import Ensemble
    from mdm.actors.control.source import JointProcess
    from mdm.team.ownership import Ownership
    from mdm.team.team import Team

BEGIN = "begin"
"""The command that starts an ensemble which nobody has started or stopped before."""

_DECISION = 1_000
"""Nanoseconds that a decision takes at least."""


class Part(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """One agent's part of a step: the time, in nanoseconds of its clock, and the value of each factor that it owns.

    A value is None where nothing is new (of observations), or where it is unknown (of states).
    """

    time: Number
    values: tuple[Number | None, ...]


class Contents(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """All that a copy holds.

    Args:
        control: The snapshot of the control layer.
        begun: Whether it was ever started.
        kept: The last value of each factor.
        gone: Since when agents are not there.
        silent: Agents whose values count no more.
        now: The time of the process, from its beginning.
        ahead: How far the clocks of agents are ahead of it.
        last: The last values that were decided on.
    """

    control: bytes
    begun: bool
    kept: tuple[Number | None, ...]
    gone: list[tuple[Name, Number]]
    silent: tuple[Name, ...]
    now: Number
    ahead: list[tuple[Name, Offset]]
    last: tuple[Number | None, ...] | None


_encode = msgspec.msgpack.Encoder().encode
_decode = msgspec.msgpack.Decoder(Part).decode
_decode_contents = msgspec.msgpack.Decoder(Contents).decode


class Copy:
    """A copy of the joint process.

    A part that is missing is summed over in a belief update; of a state the last value counts, for at most the team's
    ``max_age`` after the first step without its owner.

    Args:
        team: The team.
        agent: Whose copy it is.
        ensemble: The ensemble that decides here.
        process: As this agent's control layer decides on it.
        ownership: The factors, and their owners.
        protocol: The version of the protocol between agents.

    Attributes:
        begun: Whether it was ever started.
        facts: The configuration, by name, which must be the same at every agent.
        malformed: Parts that were none of its agent's; they count as missing.
    """

    def __init__(
        self,
        team: Team,
        agent: str,
        ensemble: Ensemble,
        process: JointProcess,
        ownership: Ownership,
        protocol: int = PROTOCOL,
    ) -> None:
        self.ownership = ownership
        self.begun = False
        self.malformed = 0
        self._agent = agent
        self._ensemble = ensemble
        self._process = process
        self._event_driven = team.event_driven
        self._max_age = round(team.max_age * 1e9)
        self._kept: list[int | None] = [None] * len(ownership.names)
        self._gone: dict[str, int] = {}
        self._silent: tuple[str, ...] = ()
        self._now = 0
        self._ahead: dict[str, int] = {}
        self._last: tuple[int | None, ...] | None = None
        self._digest: str | None = None
        if ownership.takes != "state":
            self._kept = list(ownership.idle)
        self.facts = facts(team, ensemble, ownership, self.snapshot(), protocol)

    def part(self, time: int, values: Iterable[int | None]) -> bytes:
        """Return this agent's part of a step: a value for each factor that it owns."""
        return _encode(Part(time, tuple(values)))

    def values_of(self, part: bytes | None) -> tuple[int | None, ...] | None:
        """Return the values of this agent's part of a step; None where it has none."""
        return None if part is None else _decode(part).values

    @property
    def aging(self) -> bool:
        """Whether the last word of an agent that is not there counts still."""
        return any(agent not in self._silent and self.ownership.of[agent] for agent in self._gone)

    def last_values(self, agent: str) -> tuple[int | None, ...]:
        """Return the last values of an agent's factors; None where they count no more."""
        stale = agent in self._silent
        return tuple(None if stale else self._kept[place] for place in self.ownership.of[agent])

    # -- Steps ---------------------------------------------------------------------------------------------------

    def command(self, command: str, time: int, *, still: bool = False) -> None:
        """Start, stop, reset or resume; earlier observations count no more. Who is still acts at another start."""
        self._digest = None
        if command == BEGIN:
            if self.begun:
                return
            command = "start"
        self.begun = self.begun or command != "reset"
        if self.ownership.takes != "state":
            self._kept = list(self.ownership.idle)
        message = Control(time, cast('Literal["start", "stop", "reset", "resume"]', command))
        if not still:
            self._ensemble.show(message)
        self._process.take(message)

    def step(self, inputs: Mapping[str, bytes], missing: Iterable[str], time: int) -> None:
        """Decide on a joint step.

        Args:
            inputs: The parts of agents; of those that are in neither, nothing is new.
            missing: Agents of which it is not known.
            time: For the messages here; it decides nothing.
        """
        self._digest = None
        said: dict[str, Part] = {}
        wrong: list[str] = []
        for agent, body in inputs.items():
            part = self._decode_part(agent, body)
            if part is None:
                wrong.append(agent)
            else:
                said[agent] = part
        silent = {*missing, *wrong}
        state = self.ownership.takes == "state"
        message = self._state(said, silent, time) if state else self._observation(said, silent, time)
        if message is not None:
            self._ensemble.show(message)
            self._process.take(message)

    def _decode_part(self, agent: str, body: bytes) -> Part | None:
        """Return a part; None where it is none of this agent's."""
        places = self.ownership.of.get(agent)
        try:
            part = _decode(body)
        except UNREADABLE:
            part = Part(0, ())
        sizes = self.ownership.sizes
        if places is not None and len(part.values) == len(places):
            for place, value in zip(places, part.values, strict=True):
                if value is not None and not 0 <= value < sizes[place]:
                    break
            else:
                return part
        self.malformed += 1
        return None

    def _observation(self, said: Mapping[str, Part], silent: set[str], time: int) -> Observation:
        """Return the joint observation of a step."""
        ownership, kept = self.ownership, self._kept
        values: list[int | None] = [None] * len(kept)
        mask = [False] * len(kept)
        for agent, part in said.items():
            for place, value in zip(ownership.of[agent], part.values, strict=True):
                if value is not None:
                    values[place] = value
                    mask[place] = True
        if True in mask:  # else time has passed, and nobody has seen anything
            for place, owner in enumerate(ownership.owners):
                if not mask[place]:
                    values[place] = None if owner in silent else kept[place]
                elif ownership.hold[place]:
                    kept[place] = values[place]
        index = None if None in values else ownership.index(values)
        return Observation(time, index, tuple(values), tuple(mask))

    def _state(self, said: Mapping[str, Part], silent: set[str], time: int) -> State | None:
        """Return the joint state of a step; None where events alone make steps and it is the same as before."""
        ownership = self.ownership
        # Clocks may differ: each counts from its agent's first message, and from its return; it may have been set.
        before = self._now
        for agent, part in said.items():
            if agent in self._gone or agent not in self._ahead:
                self._ahead[agent] = part.time - before
            self._now = max(self._now, part.time - self._ahead[agent])
        for agent, part in said.items():
            for place, value in zip(ownership.of[agent], part.values, strict=True):
                self._kept[place] = value
        for agent in ownership.of:
            if agent not in silent:
                self._gone.pop(agent, None)
            else:
                self._gone.setdefault(agent, self._now)
        limit = self._now - self._max_age
        self._silent = tuple(agent for agent, since in self._gone.items() if since < limit)
        values = tuple(
            None if owner in self._silent else value for owner, value in zip(ownership.owners, self._kept, strict=True)
        )
        same, self._last = values == self._last, values
        return None if same and self._event_driven else State(time, ownership.index(values), values)

    def named(self, inputs: Mapping[str, bytes]) -> dict[str, str | tuple[str | None, ...] | None]:
        """Return the parts of a step in names: of one factor its symbol, of several a tuple."""
        names: dict[str, str | tuple[str | None, ...] | None] = {}
        for agent, body in inputs.items():
            part = self._decode_part(agent, body)
            if part is not None:
                places = self.ownership.of[agent]
                symbols = tuple(
                    None if value is None else self.ownership.symbols[place][value]
                    for place, value in zip(places, part.values, strict=True)
                )
                names[agent] = symbols[0] if len(symbols) == 1 else symbols
        return names

    # -- Copies of the copy --------------------------------------------------------------------------------------

    def digest(self) -> str:
        """Return a hash of all that determines further steps; the same at every agent that took the same ones."""
        if self._digest is None:
            self._digest = of_bytes(self.snapshot())
        return self._digest

    def snapshot(self) -> bytes:
        """Return the whole copy."""
        held = Contents(
            self._process.snapshot(),
            self.begun,
            tuple(self._kept),
            sorted(self._gone.items()),
            self._silent,
            self._now,
            sorted(self._ahead.items()),
            self._last,
        )
        return _encode(held)

    def restore(self, snapshot: bytes) -> None:
        """Become the copy that a snapshot is of.

        Raises:
            ModelError: If it is no snapshot of this process; the copy is unchanged.
        """
        try:
            held = _decode_contents(snapshot)
        except UNREADABLE as error:
            raise ModelError(f"this is not a copy of an ensemble: {error}") from None
        agents = {*held.silent, *(agent for agent, _ in (*held.gone, *held.ahead))}
        if strangers := agents - self.ownership.of.keys():
            raise ModelError(f"this is not a copy of an ensemble: it has agents {', '.join(sorted(strangers))}")
        if not self._fit(held.kept) or (held.last is not None and not self._fit(held.last)):
            raise ModelError("this is not a copy of an ensemble: its factors have other values")
        clock = self._ensemble.runtime.now()
        if not can_be(held.now, clock, 1):
            raise ModelError(f"this is not a copy of an ensemble: it is {held.now} ns old")
        before = self._process.snapshot()
        self._process.restore(held.control)
        epoch = self._ensemble.controller.epoch
        if not can_be(epoch, clock, _DECISION):
            self._process.restore(before)
            raise ModelError(f"this is not a copy of an ensemble: it has made {epoch} decisions")
        self._digest = None
        self.begun, self._kept, self._gone = held.begun, list(held.kept), dict(held.gone)
        self._silent, self._now, self._ahead = held.silent, held.now, dict(held.ahead)
        self._last = held.last

    def _fit(self, values: tuple[int | None, ...]) -> bool:
        """Return whether these are values of the factors."""
        sizes = self.ownership.sizes
        return len(values) == len(sizes) and all(
            value is None or value < size for value, size in zip(values, sizes, strict=True)
        )
