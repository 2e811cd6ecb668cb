"""Sweeps: for each point of a table of parameters a model is made, solved and evaluated, and is a row of the result.

Points are parts of a work, see `mdm.simulation.parts`; all have the random numbers of one evaluation, so that two of
them do not differ by luck. A journal has a line for each point that has ended. Draws are the first points of a
Sobol sequence (I. Sobol, *USSR Computational Mathematics and Mathematical Physics* 7, 1967), a dimension a parameter.
"""

from __future__ import annotations

import fcntl
import inspect
import math
import os
import re
import socket
import sys
import tomllib
import warnings
from contextlib import ExitStack
from copy import copy
from fnmatch import fnmatchcase
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import IO, TYPE_CHECKING, Annotated, Any

import msgspec
import numpy as np
import scipy
from msgspec import Meta

from mdm import problems
from mdm.checks import is_number, is_whole
from mdm.config.functions import find_function
from mdm.config.tables import Problems
from mdm.controller import Controller
from mdm.errors import ConfigError, Error, FormatError, ModelError
from mdm.estimation.reestimation import replaced
from mdm.formats import load_durations, load_model
from mdm.formats.source import content
from mdm.loading import revealed
from mdm.logic import similar
from mdm.models import MDP, Durations
from mdm.models.availability import standing_in
from mdm.models.digest import digest, of_bytes, of_parts
from mdm.models.matrices import csr, read_only
from mdm.options import Options
from mdm.simulation import evaluate
from mdm.simulation.parts import run_parts
from mdm.solvers import exact_values, solve
from mdm.solvers.solution import Limits
from mdm.solvers.solve import SOLVERS, options_of
from mdm.texts import counted
from mdm.version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from concurrent.futures import Executor

_Point = dict[str, Any]
_MOST = 1_000_000
"""Points, and values of a range."""
_ENTRIES = {"T": "ACTION.STATE.NEXT", "O": "ACTION.STATE.OBSERVATION", "R": "ACTION.STATE", "durations": "ACTION"}
_FOUND = ("model", "policy", "solver", "reason", "lower", "upper", "value", "standard_error", "episodes", "failure")
_BEGINS = b'{"sweep":"'  # as a journal does: no other file is written over
_OF_RUN = ("run.seconds", "run.solve_seconds", "run.host")


class EvaluationTable(Options, frozen=True):
    """How points are evaluated: as by `mdm.evaluate`, or exactly where that is possible and no ``episodes`` are given.

    Attributes:
        seed: That of all points.
        metrics: Functions ``module:name`` of a model and its policy, which return a number.
    """

    episodes: Annotated[int, Meta(ge=1)] | None = None
    steps: Annotated[int, Meta(ge=1)] | None = None
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    metrics: tuple[str, ...] = ()


class SweepTable(Options, frozen=True):
    """A sweep's file.

    Attributes:
        problem: One of `mdm.problems`.
        model: In its place a model's file, or ``module:name``, a function of parameters that returns a model.
        durations: The file of how long actions take.
        vary: The parameters, see `points_of`.
        solve: Limits and options as of ``mdm solve``, and ``solver``.
        evaluate: An `EvaluationTable`.
    """

    problem: str | None = None
    model: str | None = None
    durations: str | None = None
    vary: dict[str, Any] = msgspec.field(default_factory=dict)
    solve: dict[str, Any] = msgspec.field(default_factory=dict)
    evaluate: dict[str, Any] = msgspec.field(default_factory=dict)


# -- Points ------------------------------------------------------------------------------------------------------------

_Range = msgspec.defstruct(
    "_Range",
    [
        *(("from", int | float), ("to", int | float), ("step", int | float | None, None)),
        *(("count", int | None, None), ("sobol", int | None, None)),
    ],
    forbid_unknown_fields=True,
)


