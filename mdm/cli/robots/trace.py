"""``mdm trace``: stimuli on standard input, decisions on standard output, in virtual time.

Equal input gives equal bytes. Use it to inspect or compare policies and to test models.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np

from mdm.actors import ControlOptions, Ensemble, PredicateManager
from mdm.cli.report import as_json
from mdm.cli.usage import UsageError, take_model
from mdm.config import System, load_system, load_team
from mdm.config.functions import Lasting, nothing
from mdm.errors import ConfigError, Error
from mdm.formats import load_model, load_policy
from mdm.messages import Belief, Control, Observation, SensorUpdate, State
from mdm.models.matrices import distribution
from mdm.replay.input import give
from mdm.runtime import ActorFailure, Runtime, VirtualClock, run as run_program
from mdm.runtime.time.scheduler import check_rate

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from mdm.messages import Decision

_OPTIONS = (
    "model",
    "policy",
    "drive",
    "discount",
    "false_negative",
    "horizon",
    "on_impossible",
    "on_no_observation",
    "seed",
)


def run(arguments: argparse.Namespace) -> int:
    """Trace the stimuli; return the exit status."""
    take_model(arguments)
    system = _system(arguments)
    if sys.stdin is None:
        raise Error("there is no standard input")
    if sys.stdin.isatty():
        example = '{"state": 0} or {"predicates": {"NAME": true}}'
        print(f"mdm trace: reads stimuli, a line each, such as {example}; Ctrl-D ends them", file=sys.stderr)
    stimuli, problem = read_stimuli(sys.stdin.buffer, system)
    epoch = (stimuli[0].epoch or 0) if stimuli else 0

    async def main() -> None:
        async with Runtime(log=False, clock=VirtualClock(epoch=epoch)) as runtime:
            runtime.faults.subscribe(lambda fault: print(f"mdm trace: {fault.detail}", file=sys.stderr))
            runtime.decisions.subscribe(_printer(runtime, epoch, several=len(system.ensembles) > 1))
            await runtime.start(system)
            await _feed(runtime, system, stimuli, epoch)

    try:
        run_program(main, virtual=True)
    except ActorFailure as failure:
        if isinstance(failure.__cause__, OSError | Error):
            raise failure.__cause__ from None
        raise
    if problem is not None:
        raise Error(problem)
    return 0


def _system(arguments: argparse.Namespace) -> System:
    if arguments.file is not None:
        return _system_of_file(arguments)
    if arguments.policy is None:
        raise UsageError("give a TOML file, or --policy and, where it needs one, --model")
    for name in ("discount", "false_negative"):
        if arguments.model is None and getattr(arguments, name) is not None:
            raise UsageError(f"--{name.replace('_', '-')} is for --model")
    model = None if arguments.model is None else load_model(arguments.model)
    if model is not None and arguments.discount is not None:
        model = model.with_discount(arguments.discount)
    policy = load_policy(arguments.policy, model, seed=arguments.seed)
    actions = policy.num_actions if model is None else len(model.action_space.factors[0])
    if arguments.drive not in {None, "event"}:
        given_drive = arguments.drive
        try:
            arguments.drive = float(given_drive)
            check_rate(arguments.drive)
        except (ValueError, ConfigError):
            text = "--drive is 'event' or a rate of 0.000001 to 1,000,000 decisions per second"
            raise UsageError(f"{text}, not {given_drive!r}") from None
    given = [
        (option, getattr(arguments, option, None)) for option in ControlOptions.__annotations__ if option != "seed"
    ]
    ensemble = Ensemble(
        "ensemble",
        policy=policy,
        model=model,
        actions=dict.fromkeys(range(actions), nothing),
        **{option: value for option, value in given if value is not None},
    )
    return System(PredicateManager(), {"ensemble": ensemble}, [])


def _system_of_file(arguments: argparse.Namespace) -> System:
    for name in _OPTIONS:
        if getattr(arguments, name) is not None:
            raise UsageError(f"--{name.replace('_', '-')} is for --policy; a TOML file has its own options")
    if (team := load_team(arguments.file)) is not None:
        raise UsageError(
            f"{arguments.file} describes the team {team.name!r}, of which no agent can be traced alone: give the "
            f"team's --model and --policy, or record a run by mdm team up --record, and see mdm replay"
        )
    return load_system(Path(arguments.file), callbacks=False)


async def _feed(runtime: Runtime, system: System, stimuli: list[Stimulus], epoch: int) -> None:
    """Apply each stimulus at its time, before any tick of the same instant."""
    for stimulus in stimuli:
        wait = epoch + stimulus.when - runtime.clock.now()
        if wait > 0:
            await runtime.clock.sleep(wait / 1e9)
        stimulus.apply(system)
        await runtime.clock.sleep(0)  # what ends by it comes to its end first
    # A timer of the last rank, so that ticks of the last instant still happen.
    await runtime.clock.sleep(0, rank=2)


def _printer(runtime: Runtime, epoch: int, *, several: bool) -> Any:
    def show(decision: Decision) -> None:
        line: dict[str, Any] = {"ensemble": decision.ensemble} if several else {}
        line |= {"epoch": decision.epoch, "time": (decision.time - epoch) / 1e9, "cause": decision.cause}
        for key in ("state", "observation", "belief"):
            value = getattr(decision, key)
            if value is not None:
                line[key] = value
        line |= {"action": decision.action, "action_name": decision.action_name}
        if decision.wanted is not None:
            line |= {"wanted": decision.wanted, "wanted_name": decision.wanted_name}
        if decision.reward is not None:
            line["reward"] = decision.reward
        try:
            print(as_json(line))
        except OSError as error:
            runtime.abort(error)  # raising would only make another fault

    return show


class _Line(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    time: float | None = None
    epoch: int | None = None
    observation: int | str | list[int | str | None] | None = None
    state: int | str | list[int | str] | None = None
    belief: list[float] | None = None
    predicates: dict[str, bool | float | None] | None = None
    events: list[str] | None = None
    control: Literal["start", "stop", "reset", "release", "decide_again"] | None = None
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
