"""Models from functions: states and actions are any hashable values, and functions of them return the numbers."""

from __future__ import annotations

import difflib
import inspect
from collections import namedtuple
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from enum import Enum
from itertools import product
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from mdm.checks import is_number
from mdm.errors import ModelError
from mdm.models.matrices import Matrix, Vector, csr
from mdm.models.space import Factor, Space

Values: TypeAlias = "Iterable[Hashable] | Mapping[str, Iterable[Hashable]] | Space"
"""The symbols of a model: hashable values, the values of each factor by its name, or a `Space` of names."""
Odds: TypeAlias = "Mapping[Any, float] | Iterable[tuple[Any, float]] | Hashable"
"""A distribution: probabilities by value, pairs of value and probability, or the value that is certain."""

Entries: TypeAlias = "tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], Vector]"
"""Rows, columns and values of a matrix."""

MOST = 10_000_000
"""The number of reachable states at which the search for them gives up."""
_COMPARED = 10_000


def name_of(value: Hashable) -> str:
    """Return the name of a value in a model: a text itself, a tuple's parts with commas, else ``str(value)``."""
    if isinstance(value, Enum):
        return value.name
    return ",".join(map(name_of, value)) if type(value) is tuple else str(value)


class _Symbols:
    """The values of one kind, in the order of their indices.

    Args:
        kind: A word for one of them: ``state``, ``action`` or ``observation``.
        factor: The name of the factor of values that are not factored.
        given: The values.
    """

    def __init__(self, kind: str, factor: str, given: Values) -> None:
        self.kind = kind
        space = given if isinstance(given, Space) else None
        if space is not None:
            several = len(space.factors) > 1
            given = {each.name: each.names for each in space.factors} if several else space.names
        if isinstance(given, str) or not isinstance(given, Iterable):
            raise ModelError(f"{kind}s are values, or the values of each factor by its name, not {given!r}")
        if isinstance(given, Mapping):
            factors = {name: [*values] for name, values in given.items()}
            joint = namedtuple(kind, factors, rename=True)  # type: ignore[misc]  # noqa: PYI024 - names come with the model
            self.space = Space([Factor(name, map(name_of, values)) for name, values in factors.items()])
            self.values: list[Hashable] = [joint(*each) for each in product(*factors.values())]
        else:
            self.values = [*given]
            self.space = space or Space.single(factor, map(name_of, self.values))
        self._index = {value: index for index, value in enumerate(self.values)}
        if len(self._index) < len(self.values):
            twice = next(value for index, value in enumerate(self.values) if self._index[value] != index)
            raise ModelError(f"the {kind} {twice!r} is given twice")

    def odds(self, given: Odds, where: str) -> Iterable[tuple[int, float]]:
        """Return the index and the probability of each value of a distribution.

        Raises:
            ModelError: If it has another value, or is none: says where.
        """
        try:
            certain = self._index.get(given)  # type: ignore[arg-type]
        except TypeError:  # it is no value, for that is hashable
            certain = None
        if certain is not None:
            return ((certain, 1.0),)
        return [(self._known(value, where), chance) for value, chance in pairs(given, self.kind, where)]

    def _known(self, value: Any, where: str) -> int:
        try:
            return self._index[value]
        except (KeyError, TypeError):
            close = difflib.get_close_matches(repr(value), list(map(repr, self.values[:_COMPARED])), n=3)
            hint = f"; did you mean {' or '.join(close)}?" if close else ""
            raise ModelError(f"{where}: {value!r} is not one of the {self.kind}s{hint}") from None


def pairs(given: Odds, kind: str, where: str) -> list[tuple[Any, float]]:
    """Return the values of a distribution with their probabilities; a hashable value that is no mapping is certain.

    Raises:
        ModelError: If a probability is no number, or it is no distribution: says where.
    """
    if isinstance(given, Mapping):
        found = list(given.items())
    elif isinstance(given, list | Iterator):
        found = list(given)
        if not all(isinstance(each, Sequence) and len(each) == 2 for each in found):
            raise ModelError(f"{where}: pairs of a {kind} and its probability were expected, not {given!r}")
    else:
        found = [(given, 1.0)]
    for value, chance in found:
        if not is_number(chance):
            raise ModelError(f"{where}: the probability of {value!r} is not a number: {chance!r}")
    return found