def points_of(vary: Mapping[str, Any], found: Problems) -> list[_Point]:
    """Return the points of a table of parameters: all combinations, of which the last parameter changes first.

    A parameter has a list of values, one value, or a range ``{from, to}`` with its ends, by a ``step`` (1 between whole
    numbers) or in a ``count`` of values. Those with ``{sobol = N, from, to}`` of the same N are N points together, in
    the place of the first of them; draws between whole numbers are whole.

    Example:
        >>> points_of({"size": {"from": 4, "to": 5}, "rocks": [1, 2]}, Problems(None))[:2]
        [{'size': 4, 'rocks': 1}, {'size': 4, 'rocks': 2}]
    """
    axes: dict[object, list[_Point]] = {}
    drawn: dict[int, dict[str, Any]] = {}
    for name, given in vary.items():
        with found.collecting(f"vary.{name}"):
            if isinstance(given, dict):
                if (ends := found.convert(given, _Range, f"vary.{name}")) is None:
                    continue
                values = _range(ends)
                if ends.sobol is None:
                    axes[name] = [{name: value} for value in values]
                else:
                    drawn.setdefault(ends.sobol, {})[name] = ends
                    axes[ends.sobol] = [{}] * ends.sobol
            elif given == [] or not _is_plain(given):
                raise ConfigError(f"give a value, a list of values, or a range, not {given!r}")
            else:
                axes[name] = [{name: value} for value in (given if isinstance(given, list) else [given])]
        if (total := math.prod(map(len, axes.values()))) > _MOST:
            found.add(f"these are {total:,} points or more, and a sweep has at most {_MOST:,}", "vary")
            return []
    for count, ranges in drawn.items():
        rows = scipy.stats.qmc.Sobol(len(ranges), scramble=False).random(count).tolist()  # loaded here: it takes long
        axes[count] = [dict(zip(ranges, map(_between, ranges.values(), row), strict=True)) for row in rows]
    return [{name: value for part in parts for name, value in part.items()} for parts in product(*axes.values())]


def _is_plain(given: Any) -> bool:
    """Whether something is a value: a finite number, a text, true or false, or a list of these; whole in 64 bits."""
    if isinstance(given, list):
        return all(map(_is_plain, given))
    return isinstance(given, str | bool) or (is_number(given) and abs(given) < (2**63 if is_whole(given) else math.inf))


def _between(ends: Any, share: float) -> Any:
    """Return the value at a share of the way, a whole number between whole ones."""
    first, last = getattr(ends, "from"), ends.to
    whole = is_whole(first) and is_whole(last)
    return first + math.floor(share * (last - first + 1)) if whole else first + share * (last - first)


def _range(ends: Any) -> list[Any]:
    """Return the values of a range, none for draws; raise a ConfigError if it is no range, or has too many values."""
    first, last, count, draws = getattr(ends, "from"), ends.to, ends.count, ends.sobol
    if not (_is_plain([first, last]) and first <= last and math.isfinite(last - first)):
        raise ConfigError("a range is from a number to a greater one, both of them finite")
    if [ends.step, count, draws].count(None) < 2 or not (count is None or 2 <= count <= _MOST):
        raise ConfigError(f"give a step, a count from 2 to {_MOST:,}, or sobol: one of the three")
    if draws is not None:
        if not 1 <= draws <= _MOST or draws & (draws - 1):
            raise ConfigError(f"sobol is a power of 2, such as 16, not {draws}")
        return []
    if count is not None:
        width = (last - first) / (count - 1)
        return [first + place * (int(width) if width.is_integer() else width) for place in range(count)]
    step = 1 if ends.step is None and is_whole(first) and is_whole(last) else ends.step
    if step is None or not 0 < step < math.inf:
        raise ConfigError("between numbers that are not whole give a step above 0, or a count")
    if (last - first) / step >= _MOST:
        raise ConfigError(f"these are more than {_MOST:,} values")
    return [first + place * step for place in range(math.floor((last - first) / step * (1 + 1e-12)) + 1)]


