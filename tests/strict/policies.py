"""Strict readers of policies: ``.alpha`` and ``.pg`` of pomdp-solve, MADP's, SARSOP's, ZMDP's, uBLAS text."""

from __future__ import annotations

import itertools
import re
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from strict.numbers import need, number


def alpha(path) -> tuple[list[int], Any]:
    """Read the actions and vectors of an ``.alpha``: an action, its numbers, a blank line."""
    return _blocks(path, r"\d+")


def value_function(path) -> tuple[list[int], Any]:
    """Read the actions and vectors of a ``.vf``: an action and -1, its numbers, a blank line."""
    return _blocks(path, r"\d+ -1")


def _blocks(path, head: str) -> tuple[list[int], Any]:
    text = path.read_text(encoding="ascii")
    need(text.endswith("\n\n"), "the last block has no blank line")
    actions, vectors = [], []
    for block in text.removesuffix("\n\n").split("\n\n"):
        lines = block.split("\n")
        need(len(lines) == 2, f"a block of {len(lines)} lines")
        need(re.fullmatch(head, lines[0]), f"{lines[0]!r} is no action")
        actions.append(int(lines[0].split()[0]))
        vectors.append([number(word) for word in lines[1].split(" ")])
    need(len({len(vector) for vector in vectors}) == 1, "vectors of different lengths")
    return actions, np.array(vectors)


def graph(path, num_observations: int) -> tuple[list[int], list[list[int | None]]]:
    """Read the actions and successors of a ``.pg``: a line per node."""
    actions, successors = [], []
    lines = path.read_text(encoding="ascii").removesuffix("\n").split("\n")
    for node, line in enumerate(lines):
        words = line.split()
        need(len(words) == 2 + num_observations and words[0] == str(node), f"node {node}: {line!r}")
        actions.append(int(words[1]))
        # pomdp-solve reads any word that is no number as one for an observation that cannot occur.
        after = [None if word in {"-", "X"} else int(word) for word in words[2:]]
        need(all(one is None or one < len(lines) for one in after), f"node {node} has an unknown successor")
        successors.append(after)
    return actions, successors


def sarsop(path) -> tuple[int, list[tuple[int, int, list[float]]]]:
    """Read the number of observed values and, for each vector, its action, its observed value and its numbers.

    SARSOP's program takes words from between the tags: the closing one must not touch the last number.
    """
    root = ET.parse(path).getroot()
    need(root.tag == "Policy" and root.get("type") == "value" and root.get("version") and root.get("model"), "the root")
    (head,) = root
    need(head.tag == "AlphaVector", head.tag)
    length, observed, count = (int(head.get(name)) for name in ("vectorLength", "numObsValue", "numVectors"))
    need(len(head) == count > 0, "the number of vectors")
    found = []
    for vector in head:
        need(vector.tag == "Vector" and vector.text.endswith(" "), "a vector")
        values = [number(word) for word in vector.text.split()]
        need(len(values) == length, "a vector's length")
        found.append((int(vector.get("action")), int(vector.get("obsValue")), values))
    need(all(0 <= seen < observed for _, seen, _ in found), "an observed value")
    return observed, found


def ublas(path) -> Any:
    """Read a vector or matrix as boost writes and reads it, without blanks or trailing commas."""
    text = path.read_text(encoding="ascii").removesuffix("\n")
    head, body = text.split("]", 1)
    sizes = [int(size) for size in head.removeprefix("[").split(",")]
    need(head.startswith("[") and body.startswith("(") and body.endswith(")"), "brackets")
    if len(sizes) == 1:
        rows = [body]
    else:
        need(body.startswith("((") and body.endswith("))"), "brackets")
        rows = body[1:-1].replace("),(", ")\n(").split("\n")
        need(len(rows) == sizes[0], "the number of rows")
    values = [[number(word) for word in row[1:-1].split(",")] for row in rows]
    need(all(len(row) == sizes[-1] for row in values), "the length of rows")
    return np.array(values[0] if len(sizes) == 1 else values)


PLANES = ["{", '  policyType => "MaxPlanesLowerBound",', "  numPlanes => ", "  planes => ["]
PLANE = ["    {", "      action => ", "      numEntries => ", "      entries => ["]


def planes(path) -> list[tuple[int, dict[int, float]]]:
    """Read the action and the values of each of ZMDP's planes, whose program takes a line at a time."""
    text = path.read_text(encoding="ascii")
    need(text.endswith("\n"), "the last line has no end")
    lines = iter(text.removesuffix("\n").split("\n"))

    def take(*expected: str) -> list[int]:
        """Take lines, of which some end with a number."""
        numbers = []
        for beginning in expected:
            line = next(lines, "")
            rest = line.removeprefix(beginning)
            need(line.startswith(beginning) and re.fullmatch(r"(\d+,)?", rest), f"{line!r}: {beginning!r} was expected")
            numbers += [int(rest[:-1])] if rest else []
        return numbers

    (count,) = take(*PLANES)
    found = []
    for place in range(count):
        action, size = take(*PLANE)
        values: dict[int, float] = {}
        for entry in range(size):
            comma = "" if entry == size - 1 else ","
            match = re.fullmatch(rf"        (\d+), ([^ ,]+){comma}", line := next(lines, ""))
            need(match and int(match[1]) not in values, f"{line!r} is no entry")
            values[int(match[1])] = number(match[2])
        need(
            [next(lines, ""), next(lines, "")] == ["      ]", "    }" + "," * (place < count - 1)], "the end of a plane"
        )
        found.append((action, values))
    need([*lines] == ["  ]", "}"], "the end")
    return found


def joint(path, actions: list[list[str]], observations: list[list[str]]) -> list[dict[tuple[str, ...], str]]:
    """Read each agent's action after each of its histories, as MADP prints them: all histories of a length in order.

    The index of a policy has an agent's actions as its digits, the first history's the most significant.
    """
    lines = path.read_text(encoding="ascii").removesuffix("\n").split("\n")
    need(lines[0] == "JointPolicyPureVector: ", "the head")
    total = re.fullmatch(r"JPolComponent_VectorImplementation index (\d+)", lines[1])
    need(total, "the index of the joint policy")
    at, found, joined = 2, [], 0
    for agent, (choices, words) in enumerate(zip(actions, observations, strict=True)):
        head = re.fullmatch(rf"Policy for agent {agent} \(index (\d+)\):", lines[at])
        need(head, lines[at])
        at += 1
        told: dict[tuple[str, ...], str] = {}
        index, longest = 0, 0
        expected = itertools.chain.from_iterable(itertools.product(words, repeat=size) for size in itertools.count())
        while at < len(lines) and not lines[at].startswith("Policy"):
            match = re.fullmatch(r"\(([^()]*)\) --> (.+)", lines[at])
            need(match and match[2] in choices, lines[at])
            history = tuple(match[1].split(",")) if match[1] else ()
            need(history == next(expected), f"{history} stands in another's place")
            told[history] = match[2]
            index, longest, at = index * len(choices) + choices.index(match[2]), len(history), at + 1
        need(len(told) == sum(len(words) ** size for size in range(longest + 1)), "not all histories of a length")
        need(index % 2**64 == int(head[1]), f"the index of agent {agent}")
        joined = joined * len(choices) ** len(told) + index
        found.append(told)
    need(at == len(lines) and joined % 2**64 == int(total[1]), "the index of the joint policy")
    return found