def _takes(function: Callable[..., Any], what: str, *counts: int) -> int:
    """Return how many arguments a function takes: the first that suits of some numbers.

    Raises:
        ModelError: If it is none, or takes others.
    """
    if not callable(function):
        raise ModelError(f"{what} is a function, not {function!r}")
    for count in counts:
        try:
            inspect.signature(function).bind(*range(count))
        except TypeError:
            continue
        except ValueError:  # a builtin that does not say
            return counts[-1]
        return count
    wanted = " or ".join(map(str, sorted(counts)))
    raise ModelError(f"{what} is a function of {wanted} arguments, but {function!r} takes others")


class _Outcomes:
    """The rewards of single outcomes, as a CSR matrix for each action: those of transitions that there are."""

    def __init__(self, values: list[Matrix]) -> None:
        self._values = values

    def at(self, action: int, state: int, next_state: int, observation: int | None) -> float:
        """Return R(a, s, s'); 0 of a transition that there is not."""
        return float(self._values[action][state, next_state])

    def array(self, largest: int) -> Vector | None:
        """Return an A x S x S' array; None if it would have more than ``largest`` entries."""
        if len(self._values) * self._values[0].shape[0] ** 2 > largest:
            return None
        return np.stack([matrix.toarray() for matrix in self._values])


class _Functions:
    """Calls the functions of a model, each once for each state and action, and lays out their numbers."""

    def __init__(
        self,
        states: Values | None,
        actions: Values,
        transition: Callable[..., Odds],
        initial: Odds | None,
        available: Callable[..., bool] | None,
    ) -> None:
        _takes(transition, "transition", 2)
        if available is not None:
            _takes(available, "available", 2)
        self._transition, self._available = transition, available
        self._found: dict[tuple[Hashable, int], Odds] = {}
        self.actions = _Symbols("action", "agent", actions)
        if states is None and initial is None:
            raise ModelError("give initial where states is None: the states are those that can be reached from it")
        self.states = _Symbols("state", "state", self._reachable(initial) if states is None else states)
        self.size = len(self.states.values)
        self.initial = None if initial is None else np.zeros(self.size)
        for state, chance in () if initial is None else self.states.odds(initial, "initial"):
            self.initial[state] += chance  # type: ignore[index]
        self.mask = None
        if available is not None:
            can = [[bool(available(s, a)) for a in self.actions.values] for s in self.states.values]
            self.mask = np.array(can).reshape(self.size, len(self.actions.values))
        self.entries = [self._entries(action) for action in range(len(self.actions.values))]

    def _where(self, what: str, state: Hashable, action: Hashable) -> str:
        return f"{what} of action {action!r} in state {state!r}"

    def _next(self, state: Hashable, action: int) -> Odds:
        given = self._found.pop((state, action), None)
        return self._transition(state, self.actions.values[action]) if given is None else given

    def _reachable(self, initial: Odds | None) -> list[Hashable]:
        """Return the states that can be reached, and keep what the transition function has said of them."""
        waiting = list(dict.fromkeys(value for value, _ in pairs(initial, "state", "initial")))
        reached = set(waiting)
        for state in waiting:
            for index, action in enumerate(self.actions.values):
                if self._available is not None and not self._available(state, action):
                    continue
                given = self._found[state, index] = self._next(state, index)
                if isinstance(given, Iterator):
                    given = self._found[state, index] = list(given)
                for value, chance in pairs(given, "state", self._where("transition", state, action)):
                    if chance and value not in reached:
                        reached.add(value)
                        waiting.append(value)
            if len(waiting) > MOST:
                raise ModelError(f"more than {MOST:,} states can be reached, such as {waiting[-1]!r}")
        return waiting

    def _entries(self, action: int) -> Entries:
        """Return the states, next states and probabilities of an action, each transition once, in order."""
        entries = _Entries()
        for index, state in enumerate(self.states.values):
            if self._is_available(index, action):
                where = self._where("transition", state, self.actions.values[action])
                entries.add(index, self.states.odds(self._next(state, action), where))
            else:
                entries.add(index, [(index, 1.0)])
        return entries.arrays()

    def _is_available(self, state: int, action: int) -> bool:
        return self.mask is None or bool(self.mask[state, action])

    def transitions(self) -> list[Matrix]:
        """Return T for each action, in CSR."""
        return [_compressed(entries, self.size, self.size) for entries in self.entries]

    def rewards(self, reward: Callable[..., float]) -> tuple[Vector, _Outcomes | None]:
        """Return R(s, a), S x A, and the rewards of single outcomes where the function has these."""
        of_outcomes = _takes(reward, "reward", 3, 2) == 3
        expected = np.zeros((self.size, len(self.actions.values)))
        outcomes: list[Matrix] = []
        for action, (rows, columns, chances) in enumerate(self.entries):
            if of_outcomes:
                after = zip(rows.tolist(), columns.tolist(), strict=True)
                told = np.array([self._reward(reward, action, s, self.states.values[to]) for s, to in after])
                expected[:, action] = np.bincount(rows, chances * told, minlength=self.size)
                outcomes.append(_compressed((rows, columns, told), self.size, self.size))
            else:
                expected[:, action] = [self._reward(reward, action, state) for state in range(self.size)]
        return expected, _Outcomes(outcomes) if of_outcomes else None

    def _reward(self, reward: Callable[..., float], action: int, state: int, *after: Hashable) -> float:
        if not self._is_available(state, action):
            return 0.0
        given = reward(self.states.values[state], self.actions.values[action], *after)
        if not (is_number(given) or isinstance(given, bool | np.bool_)):
            where = self._where("the reward", self.states.values[state], self.actions.values[action])
            raise ModelError(f"{where} is not a number: {given!r}")
        return float(given)

    def observations(self, symbols: _Symbols, observation: Callable[..., Odds]) -> tuple[list[Any], bool]:
        """Return P(o | a, s') for each action, or P(o | s, a, s') for each action and observation; and whether."""
        of_events = _takes(observation, "observation", 3, 2) == 3
        width = len(symbols.values)
        laid_out: list[Any] = []
        for action, value in enumerate(self.actions.values):
            if of_events:
                rows, columns, _ = self.entries[action]
                seen = [_Entries() for _ in symbols.values]
                for state, to in zip(rows.tolist(), columns.tolist(), strict=True):
                    before, after = self.states.values[state], self.states.values[to]
                    where = f"observation of action {value!r} from state {before!r} to {after!r}"
                    for symbol, chance in symbols.odds(observation(before, value, after), where):
                        seen[symbol].add(state, [(to, chance)])
                laid_out.append([_compressed(each.arrays(), self.size, self.size) for each in seen])
            else:
                entries = _Entries()
                for index, after in enumerate(self.states.values):
                    where = f"observation of action {value!r} in the next state {after!r}"
                    entries.add(index, symbols.odds(observation(value, after), where))
                laid_out.append(_compressed(entries.arrays(), self.size, width))
        return laid_out, of_events