# -- Models ------------------------------------------------------------------------------------------------------------


def with_entry(model: MDP, key: str, value: float) -> MDP:
    """Return a model, as matrices, with other entries of T, O or R.

    ``T.ACTION.STATE.NEXT`` and ``O.ACTION.STATE.OBSERVATION`` are probabilities, ``R.ACTION.STATE`` an expected reward.
    Names may be patterns, such as ``T.move.*.slip``. Probabilities that are 0 or 1 stay, as walls do; the rest of a row
    keeps its proportions.

    Raises:
        ModelError: If there is no such entry, or a row does not add up to 1.

    Example::

        slippery = with_entry(model, "T.move.*.slip", 0.2)
    """
    if model.event_observations or model.observed or (model.network and any(model.network.fully_observed)):
        raise ModelError(f"{key}: with observed factors, or observations of events, no entry can be named")
    kind, flat = key[0], model.flatten()
    actions, states, *nexts = _chosen(key, flat)
    if kind == "R":
        rewards, made = flat.rewards.copy(), copy(flat)
        rewards[np.ix_(states, actions)] = value
        if flat.available is not None:
            rewards = standing_in(rewards, flat.available)
        vars(made).update(_rewards=read_only(rewards), outcome_rewards=None, stacked={})
        return made
    every = range(len(flat.action_space))
    matrices = {"T": [flat.transition_matrix(action) for action in every]}
    if flat.pomdp is not None:
        matrices["O"] = [flat.pomdp.observation_matrix(action) for action in every]
    found = 0
    for action in actions:
        matrices[kind][action], count = _changed(key, matrices[kind][action], states, nexts[0], value)
        found += count
    if not found:
        raise ModelError(f"{key}: no such entry is between 0 and 1")
    return replaced(flat, matrices["T"], matrices.get("O"))


def _chosen(key: str, model: MDP) -> list[list[int]]:
    """Return for each name in a key the indices that it stands for."""
    kind, *names = key.split(".")
    states, form = model.state_space, _ENTRIES[kind].split(".")
    spaces = {"ACTION": model.action_space, "STATE": states, "NEXT": states, "OBSERVATION": model.observation_space}
    if len(names) != len(form):
        raise ModelError(f"{key}: {kind}.{_ENTRIES[kind]} was expected, with ? for a dot in a name")
    if kind == "O" and model.pomdp is None:
        raise ModelError(f"{key}: an MDP has no observations")
    found = []
    for name, space in zip(names, [spaces[word] for word in form], strict=True):
        assert space is not None
        try:
            found.append([space.index(name)])
        except ModelError as error:
            found.append([place for place, each in enumerate(space.names) if fnmatchcase(each, name)])
            if not found[-1]:
                raise ModelError(f"{key}: {error}") from None
    return found


def _changed(key: str, matrix: Any, rows: list[int], columns: list[int], value: float) -> tuple[Any, int]:
    """Return a matrix with other probabilities, and how many these are."""
    made = csr(matrix)
    row = np.repeat(np.arange(matrix.shape[0]), np.diff(made.indptr))
    hit = np.isin(row, rows) & np.isin(made.indices, columns) & (made.data > 0) & (made.data < 1)
    new = np.bincount(row[hit], minlength=matrix.shape[0]) * value
    rest = np.bincount(row[~hit], made.data[~hit], matrix.shape[0])
    if not 0 <= value <= 1 or (new > 1 + 1e-9).any() or ((rest == 0) & (abs(new - 1) > 1e-9)).any():
        raise ModelError(f"{key}: with {value!r} a row of probabilities does not add up to 1")
    touched = np.isin(np.arange(len(new)), row[hit])
    scale = np.where(touched, np.maximum(1 - new, 0) / np.where(rest > 0, rest, 1), 1.0)
    made.data = np.where(hit, value, made.data * scale[row])
    return made, int(hit.sum())


