"""Anthony Cassandra's ``.pomdp`` and ``.mdp`` formats, as used by pomdp-solve and most other tools.

The grammar is https://www.pomdp.org/code/pomdp-file-spec.html, plus common deviations from it. Statements are written
in Cassandra's syntax and in MADP's, as pomdp-solve and MADP read them: a symbol that a header only counts has no name,
and statements use its index; ``identity`` is a matrix of T alone.
"""

from __future__ import annotations

import re
import warnings
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from mdm.errors import FormatError, ModelError, ModelWarning
from mdm.formats.cassandra.statements import Field, Statements, begins_foreign, check_commas, foreign, unknown
from mdm.formats.source import LARGEST, Source, Words, number, suffixes
from mdm.formats.target import write_text
from mdm.formats.writers import Speller, closed
from mdm.models import MDP, POMDP, Space
from mdm.models.matrices import TOLERANCE, RowError, csr, is_compressed
from mdm.models.validation import is_collecting, placing, remark, report

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from mdm.models.matrices import Matrix, Vector

_KEYS = frozenset({"discount", "values", "states", "actions", "observations", "start"})
_SIGNS = {"reward": 1.0, "rewards": 1.0, "cost": -1.0, "costs": -1.0}
_FOREIGN = re.compile(r"[^A-Za-z0-9_-]")
_LETTER = re.compile("[A-Za-z]")
_KEYWORDS = {"T", "O", "R", "agents", "discount", "values", "states", "actions", "observations", "start"}
_KEYWORDS |= {"include", "exclude", "uniform", "identity", "reset", "reward", "rewards", "cost", "costs"}
_LARGEST = 20_000_000
_WIDE = 30
_FEW = 0.5


def read(path: str | Path, *, sparse: bool | None = None) -> MDP | POMDP:
    """Read a model: a POMDP if the file declares observations, else an MDP.

    Raises:
        FormatError: If the file is malformed, with the place and the expected form.
    """
    return _Reader(Source(path)).model(sparse)


def write(model: MDP, path: str | Path) -> None:
    """Write a model; joint states, actions and observations get joined names.

    Names that are not single words are changed, with a warning.

    Raises:
        ModelError: If the observations are events, or the model has observations and the file is a ``.mdp``.
        FormatError: If the file cannot be written.
    """
    if model.pomdp is not None and suffixes(path) == ".mdp":
        raise ModelError("an .mdp file cannot hold this POMDP's observations: write .pomdp")
    writer = StatementWriter(model, colon=" ")
    actions = Symbols.of(writer.joined(model.action_space), "a")
    lines = [f"discount: {model.discount!r}", "values: reward", f"states: {writer.states.declared}"]
    lines.append(f"actions: {actions.declared}")
    if model.observation_space is not None:
        observations = Symbols.of(writer.joined(model.observation_space), "o")
        lines += [f"observations: {observations.declared}", f"start: {writer.start()}"]
        lines += writer.statements(actions.words, observations.words)
    else:
        lines += [*_first_state(model, writer.states.words), *writer.statements(actions.words, None)]
    write_text(path, "\n".join(lines) + "\n")
    writer.warn("the format")


def _first_state(model: MDP, states: list[str]) -> list[str]:
    """Return the line for an MDP's start, which is a state or, without a line, uniform."""
    belief = model.initial_belief
    if (belief == 1 / len(belief)).all():
        return []
    if belief.max() == 1:
        return [f"start: {states[belief.argmax()]}"]
    text = "the file cannot hold an MDP's start distribution, and is read with a uniform one: write .npz or .pomdpx"
    warnings.warn(text, ModelWarning, stacklevel=4)
    return []


