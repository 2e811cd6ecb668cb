"""MADP's ``.dpomdp`` format: Dec-POMDPs, read as POMDPs over joint actions and observations.

It differs from Cassandra's format in three points: actions and observations are declared on one line per agent, a
field for a joint symbol has a word per agent, and every field ends with a colon.
"""

from __future__ import annotations

import math
import re
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from mdm.errors import FormatError, ModelError
from mdm.formats.cassandra.model import StatementWriter, Symbols, build
from mdm.formats.cassandra.statements import Field, check_commas, foreign, unknown
from mdm.formats.source import LARGEST, Source, Words, number
from mdm.formats.target import write_text
from mdm.models import POMDP, Space
from mdm.models.matrices import TOLERANCE
from mdm.models.space import Factor
from mdm.models.validation import is_collecting, remark

if TYPE_CHECKING:
    from pathlib import Path
    from typing import NoReturn

    from mdm.models import MDP

_KEY = re.compile(r"(agents|discount|values|states|start(?:\s+(?:include|exclude))?|actions|observations)\s*:(.*)")
_SECTIONS = ("agents", "discount", "values", "states", "start", "actions", "observations")
_STATEMENT = re.compile(r"[TOR]\s*:")
_SIGNS = {"reward": 1.0, "rewards": 1.0, "cost": -1.0, "costs": -1.0}


def read(path: str | Path, *, sparse: bool | None = None) -> POMDP:
    """Read a Dec-POMDP as the POMDP over its joint actions and observations.

    Raises:
        FormatError: If the file is malformed, with the place and the expected form.
    """
    return _Reader(Source(path)).model(sparse)


def write(model: MDP, path: str | Path) -> None:
    """Write a team's model, with a line of actions and one of observations per agent.

    Names that are not single words are changed, with a warning.

    Raises:
        ModelError: If the model has no observations, has not one observation factor per agent, or its observations are
            events.
        FormatError: If the file cannot be written.
    """
    if model.observation_space is None:
        raise ModelError("a .dpomdp file needs observations, and an MDP has none: write .mdp")
    agents = [factor.name for factor in model.action_space.factors]
    if len(model.observation_space.factors) != len(agents):
        raise ModelError(
            f"a .dpomdp file needs one observation factor per agent, but the model has {len(agents)} agents and "
            f"{len(model.observation_space.factors)} observation factors: write .pomdp"
        )
    writer = StatementWriter(model, colon=" : ")
    named = Symbols.of(writer.spell(agents), "agent")
    lines = [f"agents: {named.declared}", f"discount: {model.discount!r}", "values: reward"]
    lines += [f"states: {writer.states.declared}", "start:", writer.start()]
    joint = []
    for key, space in (("actions", model.action_space), ("observations", model.observation_space)):
        symbols = [Symbols.of(writer.spell(factor.names), key[0]) for factor in space.factors]
        lines += [f"{key}:", *(each.declared for each in symbols)]
        if len(symbols) == 1:  # a single word is the index of a joint symbol, for MADP
            symbols = [symbols[0].by_index()]
        joint.append([" ".join(words) for words in product(*(each.words for each in symbols))])
    lines += writer.statements(*joint)
    write_text(path, "\n".join(lines) + "\n")
    writer.warn("the format")