def _lasting(model: MDP, durations: Durations | None, key: str, value: float) -> Durations:
    """Return durations in which some actions take another time."""
    (actions,) = _chosen(key, model)
    durations = durations or Durations(1.0, of="step")
    means, stages = durations.table(model)
    means = means.copy()
    means[:, actions] = value
    return Durations(means, stages, np.broadcast_to(durations.rates, means.shape), of=durations.of)


# -- The work ----------------------------------------------------------------------------------------------------------


class _Head(msgspec.Struct, frozen=True):
    """The first line of a journal: digests of all that points depend on and of users' code, and the version of mdm."""

    sweep: str = ""
    code: str = ""
    version: str = __version__


class Plan(msgspec.Struct, kw_only=True):
    """A sweep's file, read and checked: a work with a unit for each point, see `mdm.simulation.parts`.

    Attributes:
        points: The points that are to be run, with their numbers, as many as ``units``.
        seed: That of all of them.
        model: The file's model, where it has one.
        make: In its place the function of parameters, whose names are ``own``.
        durations: How long actions take.
        options: The solver's.
        evaluation: How points are evaluated.
        metrics: Functions of users, by their names.
        head: The first line of its journal.
    """

    points: list[tuple[int, _Point]]
    units: int
    seed: int
    model: Any
    make: Any
    own: tuple[str, ...]
    durations: Any
    options: dict[str, Any]
    evaluation: EvaluationTable
    metrics: dict[str, Any]
    head: _Head
    policy: Any = None
    noun: str = "point"

    def size(self, first: int, last: int) -> int:
        """Return how many points these are."""
        return last - first

    def prepare(self) -> None:
        """Do nothing: points share the model alone."""

    def run(self, first: int, last: int, tell: Callable[[int], bool] = lambda _: False) -> list[_Point]:
        """Return the rows of some points; of those that have ended if `tell` returns True."""
        rows: list[_Point] = []
        asked = False

        def stops(*_: object) -> bool:
            nonlocal asked
            asked = asked or tell(len(rows))
            return asked

        for number, point in self.points[first:last]:
            began, row = perf_counter(), self.row(number, point)
            try:
                row |= self._found(point, stops)
            except (Exception, SystemExit) as error:  # of a user's function, or of too large a model
                row["failure"] = str(error) if isinstance(error, Error) else f"{type(error).__name__}: {error}"
            if asked or row["reason"] == "interrupted":
                break
            rows.append(row | {"run.seconds": perf_counter() - began, "run.host": socket.gethostname()})
        return rows

    def row(self, number: int, point: _Point) -> _Point:
        """Return the row of a point of which nothing is known."""
        return {"point": number, **point, "seed": self.seed, **dict.fromkeys((*_FOUND, *self.metrics, *_OF_RUN))}

    def _found(self, point: _Point, stops: Callable[..., bool]) -> _Point:
        """Return a point's columns of solution, evaluation and metrics; they do not count once `stops` was True."""
        world, durations, options = self._made(point)
        solution = solve(world, durations=durations, progress=stops, **options)
        policy, asked = solution.policy, self.evaluation
        found: _Point = {"lower": solution.lower, "upper": solution.upper, "run.solve_seconds": solution.seconds}
        exact = exact_values(world, policy, steps=asked.steps, durations=durations)
        if exact is not None and asked.episodes is None:
            found |= {"value": float(world.initial_belief @ exact), "standard_error": 0.0}
        else:
            given: Any = {"episodes": asked.episodes, "steps": asked.steps, "seed": asked.seed, "durations": durations}
            result = evaluate(world, policy, progress=stops, **given)
            found |= {"value": result.mean, "standard_error": result.standard_error, "episodes": result.episodes}
        for name, metric in self.metrics.items():
            found[name] = metric(world, policy)
            if not is_number(found[name]):
                raise Error(f"{name} returned {found[name]!r} in place of a number")
            found[name] = float(found[name])
        found = {name: value if math.isfinite(value) else None for name, value in found.items()}
        digests = {"model": digest(world), "policy": Controller(policy, world).digests()["policy"]}
        return {**found, **digests, "solver": solution.solver, "reason": solution.reason}

    def _made(self, point: _Point) -> tuple[MDP, Durations | None, dict[str, Any]]:
        """Return the model of a point, as its policy sees it, its durations, and the options of its solver."""
        model, durations, options = self.model, self.durations, dict(self.options)
        if self.make is not None:
            model = self.make(**{name: point[name] for name in self.own})
            if not isinstance(model, MDP):
                raise Error(f"the model's function returned {model!r} in place of a model")
        for name, value in point.items():
            kind, _, rest = name.partition(".")
            if name in self.own:
                continue
            if kind == "solve":
                options[rest] = value
            elif kind == "durations":
                durations = _lasting(model, durations, name, value)
            else:
                model = model.with_discount(value) if name == "discount" else with_entry(model, name, value)
        if options.get("memory") is not None:
            options["memory"] = int(options["memory"] * 1e6)
        return revealed(model), durations, options