class _Reader:
    """Reads the preamble, then the statements."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._words = Words(source)
        if not self._words.words:
            source.fail("the file holds nothing but comments")
        self._sections = self._preamble()

    def _preamble(self) -> dict[str, tuple[int, int]]:
        """Return the span of each section's words; that of the statements is under ``""``."""
        words = self._words.words
        sections: dict[str, tuple[int, int]] = {}
        at = 0
        while at < len(words) and not self._begins_statement(at):
            key = words[at]
            begin = at + 2
            if key == "start" and words[at + 1 : at + 2] in (["include"], ["exclude"]):
                key, begin = f"start {words[at + 1]}", at + 3
            if words[begin - 1 : begin] != [":"] or key.split(maxsplit=1)[0] not in _KEYS:
                if key in _KEYS:
                    self._words.fail(at, f"a ':' was expected after {key!r}")
                expected = f"one of {', '.join(sorted(_KEYS))} or a statement was expected, not {key!r}"
                self._words.fail(at, foreign(key, _KEYS) or expected)
            at = begin
            while at < len(words) and not self._begins(at):
                wrong = foreign(words[at], _KEYS) if begins_foreign(words, at) else None
                if wrong is not None:
                    self._words.fail(at, wrong)
                at += 1
            name = "start" if key.startswith("start") else key
            sections[name] = (begin, at)
            if name == "start":
                self._start_key = key
        sections[""] = (at, len(words))
        return sections

    def _begins(self, at: int) -> bool:
        """Whether a section or statement begins at a word; a keyword counts only before a colon."""
        words = self._words.words
        if words[at] in _KEYS:
            listed = words[at] == "start" and words[at + 1 : at + 2] in (["include"], ["exclude"])
            return words[at + 1 : at + 2] == [":"] or (listed and words[at + 2 : at + 3] == [":"])
        return self._begins_statement(at)

    def _begins_statement(self, at: int) -> bool:
        words = self._words.words
        return words[at] in {"T", "O", "R"} and words[at + 1 : at + 2] == [":"]

    def _section(self, name: str) -> list[str]:
        begin, end = self._sections[name]
        return self._words.words[begin:end]

    def _fail(self, name: str, message: str, offset: int = 0) -> None:
        self._words.fail(self._sections[name][0] + offset, message)

    def _space(self, key: str, factor: str) -> Space:
        if key not in self._sections:
            self._source.fail(f"the file declares no {key}: a line such as '{key}: 2' is missing")
        names = self._section(key)
        if not names:
            self._fail(key, f"a number or names of {key} were expected")
        if len(names) == 1 and names[0].isdecimal():
            count = int(names[0])
            if not 0 < count <= LARGEST:
                self._fail(key, f"the number of {key} is {count}; 1 to {LARGEST} was expected")
            return Space.single(factor, count, prefix=key[0])
        for offset, name in enumerate(names):
            if name in {":", "*"}:
                self._fail(key, f"{name!r} is not a valid name among the {key}", offset)
        if (commas := check_commas(names, key)) is not None:
            remark(self._words.placed(self._sections[key][0], commas))
        if len(set(names)) < len(names):
            offset = next(index for index, name in enumerate(names) if name in names[:index])
            self._fail(key, f"{names[offset]!r} is named twice among the {key}", offset)
        return Space.single(factor, names)

    def _number(self, key: str) -> float:
        words = self._section(key)
        value = number(words[0]) if len(words) == 1 else None
        self._forgotten_colon(key, words)
        if value is None:
            self._fail(key, f"one number was expected for the {key}, not {' '.join(words[:5])!r}")
            raise AssertionError
        return value

    def _forgotten_colon(self, key: str, words: list[str]) -> None:
        for offset, word in enumerate(words[1:], 1):
            if word in _KEYS:
                self._fail(key, f"a ':' was expected after {word!r}", offset)

    def _discount(self) -> float:
        if "discount" not in self._sections:
            warnings.warn(f"{self._source.path}: no discount is given; it is read as 1", ModelWarning, stacklevel=4)
            return 1.0
        discount = self._number("discount")
        if not 0 < discount <= 1:
            self._fail("discount", f"a discount is more than 0 and at most 1, not {discount:g}")
        return discount

    def _sign(self) -> float:
        if "values" not in self._sections:
            warnings.warn(f"{self._source.path}: 'values' is missing; read as rewards", ModelWarning, stacklevel=4)
            return 1.0
        words = self._section("values")
        self._forgotten_colon("values", words)
        if len(words) != 1 or words[0] not in _SIGNS:
            self._fail("values", f"'reward' or 'cost' was expected for the values, not {' '.join(words[:5])!r}")
        return _SIGNS[words[0]]

    def _start(self, states: Space, *, is_mdp: bool) -> npt.NDArray[np.float64]:
        count = len(states)
        words = self._section("start")
        if not words:
            self._fail("start", "a distribution or states were expected for the start")
        if words == ["uniform"]:
            return np.full(count, 1 / count)
        if self._start_key == "start":
            values = [number(word) for word in words]
            as_numbers = len(words) == count and None not in values and (count > 1 or not is_mdp)
            if as_numbers and not (count == 1 and words[0] == "0"):
                return self._start_numbers([value for value in values if value is not None])
            if len(words) > 1 and None not in values:
                self._fail("start", f"the start needs {count} numbers, one for each state, not {len(words)}")
        chosen = np.zeros(count, dtype=bool)
        for offset, word in enumerate(words):
            try:
                chosen[states.index(word)] = True
            except ModelError as error:
                self._fail("start", f"{word!r} in the start: {error}", offset)
        if self._start_key == "start exclude":
            chosen = ~chosen
        if not chosen.any():
            self._fail("start", "the start leaves no state")
        return np.asarray(chosen / chosen.sum())

    def _start_numbers(self, values: list[float]) -> npt.NDArray[np.float64]:
        start = np.array(values)
        for offset, value in enumerate(values):
            if not value >= 0 or not np.isfinite(value):
                self._fail("start", f"{value:g} is not a probability", offset)
        if abs(start.sum() - 1) > TOLERANCE and not (start.sum() > 0 and is_collecting()):
            self._fail("start", f"the start sums to {start.sum():.6g}, not to 1")
        return start

    def model(self, sparse: bool | None) -> MDP | POMDP:
        """Return the model."""
        states = self._space("states", "state")
        actions = self._space("actions", "agent")
        observations = self._space("observations", "agent") if "observations" in self._sections else None
        discount, sign = self._discount(), self._sign()
        if "start" in self._sections:
            start = self._start(states, is_mdp=observations is None)
        else:
            remark("no start is given: every state is as likely")
            start = np.full(len(states), 1 / len(states))
        spaces = states, actions, observations
        at = self._sections[""][0]
        return build(self._source, self._words, at, spaces, discount, sign, start, sparse, field=self._field)

    def _field(self, at: int, words: list[str], space: Space, where: str) -> Field:
        word = words[0]
        if word == "*":
            return None
        try:
            return space.index(word)
        except ModelError as error:
            self._words.fail(at, unknown(word, where, error))


