"""``mdm check``: all problems and oddities of a file at once."""

from __future__ import annotations

import re
import sys
import tomllib
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.cli.files.info import is_policy, kind_of
from mdm.cli.files.oddities import oddities
from mdm.cli.policies.inputs import load_durations_for
from mdm.cli.report import as_json
from mdm.cli.usage import UsageError
from mdm.errors import ConfigError, Error, FormatError, ModelError
from mdm.formats import load_model, load_policy
from mdm.formats.source import suffixes
from mdm.models.diagnosis import diagnose
from mdm.models.durations import in_time
from mdm.models.dynamics import Dynamics
from mdm.models.units import check_steps
from mdm.models.validation import Problem, collect_problems
from mdm.policies import DeterministicPolicy, QTable

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from mdm.config import System
    from mdm.models import MDP, Durations
    from mdm.models.matrices import Vector

_TOLD = 5
_PLACES = 5
_VARYING = re.compile(r"'[^']*'|\d[\d.e+-]*|; did you mean .*")
"""The parts that differ between problems of one kind: names, numbers, places, suggestions."""
_PROGRAM = re.compile(r"\.py(:[^/]*)?$")
"""The end of the name of a Python file, with that of a function in it."""
_PLACE = re.compile(r"\S*?:(\d+)(?::\d+)?: ")

Findings = tuple[str | None, list[str], list[str]]
"""The kind of a file's content, its problems, and notes on oddities."""


def run(arguments: argparse.Namespace) -> int:
    """Check the file; return the exit status."""
    examined = _examine_program if _PROGRAM.search(arguments.file) else _examine
    return report(arguments.file, lambda: examined(arguments), json=arguments.json)


def report(file: str, examine: Callable[[], Findings], *, json: bool, command: str = "mdm check") -> int:
    """Check a file and print the findings; return the exit status.

    Args:
        file: The file.
        examine: Returns its kind of content, its problems, and notes on oddities; warnings are notes, too.
        json: Whether to print one JSON object.
        command: Whose problems are printed.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        kind, problems, notes = examine()
    notes = [str(warning.message).removeprefix(f"{file}: ") for warning in caught] + notes
    if json:
        print(as_json({"file": file, "holds": kind, "problems": problems, "notes": notes}))
    else:
        for line in grouped(problems):
            print(f"{command}: {line}", file=sys.stderr)
        for note in notes:
            place, colon, text = note.partition(": ") if note.startswith(f"{file}:") else (file, ": ", note)
            print(f"{place}{colon}note: {text}")
        if not problems:
            print(f"{file}: {kind}, no problems found")
        elif len(problems) > 1:
            print(f"{command}: {file}: {len(problems)} problems found", file=sys.stderr)
    return 1 if problems else 0


def grouped(problems: list[str]) -> list[str]:
    """Return problems as lines: of each kind all, or the first few, and the number and places of those that follow."""
    kinds: dict[str, list[str]] = {}
    for problem in problems:
        kinds.setdefault(_VARYING.sub("", problem), []).append(problem)
    lines: list[str] = []
    for alike in kinds.values():
        if len(alike) <= _TOLD:
            lines += alike
            continue
        rest = [found[1] for found in map(_PLACE.match, alike[_TOLD - 2 :]) if found]
        places = f", at lines {', '.join(rest[:_PLACES])}{', …' if len(rest) > _PLACES else ''}" if rest else ""
        lines += [*alike[: _TOLD - 2], f"and {len(alike) - _TOLD + 2} more like the last{places}"]
    return lines


def _examine_program(arguments: argparse.Namespace) -> Findings:
    """Return the findings on the ensembles that a function of a Python file returns."""
    if any(getattr(arguments, name) for name in ("model", "durations", "normalize", "imports", "live")):
        raise UsageError("a function of a Python file is checked without other options than --json")
    from mdm.cli.files.program import examine  # noqa: PLC0415 - a model needs no actors

    return examine(arguments.file)


def _examine(arguments: argparse.Namespace) -> Findings:
    """Return a file's kind of content, its problems, and notes on oddities."""
    file, model = arguments.file, arguments.model
    is_toml = suffixes(file) == ".toml"
    if (arguments.imports or arguments.live) and not is_toml:
        raise UsageError(f"--{'import' if arguments.imports else 'live'} is for TOML files")
    if model is None and arguments.durations is not None:
        raise UsageError("--durations are those of a policy's --model")
    if is_toml and (model is not None or arguments.normalize):
        raise UsageError("--model is for policies and --normalize for models; this is a TOML file")
    try:
        if is_toml:
            return _examine_ensembles(file, imports=arguments.imports, live=arguments.live)
        if is_policy(file):
            if arguments.normalize:
                raise UsageError("--normalize is for models; this file holds a policy")
            return _examine_policy(file, model, arguments.durations)
    except ConfigError as error:
        return None, [str(problem) for problem in error.problems], []
    except FormatError as error:
        return None, [str(error)], []
    if model is not None:
        raise UsageError("--model is for policies; this file holds a model itself")
    return _examine_model(file, arguments.normalize)