def planned(given: str | os.PathLike[str] | Mapping[str, Any]) -> Plan:
    """Read and check a sweep's file, or its content.

    Raises:
        ConfigError: If it is wrong; with all problems, and their keys.
        FormatError: If the file cannot be read.
    """
    table, path = _table(given)
    wrong, folder = Problems(path), Path() if path is None else path.parent
    evaluation = wrong.convert(table.evaluate, EvaluationTable, "evaluate", partly=True) or EvaluationTable()
    files = [folder / name for name in (table.model, table.durations) if name is not None and (folder / name).exists()]
    model = make = durations = None
    if table.problem is not None:
        make = getattr(problems, table.problem) if table.problem in problems.__all__ else None
        if make is None:
            hint = similar(table.problem, problems.__all__) or "; mdm problem --list lists them"
            wrong.add(f"there is no problem {table.problem!r}{hint}", "problem")
    elif re.fullmatch(r"[\w.]+:[\w.]+", str(table.model)) and folder / str(table.model) not in files:
        make = wrong.attempt("model", find_function, str(table.model), folder)
    else:
        model = wrong.attempt("model", load_model, folder / str(table.model))
    if table.durations is not None:
        durations = wrong.attempt("durations", load_durations, folder / table.durations)
    metrics = {name: wrong.attempt("evaluate.metrics", find_function, name, folder) for name in evaluation.metrics}
    own = _own_names(table.vary, make, metrics, wrong) if model is not None or make is not None else ()
    points = points_of(table.vary, wrong)
    _check_options(table.solve, points, wrong)
    wrong.raise_all()
    parts = [repr([table, points]).encode(), *map(content, files)]
    made: Any = {"model": model, "make": make, "own": own, "durations": durations, "options": table.solve}
    made |= {"evaluation": evaluation, "metrics": metrics}
    modules = {sys.modules.get(each.__module__) for each in (make, *metrics.values()) if each is not None}
    code = sorted(file for module in modules if (file := getattr(module, "__file__", None)) is not None)
    head = _Head(of_parts(map(of_bytes, parts)), of_parts(of_bytes(content(Path(file))) for file in code))
    return Plan(points=list(enumerate(points)), seed=evaluation.seed, units=len(points), head=head, **made)


def _table(given: str | os.PathLike[str] | Mapping[str, Any]) -> tuple[SweepTable, Path | None]:
    """Return the table of a file, and the file."""
    path = Path(given) if isinstance(given, str | os.PathLike) else None
    try:
        document: Any = given if path is None else tomllib.loads(content(path).decode("utf-8-sig"))
        table = SweepTable.from_keywords(document)
        if (table.problem is None) == (table.model is None):
            raise ConfigError("give a problem or a model, one of the two")
        if not table.vary:
            raise ConfigError("there are no parameters", key="vary")
    except ConfigError as error:
        raise ConfigError(error.message, file=path, key=error.key) from None
    except ValueError as error:
        raise FormatError(f"this is not valid TOML: {error}", file=path) from None
    return table, path