def build(
    source: Source,
    words: Words,
    at: int,
    spaces: tuple[Space, Space, Space | None],
    discount: float,
    sign: float,
    start: npt.NDArray[np.float64],
    sparse: bool | None,
    *,
    field: Callable[[int, list[str], Space, str], Field],
    colons: bool = False,
) -> MDP | POMDP:
    """Return the model that statements define, or fail with the actions that have none.

    Args:
        source: The file.
        words: Its words.
        at: The place of the first statement.
        spaces: The states, actions and observations.
        discount: The discount.
        sign: -1 where values are costs, else 1.
        start: The initial belief, S numbers.
        sparse: Force CSR (True) or dense (False) matrices; None chooses by size and density.
        field: See `Statements`.
        colons: See `Statements`; rows of O that were not given and that no transition reaches are then uniform, with a
            warning.
    """
    states, actions, observations = spaces
    try:
        statements = Statements(
            words,
            states=states,
            actions=actions,
            observations=observations,
            start=start,
            sign=sign,
            field=field,
            colons=colons,
        )
        statements.read(at)
        with placing(lambda error, _: statements.refuse(error)):
            return _made(source, statements, spaces, discount, start, sparse, fill=colons)
    except RowError as error:
        statements.refuse(error)
    except ModelError as error:
        raise FormatError(str(error), file=source.path) from None
    except MemoryError:
        source.fail("the model is too large for this machine's memory")


