"""Strict readers of policies: ``.alpha`` and ``.pg`` of pomdp-solve, ``.vf`` of MADP, SARSOP's, uBLAS text."""

from __future__ import annotations

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