def _own_names(vary: Mapping[str, Any], make: Any, metrics: Mapping[str, Any], wrong: Problems) -> tuple[str, ...]:
    """Return the parameters of the function that makes models, and note those that are nobody's."""
    takes = {} if make is None else inspect.signature(make).parameters
    every = any(each.kind is each.VAR_KEYWORD for each in takes.values())
    own = []
    for name, given in vary.items():
        kind, dot, _ = name.partition(".")
        if name in (*_FOUND, *metrics, "point", "seed"):
            wrong.add("this is a column of the result: give the parameter another name", f"vary.{name}")
        elif name in takes or (every and not dot):
            own.append(name)
        elif name == "discount" or (dot and kind in _ENTRIES):
            if not isinstance(given, dict) and not all(map(is_number, given if isinstance(given, list) else [given])):
                wrong.add("its values are numbers", f"vary.{name}")
        elif not dot or kind != "solve":
            known = dict.fromkeys([*takes, "discount", *(f"{key}.{names}" for key, names in _ENTRIES.items())])
            hint = similar(name, takes) or f"; there are {', '.join(known)}, solve.OPTION"
            wrong.add(f"there is no such parameter{hint}", f"vary.{name}")
    return tuple(own)


def _check_options(fixed: Mapping[str, Any], points: Sequence[_Point], wrong: Problems) -> None:
    """Note limits and options of solvers that are none."""
    known = {"solver", "gap", "time", "iterations", "memory"}.union(*map(options_of, SOLVERS))
    given = {(f"solve.{name}", repr(value)): value for name, value in fixed.items()}
    given |= {(name, repr(point[name])): point[name] for point in points for name in point if name[:6] == "solve."}
    for (key, _), value in given.items():
        name = key.removeprefix("solve.")
        with wrong.collecting(key, first=True):
            if name not in known:
                raise ConfigError(f"solvers have no option {name!r}{similar(name, known) or '; see mdm solve --help'}")
            if name == "solver" and value not in SOLVERS:
                raise ConfigError(f"there is no solver {value!r}; there are {', '.join(SOLVERS)}")
            if name in {"gap", "time", "iterations", "memory"}:
                Limits(**{name: value})


# -- The journal -------------------------------------------------------------------------------------------------------


def read_journal(path: Path) -> tuple[_Head, dict[int, _Point], int]:
    """Return the head of a journal, the last row of each of its points in order, and how many bytes of it are whole.

    Raises:
        FormatError: If it cannot be read, or is none.
    """
    data = content(path)
    whole = data.rfind(b"\n") + 1  # a torn last line is of a point that has not ended
    try:
        if data[: len(_BEGINS)] != _BEGINS[: len(data)]:
            raise KeyError
        head, *lines = data[:whole].splitlines() or [b"{}"]
        rows = {row["point"]: {**row, "failure": row["failure"]} for row in map(msgspec.json.decode, lines)}
        return msgspec.json.decode(head, type=_Head), dict(sorted(rows.items())), whole
    except (msgspec.MsgspecError, KeyError, TypeError):
        raise FormatError("this is no journal of a sweep, or it is damaged", file=path) from None


