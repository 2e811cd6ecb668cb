"""A strict reader of ``.dpomdp``, as MADP reads it.

Sections come in one order, each agent's actions and observations on a line of their own. Every field ends with a colon.
What is only counted has no name; the joint action or observation of a single agent is an index or ``*``. Distributions
sum to 1 within 5e-13.
"""

from __future__ import annotations

import itertools
import re
from typing import Any

import numpy as np

from strict.numbers import NAME, Numbers, need, number, sums

PRECISION = 5e-13
WORDS = {"agents", "discount", "values", "states", "start", "actions", "observations", "T", "O", "R"}
WORDS |= {"uniform", "identity", "include", "exclude", "reward", "cost"}


def read(path) -> Numbers:
    """Read a team's model."""
    return _Reader(path.read_text(encoding="ascii")).numbers()


class _Reader:
    def __init__(self, text: str) -> None:
        lines = (line.split("#", 1)[0].strip() for line in text.split("\n"))
        self.lines = [line for line in lines if line]
        self.at = 0

    def line(self, key: str = "") -> str:
        need(self.at < len(self.lines), "the file ends too early")
        line = self.lines[self.at]
        need(line.startswith(key), f"{key!r} was expected, not {line!r}")
        self.at += 1
        return line.removeprefix(key).strip()

    def names(self, words: list[str]) -> tuple[int, dict[str, int]]:
        need(words, "no names")
        if len(words) == 1 and words[0].isdecimal():
            need(int(words[0]) > 0, "a count of 0")
            return int(words[0]), {}
        for word in words:
            need(NAME.fullmatch(word) and word not in WORDS, f"{word!r} is no name")
        need(len(set(words)) == len(words), "a name is given twice")
        return len(words), {word: index for index, word in enumerate(words)}

    def numbers(self) -> Numbers:
        self.agents, _ = self.names(self.line("agents:").split())
        discount = number(self.line("discount:"))
        values = self.line("values:")
        need(0 < discount <= 1 and values in {"reward", "cost"}, "discount and values")
        self.states = self.names(self.line("states:").split())
        size = self.states[0]
        need(self.line("start:") == "", "the start is on the line below")
        words = self.line().split()
        start = np.full(size, 1 / size) if words == ["uniform"] else np.array([number(word) for word in words])
        need(len(start) == size, "a start of another length")
        sums(start, PRECISION, "the start")
        spaces = {}
        for key in ("actions", "observations"):
            need(self.line(f"{key}:") == "", f"the {key} are on the lines below")
            spaces[key] = [self.names(self.line().split()) for _ in range(self.agents)]
        self.actions, self.observations = spaces["actions"], spaces["observations"]
        count, width = (int(np.prod([one for one, _ in each])) for each in spaces.values())
        transitions, observations = np.zeros((count, size, size)), np.zeros((count, size, width))
        statements = []
        while self.at < len(self.lines):
            kind, *fields = (part.strip() for part in self.line().split(":"))
            if kind == "R":
                need(len(fields) == 5, "a reward is of an action, a state, a next state and an observation")
                places = [self.joint(fields[0], self.actions), self.state(fields[1]), self.state(fields[2])]
                statements.append((*places, self.joint(fields[3], self.observations), number(fields[4])))
            else:
                need(kind in {"T", "O"}, f"a statement was expected, not {kind!r}")
                self.probabilities(kind, fields, transitions if kind == "T" else observations)
        sums(transitions, PRECISION, "T")
        sums(observations, PRECISION, "O")
        every = [list(range(length)) for length in (count, size, size, width)]
        axes = [any(one[axis] != full for one in statements) for axis, full in enumerate(every)]
        rewards = np.zeros([len(full) if named else 1 for full, named in zip(every, axes, strict=True)])
        for *places, value in statements:
            chosen = [place if named else [0] for place, named in zip(places, axes, strict=True)]
            rewards[np.ix_(*chosen)] = value
        rewards = np.broadcast_to(rewards if values == "reward" else -rewards, (count, *rewards.shape[1:]))
        return Numbers(discount, start, transitions, observations[:, None], rewards)

    def index(self, word: str, space: tuple[int, dict[str, int]]) -> int:
        size, names = space
        if word.isdecimal():
            need(int(word) < size, f"{word} is beyond {size}")
            return int(word)
        need(word in names, f"{word!r} is unknown")
        return names[word]

    def state(self, word: str) -> list[int]:
        return list(range(self.states[0])) if word == "*" else [self.index(word, self.states)]

    def joint(self, field: str, spaces: list[tuple[int, dict[str, int]]]) -> list[int]:
        sizes = [size for size, _ in spaces]
        total = int(np.prod(sizes))
        words = field.split()
        if words == ["*"]:
            return list(range(total))
        if len(words) == 1:
            need(re.fullmatch(r"\d+", words[0]) and int(words[0]) < total, f"{words[0]!r} is no joint index")
            return [int(words[0])]
        need(len(words) == len(spaces), f"a word for each of {len(spaces)} agents, not {field!r}")
        each = [
            list(range(space[0])) if word == "*" else [self.index(word, space)]
            for word, space in zip(words, spaces, strict=True)
        ]
        return [int(np.ravel_multi_index(one, sizes)) for one in itertools.product(*each)]

    def probabilities(self, kind: str, fields: list[str], array: Any) -> None:
        actions = self.joint(fields[0], self.actions)
        rows, width = array.shape[1:]
        if len(fields) == 4:
            column = self.state(fields[2]) if kind == "T" else self.joint(fields[2], self.observations)
            array[np.ix_(actions, self.state(fields[1]), column)] = number(fields[3])
        elif len(fields) == 3:
            need(fields[2] == "", "a row is on the line below")
            line = self.line()
            row = np.full(width, 1 / width) if line == "uniform" else [number(word) for word in line.split()]
            need(len(row) == width, "a row of another length")
            array[np.ix_(actions, self.state(fields[1]))] = row
        else:
            need(len(fields) == 2 and fields[1] == "", "a matrix is on the lines below")
            line = self.line()
            if line == "uniform":
                array[actions] = 1 / width
            elif line == "identity":
                need(kind == "T", "'identity' after O")
                array[actions] = np.eye(rows)
            else:
                matrix = [[number(word) for word in line.split()]]
                matrix += [[number(word) for word in self.line().split()] for _ in range(rows - 1)]
                need({len(row) for row in matrix} == {width}, "a row of another length")
                array[actions] = matrix