class _Reader:
    """Reads the preamble by lines, then the statements by words."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._sections: dict[str, list[tuple[int, str]]] = {}
        self._body = len(source.text.split("\n"))
        key: str | None = None
        for number_, raw in enumerate(source.text.split("\n"), 1):
            line = raw.split("#", 1)[0].strip()
            if _STATEMENT.match(line):
                self._body = number_
                break
            match = _KEY.fullmatch(line)
            if match:
                key = " ".join(match[1].split())
                self._sections[key] = []
                line = match[2].strip()
            elif line and key is None:
                self._fail(number_, f"'agents:' or another section was expected, not {line.split()[0]!r}")
            word, colon, _ = line.partition(":")
            wrong = foreign(word.strip(), _SECTIONS) if colon else None
            if wrong is not None or colon:
                self._fail(number_, wrong or f"there is no section {word.strip()!r}: {', '.join(_SECTIONS)} are read")
            if line and key is not None:
                self._sections[key].append((number_, line))

    def _fail(self, line: int | None, message: str) -> NoReturn:
        self._source.fail(message, line=line)

    def _one(self, key: str, expected: str) -> tuple[int, list[str]]:
        """Return the words of a required section, and its first line."""
        lines = self._sections.get(key)
        if not lines:
            self._fail(None, f"the file has no {key!r} section: {expected} was expected after '{key}:'")
        return lines[0][0], [word for _, line in lines for word in line.split()]

    def _names(self, line: int, words: list[str], what: str) -> list[str] | int:
        if len(words) == 1 and words[0].isdecimal():
            if not 0 < int(words[0]) <= LARGEST:
                self._fail(line, f"the number of {what} is {words[0]}; 1 to {LARGEST} was expected")
            return int(words[0])
        for index, word in enumerate(words):
            if word in words[:index]:
                self._fail(line, f"{word!r} is named twice among the {what}")
        if (commas := check_commas(words, what)) is not None:
            remark(str(FormatError(commas, file=self._source.path, line=line)))
        return words

    def _per_agent(self, key: str, agents: list[str]) -> Space:
        lines = self._sections.get(key)
        if not lines:
            self._fail(None, f"the file has no {key!r} section")
        if len(lines) != len(agents):
            self._fail(
                lines[-1][0],
                f"the {key} of {len(agents)} agents need a line per agent, but {len(lines)} are given",
            )
        named = [
            self._names(line, text.split(), f"{key} of agent {agent!r}")
            for agent, (line, text) in zip(agents, lines, strict=True)
        ]
        joint = math.prod(names if isinstance(names, int) else len(names) for names in named)
        if joint > LARGEST:
            self._fail(lines[0][0], f"{joint} joint {key} exceed the limit of {LARGEST}")
        return Space(Factor(agent, names, prefix=key[0]) for agent, names in zip(agents, named, strict=True))

    def _start(self, states: Space) -> npt.NDArray[np.float64]:
        count = len(states)
        key = next((key for key in self._sections if key.startswith("start")), None)
        if key is None:
            return np.full(count, 1 / count)
        line, words = self._one(key, "'uniform', a number for each state, or a state")
        if key == "start":
            if words == ["uniform"]:
                return np.full(count, 1 / count)
            values = [number(word) for word in words]
            if None not in values and (len(words) > 1 or "." in words[0] or count == 1):
                return self._start_numbers(line, np.array(values, dtype=np.float64), count)
        chosen = np.zeros(count, dtype=bool)
        for word in words:
            try:
                chosen[states.index(word)] = True
            except ModelError as error:
                self._fail(line, f"the start names {word!r}: {error}")
        if key == "start exclude":
            chosen = ~chosen
        if not chosen.any():
            self._fail(line, "the start leaves no state")
        return np.asarray(chosen / chosen.sum())

    def _start_numbers(self, line: int, start: npt.NDArray[np.float64], count: int) -> npt.NDArray[np.float64]:
        if len(start) != count:
            self._fail(line, f"the start needs {count} numbers, one for each state, not {len(start)}")
        wrong = not (np.isfinite(start).all() and (start >= 0).all())
        if wrong or (abs(start.sum() - 1) > TOLERANCE and not (start.sum() > 0 and is_collecting())):
            self._fail(line, f"the start is not a distribution: it sums to {start.sum():.6g}")
        return start

    def model(self, sparse: bool | None) -> POMDP:
        """Return the model."""
        line, words = self._one("agents", "a number or names")
        named = self._names(line, words, "agents")
        agents = [f"agent{index}" for index in range(named)] if isinstance(named, int) else named
        line, words = self._one("discount", "a number")
        discount = number(words[0]) if len(words) == 1 else None
        if discount is None or not 0 < discount <= 1:
            self._fail(line, f"a discount is more than 0 and at most 1, not {' '.join(words)}")
        line, words = self._one("values", "'reward' or 'cost'")
        if len(words) != 1 or words[0] not in _SIGNS:
            self._fail(line, f"'reward' or 'cost' was expected for the values, not {' '.join(words)!r}")
        sign = _SIGNS[words[0]]
        line, words = self._one("states", "a number or names")
        states = Space.single("state", self._names(line, words, "states"), prefix="s")
        actions = self._per_agent("actions", agents)
        observations = self._per_agent("observations", agents)
        start = self._start(states)
        self._words = Words(self._source, skip=self._body - 1)
        spaces = states, actions, observations
        model = build(
            self._source, self._words, 0, spaces, discount, sign, start, sparse, field=self._field, colons=True
        )
        assert isinstance(model, POMDP)
        return model

    def _field(self, at: int, words: list[str], space: Space, where: str) -> Field:
        if words == ["*"]:
            return None
        text, kind = " ".join(words), where[0]
        try:
            if len(space.factors) == 1 or (len(words) == 1 and words[0].isdecimal()):
                if len(words) == 1:
                    return space.index(words[0])
                self._words.fail(at, f"{text!r} in this {kind!r} statement: one symbol was expected")
            if len(words) != len(space.factors):
                self._words.fail(
                    at,
                    f"{text!r} in this {kind!r} statement: a word for each of {len(space.factors)} agents was expected",
                )
            chosen = [
                range(len(factor)) if word == "*" else (factor.index(word),)
                for word, factor in zip(words, space.factors, strict=True)
            ]
        except ModelError as error:
            several = len(space.factors) > 1
            self._words.fail(
                at, f"{text!r} in this {kind!r} statement: {error}" if several else unknown(text, where, error)
            )
        indices = [space.ravel(components) for components in product(*chosen)]
        return indices[0] if len(indices) == 1 else indices
