"""A strict reader of ``.pomdp`` and ``.mdp``, as pomdp-solve and SARSOP read them.

A symbol that is only counted has no name. ``identity`` is a matrix of T alone. An MDP's start is a state, or not
given. A name begins with a letter and is no word of the grammar.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from strict.numbers import NAME, NUMBER, Numbers, need, number, sums

TOKEN = re.compile(rf"\s*(?:#[^\n]*|({NAME.pattern}|{NUMBER.pattern.removeprefix('[+-]?')}|[:*+-]))")
SECTIONS = {"discount", "values", "states", "actions", "observations", "start"}
WORDS = SECTIONS | {"include", "exclude", "uniform", "identity", "reset", "reward", "cost", "T", "O", "R"}
PRECISION = 1e-5


def read(path, *, mdp: bool) -> Numbers:
    """Read a model."""
    return _Reader(path.read_text(encoding="ascii"), mdp).numbers()


class _Reader:
    def __init__(self, text: str, mdp: bool) -> None:
        self.mdp = mdp
        self.tokens: list[str] = []
        at = 0
        text = text.rstrip()
        while at < len(text):
            found = TOKEN.match(text, at)
            need(found, f"unknown characters: {text[at : at + 20]!r}")
            at = found.end()
            if found[1]:
                self.tokens.append(found[1])
        self.at = 0
        self.spaces: dict[str, tuple[int, dict[str, int]]] = {}

    def peek(self, ahead: int = 0) -> str:
        return self.tokens[self.at + ahead] if self.at + ahead < len(self.tokens) else ""

    def take(self, expected: str = "") -> str:
        token = self.peek()
        need(token, "the file ends too early")
        need(not expected or token == expected, f"{expected!r} was expected, not {token!r}")
        self.at += 1
        return token

    def real(self) -> float:
        sign = -1 if self.peek() == "-" else 1
        if self.peek() in "+-":
            self.take()
        return sign * number(self.take())

    def names(self, key: str) -> None:
        self.take(key)
        self.take(":")
        names = []
        if self.peek().isdecimal():
            count = int(self.take())
            need(count > 0, f"no {key}")
            self.spaces[key] = count, {}
            return
        while NAME.fullmatch(self.peek()) and self.peek() not in WORDS:
            names.append(self.take())
        need(names, f"no {key}")
        need(len(set(names)) == len(names), f"a name is given twice among the {key}")
        self.spaces[key] = len(names), {name: index for index, name in enumerate(names)}

    def symbol(self, key: str) -> int | slice:
        size, names = self.spaces[key]
        token = self.take()
        if token == "*":
            return slice(None)
        if token.isdecimal():
            need(int(token) < size, f"{token} is beyond the {size} {key}")
            return int(token)
        need(token in names, f"{token!r} is none of the {key}")
        return names[token]

    def numbers(self) -> Numbers:
        given: dict[str, Any] = {}
        while self.peek() in SECTIONS - {"start"}:
            key = self.peek()
            need(key not in given, f"{key!r} is given twice")
            given[key] = None
            if key in {"discount", "values"}:
                self.take()
                self.take(":")
                given[key] = self.real() if key == "discount" else self.take()
            else:
                self.names(key)
        need(0 < given["discount"] <= 1, "the discount")
        need(given["values"] in {"reward", "cost"}, "the values")
        need(("observations" in given) != self.mdp, "observations, or none in an MDP")
        self.sizes = [self.spaces[key][0] for key in ("actions", "states")]
        start = self.start()
        count, size = self.sizes
        width = 1 if self.mdp else self.spaces["observations"][0]
        transitions = np.zeros((count, size, size))
        observations = np.zeros((count, size, width))
        statements = []
        while self.at < len(self.tokens):
            kind = self.take()
            need(kind in {"T", "O", "R"}, f"a statement was expected, not {kind!r}")
            self.take(":")
            if kind == "R":
                statements.append(self.reward())
            else:
                need(kind == "T" or not self.mdp, "O in an MDP")
                self.probabilities(kind, transitions if kind == "T" else observations, start)
        sums(transitions, PRECISION, "T")
        if not self.mdp:
            sums(observations, PRECISION, "O")
        axes = [any(one[0][axis] != slice(None) or np.ndim(one[1]) for one in statements) for axis in range(4)]
        shape = [full if named else 1 for full, named in zip((count, size, size, width), axes, strict=True)]
        rewards = np.zeros(shape)
        for places, value in statements:
            rewards[places] = value
        sign = 1 if given["values"] == "reward" else -1
        seen = None if self.mdp else observations[:, None]
        return Numbers(
            given["discount"], start, transitions, seen, np.broadcast_to(sign * rewards, (count, *shape[1:]))
        )

    def start(self) -> Any:
        size = self.sizes[1]
        if self.peek() != "start":
            return np.full(size, 1 / size)
        self.take()
        form = self.take() if self.peek() in {"include", "exclude"} else "start"
        self.take(":")
        if form == "start" and self.peek() == "uniform":
            need(not self.mdp, "a start distribution in an MDP")
            self.take()
            return np.full(size, 1 / size)
        chosen = np.zeros(size)
        if form == "start":
            listed = [self.peek(ahead) for ahead in range(size)]
            if not self.mdp and all(NUMBER.fullmatch(word) for word in listed):
                start = np.array([self.real() for _ in range(size)])
                sums(start, PRECISION, "the start")
                return start
            chosen[self.symbol("states")] = 1
            need(self.peek() in {"T", "O", "R", ""}, "more than one state in the start")
            return chosen
        need(not self.mdp, "several states of an MDP's start")
        while self.peek() not in {"T", "O", "R", ""}:
            need(self.peek() != "*", "'*' in the start")
            chosen[self.symbol("states")] = 1
        chosen = 1 - chosen if form == "exclude" else chosen
        need(chosen.any(), "no state in the start")
        return chosen / chosen.sum()

    def probabilities(self, kind: str, array: Any, start: Any) -> None:
        columns = "states" if kind == "T" else "observations"
        action = self.symbol("actions")
        if self.peek() != ":":
            rows, width = array.shape[1:]
            if self.peek() == "uniform":
                self.take()
                array[action] = 1 / width
            elif self.peek() == "identity":
                need(kind == "T", "'identity' after O")
                self.take()
                array[action] = np.eye(rows)
            else:
                array[action] = np.array([self.real() for _ in range(rows * width)]).reshape(rows, width)
            return
        self.take(":")
        row = self.symbol("states")
        if self.peek() == ":":
            self.take()
            column = self.symbol(columns)
            array[action, row, column] = self.real()
        elif self.peek() == "uniform":
            self.take()
            array[action, row] = 1 / array.shape[2]
        elif self.peek() == "reset":
            need(kind == "T", "'reset' after O")
            self.take()
            array[action, row] = start
        else:
            array[action, row] = [self.real() for _ in range(array.shape[2])]

    def reward(self) -> tuple[tuple[Any, ...], Any]:
        keys = ["actions", "states", "states"] + ([] if self.mdp else ["observations"])
        places: list[Any] = []
        for key in keys:
            places.append(self.symbol(key))
            if self.peek() == ":":
                self.take()
            else:
                break
        rest = keys[len(places) :]
        need(len(places) >= (1 if self.mdp else 2), "a reward of nothing")
        shape = [self.spaces[key][0] for key in rest]
        values = np.array([self.real() for _ in range(int(np.prod(shape)))]).reshape(shape)
        if self.mdp and rest:
            values = values[..., None]
        places += [slice(None)] * (4 - len(places))
        return tuple(places), values if rest else float(values)