def _made(
    source: Source,
    statements: Statements,
    spaces: tuple[Space, Space, Space | None],
    discount: float,
    start: npt.NDArray[np.float64],
    sparse: bool | None,
    *,
    fill: bool,
) -> MDP | POMDP:
    states, actions, observations = spaces
    for letter, stack in (("T", statements.transitions), ("O", statements.observations)):
        for action in stack.missing() if stack is not None else []:
            problem = f"no {letter!r} statement is given for action {actions.names[action]!r}"
            if not report(problem):
                source.fail(problem)
            assert stack is not None
            stack.add(action, None, 0, 1.0)  # reported once, not for every row
    if is_collecting() and (lost := statements.rewards.overwritten()) is not None:
        pair = f"action {actions.names[lost[0]]!r} in state {states.names[lost[1]]!r}"
        remark(
            f"the reward of {pair} is given, and then again by a later statement for more that takes its place: "
            "statements count in their order, so put the general ones first"
        )
    if is_collecting() and (twice := statements.rewards.repeated()) is not None:
        action, state = twice
        where = "all states" if state is None else f"state {states.names[state]!r}"
        remark(
            f"the reward of action {actions.names[action]!r} in {where} is given twice by one entry: the last counts"
        )
    transitions = statements.transitions.matrices()
    common: dict[str, Any] = {
        "discount": discount,
        "states": states,
        "actions": actions,
        "initial_belief": start,
        "outcome_rewards": statements.rewards if statements.rewards.finer else None,
        "sparse": sparse,
    }
    if observations is None or statements.observations is None:
        return MDP(transitions, statements.rewards.expected(_normalised(transitions), None), **common)
    matrices = statements.observations.matrices()
    if fill:
        matrices = _filled(source, transitions, matrices)
    rewards = statements.rewards.expected(_normalised(transitions), _normalised(matrices))
    return POMDP(transitions, matrices, rewards, observation_names=observations, **common)


def _filled(source: Source, transitions: list[Any], observations: list[Any]) -> list[Any]:
    """Return the matrices of O with uniform rows for next states that are never reached and have none."""
    result, count = [], 0
    for transition, matrix in zip(transitions, observations, strict=True):
        empty = np.diff(matrix.indptr) == 0
        empty[transition.indices] = False
        count += int(empty.sum())
        if empty.any():
            rows, width = np.flatnonzero(empty), matrix.shape[1]
            starts = np.concatenate(([0], np.cumsum(empty))) * width
            columns = np.tile(np.arange(width), len(rows))
            result.append(csr(matrix + csr((np.full(len(columns), 1 / width), columns, starts), matrix.shape)))
        else:
            result.append(matrix)
    if count:
        text = f"{source.path}: {count} rows of O are not given, of next states that are never reached; read as uniform"
        warnings.warn(text, ModelWarning, stacklevel=7)
    return result


def _normalised(matrices: list[Any]) -> list[Any]:
    """Return the matrices for expected rewards, normalised while problems are collected instead of raised."""
    if not is_collecting():
        return matrices
    result = []
    for matrix in matrices:
        sums = np.asarray(matrix.sum(axis=1)).ravel()
        data = matrix.data / np.repeat(np.where(sums > 0, sums, 1.0), np.diff(matrix.indptr))
        result.append(csr((data, matrix.indices, matrix.indptr), matrix.shape))
    return result


class Symbols(NamedTuple):
    """The symbols of a space as a file has them.

    Attributes:
        declared: Their declaration: names, or their number where they have the names of their indices.
        words: The word of each of them in statements.
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
        if model.event_observations:
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
        if observations is not None and model.pomdp is not None:
            yield from self._matrices("O", model.pomdp.observation_matrix, actions, observations)
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