def _examine_policy(file: str, model: str | None, durations: str | None) -> Findings:
    against = None if model is None else load_model(model)
    policy = load_policy(file, against)
    notes = _policy_notes(policy)
    if model is not None and against is not None:
        old = stale(against, policy, model, file, load_durations_for(against, durations))
        notes += [] if old is None else [old]
    return kind_of(policy), [], notes


def _examine_ensembles(file: str, *, imports: bool, live: bool) -> Findings:
    from mdm.cli.robots.ensembles import load_ensembles  # noqa: PLC0415 - a model needs no actors
    from mdm.config.builder import agents_of  # noqa: PLC0415

    agents = agents_of(file)
    if agents:
        if live:
            raise UsageError(f"--live looks for one robot: mdm ros2 doctor {file} --agent NAME")
        from mdm.cli.team.check import examine  # noqa: PLC0415 - a robot without a team needs none of it

        return examine(file, agents, imports=imports)
    system = load_ensembles(file, imports=imports)
    problems: list[str] = []
    if live:
        from mdm.ros2.doctor import examine as look  # noqa: PLC0415 - rclpy is the user's own

        problems += [problem for part in look(file) for problem in part.problems]
    notes = oddities(file, system.ensembles.values(), imports=imports or live)
    return "ensembles", problems, [*notes, *_stale_policies(file, system)]


def _stale_policies(file: str, system: System) -> list[str]:
    """Return a note for each file of a policy that seems to be of another model than the one beside it."""
    tables = tomllib.loads(Path(file).read_text(encoding="utf-8-sig"))["ensembles"]
    notes = []
    for name, ensemble in system.ensembles.items():
        policy, model = tables[name]["policy"], ensemble.controller.model
        if isinstance(policy, str) and model is not None:
            durations = system.durations.get(name)
            notes.append(stale(model, ensemble.controller.policy, tables[name]["model"], policy, durations))
    return [note for note in notes if note is not None]


def _examine_model(file: str, normalize: bool) -> tuple[str | None, list[str], list[str]]:
    odd: list[str] = []
    kind = None
    with collect_problems() as collected:
        try:
            model = load_model(file)
            own = len(collected)
            model.flatten()
            if any(not problem.is_remark for problem in collected[:own]):
                del collected[own:]  # rows of matrices that are those of the factors again
            kind = kind_of(model)
            if all(
                problem.is_sum or problem.is_remark for problem in collected
            ):  # with worse problems, oddities would only follow from them
                odd = diagnose(model)
        except (FormatError, ModelError) as error:
            collected.append(Problem(str(error), is_sum=False))
    problems, notes = [], []
    for problem in dict.fromkeys(collected):
        if problem.is_remark:
            notes.append(problem.text)
        elif normalize and problem.is_sum:
            notes.append(f"{problem.text}; normalised")
        else:
            problems.append(problem.text if problem.text.startswith(file) else f"{file}: {problem.text}")
    return kind, problems, notes + odd


