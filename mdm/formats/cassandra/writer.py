"""Writing ``T:``, ``O:`` and ``R:`` statements in Cassandra's syntax and in MADP's, as pomdp-solve and MADP read them.

A symbol that a header only counts has no name: statements use its index. ``identity`` is a matrix of T alone.
"""

from __future__ import annotations

import re
import warnings
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mdm.errors import ModelError, ModelWarning
from mdm.formats.distributions import closed
from mdm.formats.spelling import Speller
from mdm.models import POMDP
from mdm.models.compressed import is_compressed

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mdm.models import MDP, Space
    from mdm.models.matrices import Matrix, Vector

__all__ = ["StatementWriter", "Symbols"]

_FOREIGN = re.compile(r"[^A-Za-z0-9_-]")
_LETTER = re.compile("[A-Za-z]")
_KEYWORDS = {"T", "O", "R", "agents", "discount", "values", "states", "actions", "observations", "start"}
_KEYWORDS |= {"include", "exclude", "uniform", "identity", "reset", "reward", "rewards", "cost", "costs"}
_LARGEST = 20_000_000
_WIDE = 30
_FEW = 0.5


class Symbols(NamedTuple):
    """The symbols of a space as a file has them.

    Attributes:
        declared: Their declaration: names, or their number where they have the names of their indices.
        words: What statements call each of them.
    """

    declared: str
    words: list[str]

    @classmethod
    def of(cls, names: list[str], prefix: str) -> Symbols:
        """Return the symbols of names; those of a prefix and an index, or of an index alone, are counted."""
        indices = list(map(str, range(len(names))))
        if names in (indices, [f"{prefix}{index}" for index in indices]):
            return cls(str(len(names)), indices)
        return cls(" ".join(names), names)

    def by_index(self) -> Symbols:
        """Return the same symbols, called by their indices."""
        return Symbols(self.declared, list(map(str, range(len(self.words)))))


class StatementWriter:
    """Writes a model as statements.

    Args:
        model: The model; a factored one is flattened.
        colon: The separator before a value: `` : `` in MADP's files, a blank in Cassandra's.

    Raises:
        ModelError: If the observations are events, which these formats lack.
    """

    def __init__(self, model: MDP, *, colon: str) -> None:
        if isinstance(model, POMDP) and model.event_observations:
            raise ModelError(
                "this format cannot hold observations of events, P(o | s, a, s'): write .pgmx, or an archive (.npz)"
            )
        self._model = model
        self._colon = colon
        self._speller = _speller()
        self.states = Symbols.of(self.joined(model.state_space), "s")

    def joined(self, space: Space) -> list[str]:
        """Return a word for each symbol of a space; for joint symbols, the joined words of the factors."""
        if len(space.factors) == 1:
            return self.spell(space.factors[0].names)
        parts = [self._speller.spell(factor.names) for factor in space.factors]
        return _speller().spell(["_".join(words) for words in product(*parts)])

    def spell(self, names: Sequence[str]) -> list[str]:
        """Return a word for each name, none of them a keyword or a number but its own index, if all are."""
        indices = list(map(str, range(len(names))))
        return indices if list(names) == indices else self._speller.spell(names)

    def warn(self, format_name: str) -> None:
        """Warn if names were changed."""
        self._speller.warn(format_name)

    def start(self) -> str:
        """Return the start distribution."""
        belief = self._model.initial_belief
        if (belief == 1 / len(belief)).all():
            return "uniform"
        return " ".join(map(repr, closed(belief).tolist()))

    def statements(self, actions: list[str], observations: list[str] | None) -> Iterable[str]:
        """Yield all statements, each of one or more lines.

        Args:
            actions: The word or words of each joint action.
            observations: The word or words of each joint observation; None in an MDP.
        """
        model = self._model
        yield from self._matrices("T", model.transition_matrix, actions, self.states.words)
        if observations is not None and isinstance(model, POMDP):
            yield from self._matrices("O", model.observation_matrix, actions, observations)
        rewards = list(self._rewards(actions, observations))
        # pomdp-solve needs a reward, be it 0.
        yield from rewards or [f"R: {' : '.join('*' * (3 if observations is None else 4))}{self._colon}0.0"]

    def _matrices(self, kind: str, matrix: Any, actions: list[str], columns: list[str]) -> Iterable[str]:
        every = [matrix(action) for action in range(len(actions))]
        if all(each is every[0] for each in every):
            actions, every = ["*"], every[:1]
        for action, each in zip(actions, every, strict=True):
            yield from self._matrix(kind, action, each, columns)

    def _matrix(self, kind: str, action: str, matrix: Matrix, columns: list[str]) -> Iterable[str]:
        head = f"{kind}: {action}" + (" :" if self._colon != " " else "")
        matrix = closed(matrix)
        if is_compressed(matrix):
            entries = matrix.tocoo()
            rows, places, values = entries.row, entries.col, entries.data
        else:
            rows, places = np.nonzero(matrix)
            values = matrix[rows, places]
        states = self.states.words
        size = len(states) * len(columns)
        if kind == "T" and len(values) == len(states) and (rows == places).all() and (values == 1).all():
            yield f"{head}\nidentity"
        elif len(values) == size and (values == 1 / len(columns)).all():
            yield f"{head}\nuniform"
        elif len(values) < _FEW * size or len(columns) > _WIDE:
            for row, place, value in zip(rows.tolist(), places.tolist(), values.tolist(), strict=True):
                yield f"{kind}: {action} : {states[row]} : {columns[place]}{self._colon}{value!r}"
        else:
            given = matrix.toarray() if is_compressed(matrix) else matrix
            yield head + "\n" + "\n".join(" ".join(map(repr, row)) for row in given.tolist())

    def _rewards(self, actions: list[str], observations: list[str] | None) -> Iterable[str]:
        axes = 3 if observations is None else 4
        rewards = self._model.rewards.T
        finer = self._model.outcome_rewards
        if finer is not None:
            array = finer.array(_LARGEST)
            if array is None:
                text = "there are too many rewards of single outcomes: only their expectation R(s, a) is written"
                warnings.warn(text, ModelWarning, stacklevel=6)
            else:
                rewards = array
        rewards = rewards.reshape(rewards.shape + (1,) * (axes - rewards.ndim))
        if (rewards == rewards[:1]).all():
            actions, rewards = ["*"], rewards[:1]
        for action, each in zip(actions, rewards, strict=True):
            yield from self._outcomes(action, each, [self.states.words, self.states.words, observations or []])

    def _outcomes(self, action: str, rewards: Vector, names: list[list[str]]) -> Iterable[str]:
        """Yield the rewards of an action's outcomes, with ``*`` for symbols on which they do not depend."""
        names = list(names)
        for axis in range(rewards.ndim):
            first = rewards.take([0], axis=axis)
            if (rewards == first).all():
                rewards, names[axis] = first, ["*"]
        places = np.nonzero(rewards)
        words = [np.array(of, dtype=object)[at] for of, at in zip(names, places, strict=False)]
        for *symbols, value in zip(*words, rewards[places].tolist(), strict=True):
            yield f"R: {action} : {' : '.join(symbols)}{self._colon}{value!r}"


def _speller() -> Speller:
    return Speller(_FOREIGN, _KEYWORDS, before="x_", first=_LETTER)
