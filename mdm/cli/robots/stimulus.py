"""Stimuli, the input of `mdm trace`: one JSON object per line."""

from __future__ import annotations

from typing import IO, TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np

from mdm.config.functions import Lasting
from mdm.errors import Error
from mdm.messages import Belief, Control, Observation, SensorUpdate, State
from mdm.models.matrices import distribution
from mdm.replay.input import give

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mdm.actors import Ensemble
    from mdm.config import System

__all__ = ["Stimulus", "read_stimuli"]


class _Line(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    time: float | None = None
    epoch: int | None = None
    observation: int | str | list[int | str | None] | None = None
    state: int | str | list[int | str] | None = None
    belief: list[float] | None = None
    predicates: dict[str, bool | float | None] | None = None
    events: list[str] | None = None
    control: Literal["start", "stop", "reset", "release"] | None = None
    ensemble: str | None = None


class Stimulus:
    """The inputs of one instant, checked against the system.

    Args:
        line: The decoded line.
        when: Nanoseconds of virtual time from the start.
        system: The system.

    Attributes:
        epoch: The nanoseconds that the clock shows at the start, by which ticks are aligned; None where it is not told.

    Raises:
        Error: If a name or index is unknown.
    """

    def __init__(self, line: _Line, when: int, system: System) -> None:
        self.when = when
        self.epoch = line.epoch
        self._line = line
        if line.ensemble is not None and line.ensemble not in system.ensembles:
            raise Error(f"there is no ensemble {line.ensemble!r}; there are {', '.join(system.ensembles)}")
        self._name = system.top[0].name if line.ensemble is None else line.ensemble
        ensemble = system.ensembles[self._name]
        self._state = None if line.state is None else _state(ensemble, line.state)
        self._observation = None if line.observation is None else _observation(ensemble, line.observation)
        if line.belief is not None:
            size = ensemble.controller.symbols.num_states
            if ensemble.controller.takes == "state":
                raise Error("the policy decides on states: give a state, not a belief")
            if size is None:
                raise Error("the policy is a controller whose nodes have no values: give no belief")
            distribution(line.belief, what="the belief", size=size)
        for name in line.predicates or ():
            system.predicates.declared.check_input(name, "predicate")
        for name in line.events or ():
            if any(_ends(system, name)):
                continue
            system.predicates.declared.check_input(name, "event")

    def apply(self, system: System) -> None:
        """Give the inputs to the system."""
        line, path, runtime = self._line, system.ensembles[self._name].path, system.runtime
        now = runtime.clock.now()
        if line.control is not None:
            give(runtime, f"{path}/control", Control(now, line.control))
        declared = system.predicates.declared
        others = [event for event in line.events or () if not _end(system, event)]
        heard = tuple(event for event in others if event in declared.used or event in declared.names)
        if line.predicates or heard:
            told = (line.predicates or {}).items()
            values = tuple((name, system.predicates.truth_of(name, value)) for name, value in told)
            sensed = SensorUpdate(now, values, heard)
            give(runtime, f"{system.predicates.path}/sensed", sensed)
        if self._state is not None:
            give(runtime, f"{path}/state", State(now, *self._state))
        if line.belief is not None:
            give(runtime, f"{path}/external_belief", Belief(now, np.array(line.belief)))
        if self._observation is not None:
            give(runtime, f"{path}/observation", Observation(now, *self._observation))


def _ends(system: System, event: str) -> Iterator[tuple[Ensemble, Lasting]]:
    """Yield the actions that last until told to end, of which an event such as ``Go.succeeded`` is the end."""
    name, _, status = event.rpartition(".")
    for ensemble in system.ensembles.values() if status in {"succeeded", "failed"} else ():
        action = ensemble.action
        if name in action.names:
            function = action.bindings[action.names.index(name)].function
            if isinstance(function, Lasting):
                yield ensemble, function


def _end(system: System, event: str) -> bool:
    """End the live actions that an event is the end of; return whether there were any."""
    ended = False
    for ensemble, lasting in _ends(system, event):
        if event.rpartition(".")[0] in ensemble.action.live:
            lasting.end(None if event.endswith(".succeeded") else Error("as the stimulus says"))
            ended = True
    return ended


def _state(ensemble: Ensemble, given: Any) -> tuple[int, tuple[int, ...]]:
    controller = ensemble.controller
    if controller.takes != "state":
        raise Error("the policy decides on observations or beliefs: give one of these, not a state")
    index = controller.symbols.state_index(given)
    return index, (index,) if controller.model is None else controller.model.state_space.unravel(index)


def _observation(ensemble: Ensemble, given: Any) -> tuple[int | None, tuple[int | None, ...], tuple[bool, ...]]:
    index, values = ensemble.controller.symbols.observed(given)
    return index, values, tuple(value is not None for value in values)


_LATEST = 1_000_000_000
"""Seconds: a run of thirty years."""


def read_stimuli(stream: IO[bytes], system: System) -> tuple[list[Stimulus], str | None]:
    """Return the stimuli up to the first wrong line, and that line's error."""
    decoder = msgspec.json.Decoder(_Line)
    stimuli: list[Stimulus] = []
    when = 0
    for number, text in enumerate(stream, 1):
        if not text.strip():
            continue
        try:
            line = decoder.decode(text)
            if line.epoch is not None and (stimuli or not 0 <= line.epoch < 2**62):
                raise Error("an epoch is the clock's nanoseconds at the start, from 0 on, and is in the first line")
            if line.time is not None:
                if line.time < 0:
                    raise Error(f"a time is a number of seconds from 0 on, not {line.time}")
                if line.time >= _LATEST:
                    raise Error(
                        f"a time is a number of seconds from 0 on, the start, to {_LATEST:,}, not {line.time:.15g}: "
                        f"where times are dates, take the first off all of them"
                    )
                if round(line.time * 1e9) < when:
                    raise Error(f"time goes back from {when / 1e9:g} to {line.time:g} s")
                when = round(line.time * 1e9)
            stimuli.append(Stimulus(line, when, system))
        except (msgspec.MsgspecError, UnicodeDecodeError, Error) as error:
            return stimuli, f"standard input:{number}: {error}"
    return stimuli, None