def _begun(path: Path, head: _Head, *, resume: bool) -> tuple[dict[int, _Point], IO[bytes]]:
    """Return the rows of a journal of points that need no second run, and the journal itself, which is of one sweep."""
    with ExitStack() as opened:
        try:
            file = opened.enter_context(path.open("ab"))
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise FormatError("another sweep writes this journal: give each a file of its own", file=path) from None
        except OSError as error:
            raise FormatError(f"the journal cannot be written: {error.strerror}", file=path) from None
        before, rows, whole = read_journal(path)
        done = {number: row for number, row in rows.items() if row["failure"] is None}
        if done and not resume:
            ended = counted(len(done), "point")
            raise FormatError(f"{ended} ended in an earlier run: --resume (resume=True) goes on", file=path)
        if done and before.code != head.code:  # it may have been mended for points that failed
            text = f"{path}: the code of metrics or of the model has changed since {counted(len(done), 'point')} ended"
            warnings.warn(f"{text}: they keep what the old one gave", stacklevel=3)
        if done and (before.sweep, before.version) != (head.sweep, head.version):
            other = f"mdm {before.version}" if before.version != head.version else "another sweep, or of other files"
            raise FormatError(f"this journal is of {other}: give another file, or delete it", file=path)
        file.truncate(whole if done else 0)
        if not done:
            _add(file, head)
        opened.pop_all()
    return done, file


def _add(file: IO[bytes], line: Any) -> None:
    """Add a line to a journal; it is on the disk then."""
    file.write(msgspec.json.encode(line) + b"\n")
    file.flush()
    os.fsync(file.fileno())


# -- Sweeps ------------------------------------------------------------------------------------------------------------


def sweep(
    plan: str | os.PathLike[str] | Mapping[str, Any] | Plan,
    journal: str | os.PathLike[str] | None = None,
    *,
    resume: bool = False,
    progress: Callable[[int, int], object] | None = None,
    executor: Executor | None = None,
) -> list[dict[str, Any]]:
    """Make, solve and evaluate a model for each point of a table of parameters.

    Args:
        plan: A TOML file with the keys of `SweepTable`, or its content.
        journal: A file for a line of each point that has ended.
        resume: Whether to go on with a journal that is there; points that failed are tried once more.
        progress: Called with how many points have ended, and of how many; where it returns True, the result is of
            those that have ended by then.
        executor: As of `mdm.evaluate`; the result is the same.

    Returns:
        A row for each point: its number as ``point``, its parameters, ``seed``, the digests of ``model`` and
        ``policy``, the ``solver`` and the ``reason`` why it stopped, bounds ``lower`` and ``upper``, the ``value`` with
        its ``standard_error`` (0 of an exact one) and ``episodes``, why it failed as ``failure``, and metrics; None
        where there is none, or no finite one. ``run.seconds``, ``run.solve_seconds`` and ``run.host`` differ from run
        to run.

    Raises:
        ConfigError: If the plan is wrong; names the keys.
        FormatError: If a file cannot be read or written, or the journal is of another sweep or version of mdm.
        Error: As of `mdm.simulation.parts.run_parts`, also for its warnings.

    Example::

        rows = mdm.sweep({"problem": "tiger", "vary": {"accuracy": [0.7, 0.85]}, "solve": {"gap": 0.1}})
        [row["lower"] for row in rows]  # the better it hears, the more it earns
    """
    plan = plan if isinstance(plan, Plan) else planned(plan)
    done, file = ({}, None) if journal is None else _begun(Path(journal), plan.head, resume=resume)
    todo = [each for each in plan.points if each[0] not in done]
    work = msgspec.structs.replace(plan, points=todo, units=len(todo))

    def keep(rows: list[_Point]) -> None:
        for row in rows:
            done[row["point"]] = row
            if file is not None:
                _add(file, row)

    def tell(*_: int) -> bool:
        return progress is not None and progress(len(done), plan.units) is True

    try:
        if executor is not None and todo:
            missing = run_parts(work, executor, tell, keep)[1]
            for number, point in todo if len(done) + missing == plan.units else ():
                done.setdefault(number, work.row(number, point) | {"failure": "no worker has ended it"})
        for unit in range(len(todo) if executor is None else 0):
            keep(rows := work.run(unit, unit + 1, tell))
            if not rows or tell():
                break
    finally:
        if file is not None:
            file.close()
    return [done[number] for number in sorted(done)]