def _policy_notes(policy: Any) -> list[str]:
    """Return notes on oddities of a policy."""
    chosen = getattr(policy, "actions", None)  # the action of each state or vector
    if chosen is None or policy.input == "observation":
        return []
    never = sorted(set(range(policy.num_actions)) - set(map(int, chosen)))
    return [f"actions {', '.join(map(str, never))} are never chosen"] if never else []


_MOST = 4_000_000
"""Entries of T, over all actions, up to which a table is looked at."""
_SHARE = 0.01
"""The part of the greatest reward by which values may differ: solvers stop at a gap, and files round."""


def stale(model: MDP, policy: Any, model_file: str, policy_file: str, durations: Durations | None = None) -> str | None:
    """Return that a policy's file seems to be of another model, with the state that shows it; None where it does not.

    A text file of a table holds numbers alone. Where the states of the model were put in another order since, or its
    rewards changed, the sizes still fit, and the robot would act on another model. One backup of Bellman's equation
    tells: of values that solve the model, or of the exact values of a list of actions, it changes nothing (R. Bellman,
    *Dynamic programming*, 1957). It costs A products with an S x S matrix, and for a list of actions a linear system.

    Args:
        model: The model.
        policy: The policy; only tables over states of one action each are looked at.
        model_file: The file of the model, to be named.
        policy_file: The file of the policy, to be named.
        durations: How long actions take in the model.
    """
    size = len(model.state_space)
    if type(policy) not in {DeterministicPolicy, QTable} or size**2 * policy.num_actions > _MOST:
        return None
    if policy.mismatch(model) is not None:
        return None
    try:
        if durations is None:
            check_steps(model)
        dynamics = Dynamics(model if durations is None else in_time(model, durations))
        if isinstance(policy, QTable):
            values = policy.values.max(axis=1)
        else:
            from mdm.solvers.evaluation import state_values  # noqa: PLC0415 - values of actions need no solver

            values = state_values(model, policy, durations=durations)
        table = dynamics.q_values(np.append(values, np.zeros(dynamics.num_states - size)))[:size]
    except Error:
        return None  # there may be no value at a discount of 1, nor at one of a second without times
    most = _SHARE * float(np.abs(model.rewards).max())
    found = (_of_values if isinstance(policy, QTable) else _of_actions)(model, policy, table, most)
    if found is None:
        return None
    policy_name, model_name = Path(policy_file).name, Path(model_file).name
    return f"{policy_name} is not that of {model_name}: {found}; solve again, if the model was changed since"


def _of_values(model: MDP, policy: QTable, values: Vector, most: float) -> str | None:
    differ = np.abs(values - policy.values)
    differ[~np.isfinite(policy.values)] = 0  # an action that is not allowed there
    state, action = np.unravel_index(int(differ.argmax()), differ.shape)
    if differ[state, action] <= most:
        return None
    pair = f"{model.action_space.names[int(action)]!r} in {model.state_space.names[int(state)]!r}"
    return f"of {pair} it says {policy.values[state, action]:.4g}, where that model gives {values[state, action]:.4g}"


def _of_actions(model: MDP, policy: DeterministicPolicy, values: Vector, most: float) -> str | None:
    lost = values.max(axis=1) - values[np.arange(len(values)), list(policy.actions)]
    state = int(lost.argmax())
    if lost[state] <= most:
        return None
    better, chosen = model.action_space.names[int(values[state].argmax())], policy.actions[state]
    return (
        f"in {model.state_space.names[state]!r} that model has {better!r} worth {lost[state]:.4g} more than "
        f"{model.action_space.names[chosen]!r}"
    )