class _Entries:
    """The entries of a matrix, row after row."""

    def __init__(self) -> None:
        self._rows: list[int] = []
        self._columns: list[int] = []
        self._chances: list[float] = []

    def add(self, row: int, chances: Iterable[tuple[int, float]]) -> None:
        """Add to a row; a column that comes twice has the sum."""
        total: dict[int, float] = {}
        for column, chance in chances:
            total[column] = total.get(column, 0.0) + chance
        self._rows += [row] * len(total)
        self._columns += sorted(total)
        self._chances += [total[column] for column in sorted(total)]

    def arrays(self) -> Entries:
        """Return rows, columns and values."""
        return np.array(self._rows, dtype=int), np.array(self._columns, dtype=int), np.array(self._chances, dtype=float)


def _compressed(entries: Entries, rows: int, columns: int) -> Matrix:
    from scipy.sparse import coo_array  # noqa: PLC0415 - slow to import

    return csr(coo_array((entries[2], entries[:2]), shape=(rows, columns)))


def described(
    states: Values | None,
    actions: Values,
    transition: Callable[..., Odds],
    reward: Callable[..., float],
    initial: Odds | None,
    available: Callable[..., bool] | None,
    seen: tuple[Values, Callable[..., Odds]] | None = None,
) -> dict[str, Any]:
    """Return the arguments of an `MDP`, or with observations and their function of a `POMDP`, as functions say.

    Raises:
        ModelError: If one returns something else than a distribution or a number: names state and action.
    """
    built = _Functions(states, actions, transition, initial, available)
    rewards, outcomes = built.rewards(reward)
    arguments: dict[str, Any] = {
        "transitions": built.transitions(),
        "rewards": rewards,
        "outcome_rewards": outcomes,
        "states": built.states.space,
        "actions": built.actions.space,
        "initial_belief": built.initial,
        "available": built.mask,
    }
    if seen is not None:
        symbols = _Symbols("observation", "agent", seen[0])
        observations, of_events = built.observations(symbols, seen[1])
        arguments |= {"observations": observations, "event_observations": of_events}
        arguments["observation_names"] = symbols.space
    return arguments
