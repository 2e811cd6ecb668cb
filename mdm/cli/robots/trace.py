"""``mdm trace``: stimuli on standard input, decisions on standard output, in virtual time.

Equal input gives equal bytes. Use it to inspect or compare policies and to test models.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdm.actors import ControlOptions, Ensemble, PredicateManager
from mdm.cli.report import as_json
from mdm.cli.robots.stimulus import read_stimuli
from mdm.cli.usage import UsageError, take_model
from mdm.config import System, load_system, load_team
from mdm.config.functions import nothing
from mdm.errors import ConfigError, Error
from mdm.formats import load_model, load_policy
from mdm.runtime import ActorFailure, Runtime, VirtualClock, run as run_program
from mdm.runtime.time.scheduler import check_rate

if TYPE_CHECKING:
    import argparse

    from mdm.cli.robots.stimulus import Stimulus
    from mdm.messages import Decision

__all__ = ["run"]

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
        if decision.reward is not None:
            line["reward"] = decision.reward
        try:
            print(as_json(line))
        except OSError as error:
            runtime.abort(error)  # raising would only make another fault

    return show
