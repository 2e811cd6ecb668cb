"""Cassandra's ``.pg`` format: policy graphs.

A node is its index, its action and its successor for each observation (``X`` or ``-`` for an impossible one), usually
on one line. The ``.alpha`` file of the same name, which solvers write beside it, holds each node's values as a vector,
in the same order.

The successors in a finite-horizon graph are nodes of another file, the graph of one step less. Such a graph is refused
only if an index exceeds its own nodes.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mdm.formats.cassandra import alpha
from mdm.formats.source import Source
from mdm.formats.target import replacing, write_text
from mdm.policies import FiniteStateController

if TYPE_CHECKING:
    from collections.abc import Iterator

_IMPOSSIBLE = frozenset("Xx-")


def read(
    path: str | Path, *, num_actions: int | None = None, num_observations: int | None = None
) -> FiniteStateController:
    """Read a policy graph, with the values from the ``.alpha`` file of the same name if there is one.

    Args:
        path: The file.
        num_actions: The model's number of actions, if known.
        num_observations: The model's number of observations, if known; by default that of the first line.

    Raises:
        FormatError: If the file is malformed, with the line and the expected form.
    """
    source = Source(path)
    rows = list(_rows(source, num_observations))
    actions: list[int] = []
    successors: list[list[int | None]] = []
    for node, (line, row) in enumerate(rows):
        for word in row:
            if not word.isdecimal() and (word not in _IMPOSSIBLE or word in row[:2]):
                source.fail(f"node {node}: {word[:40]!r} is not an index", line=line)
        if row[0] != str(node):
            source.fail(f"node {node} was expected, not {row[0][:40]}", line=line)
        actions.append(alpha.action_index(source, line, row[1], num_actions))
        successors.append([_successor(source, line, node, word, len(rows)) for word in row[2:]])
    graph = source.path.with_suffix("") if source.path.suffix.lower() == ".gz" else source.path
    companion = graph.with_suffix(".alpha")
    if companion == graph or not companion.is_file():
        return FiniteStateController(actions, successors, num_actions)
    vectors, of = alpha.read_in_order(companion, num_actions=num_actions)
    if of != actions:
        source.fail(
            f"the graph's {len(actions)} nodes do not match the {len(of)} vectors of {companion.name} in number or "
            "actions: rename or move the file that does not belong to the other"
        )
    return FiniteStateController(actions, successors, num_actions, values=vectors)


def write(controller: FiniteStateController, path: str | Path) -> None:
    """Write a policy graph, and its nodes' values, if known, to an ``.alpha`` file beside it.

    Neither file is replaced before both are written.
    """
    rows = zip(controller.actions, controller.successors, strict=True)
    lines = (
        f"{node} {action}  {' '.join('X' if after is None else str(after) for after in row)}\n"
        for node, (action, row) in enumerate(rows)
    )
    with replacing(path) as file:
        file.write("".join(lines).encode())
        file.flush()  # notices a full disk before the values are replaced
        if controller.values is not None:
            text = alpha.lines(np.asarray(controller.values), controller.actions)
            write_text(Path(path).with_suffix(".alpha"), text)


def _rows(source: Source, num_observations: int | None) -> Iterator[tuple[int, list[str]]]:
    """Yield each node's first line and its words, which may span lines."""
    row: list[str] = []
    begin = count = 0
    width = None if num_observations is None else num_observations + 2
    for line, text in enumerate(source.text.split("\n"), 1):
        words = text.split()
        if not words:
            continue
        if not row:
            begin = line
        row += words
        if width is None:
            width = max(len(row), 3)
        if len(row) > width:
            node = f"node {count}"
            source.fail(
                f"{node}: a successor for each of {width - 2} observations was expected, but {len(row) - 2} are given",
                line=begin,
            )
        if len(row) == width:
            yield begin, row
            row = []
            count += 1
    if row:
        expected = 1 if width is None else width - 2
        source.fail(
            f"node {count}: a successor for each of {expected} observations was expected, but the file ends "
            f"after {max(len(row) - 2, 0)}",
            line=begin,
        )


def _successor(source: Source, line: int, node: int, word: str, num_nodes: int) -> int | None:
    if word in _IMPOSSIBLE:
        return None
    if len(word) > 20 or int(word) >= num_nodes:
        source.fail(
            f"node {node} has the successor {word[:40]}, but the graph has nodes 0 to {num_nodes - 1} (the graph of a "
            "finite horizon continues in another file and is not a policy by itself)",
            line=line,
        )
    return int(word)
