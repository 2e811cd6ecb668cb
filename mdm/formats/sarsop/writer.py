"""Writing POMDPX as SARSOP reads it: tables and trees as entries, and no links that it refuses.

Of state factors only hidden ones may depend on others of the same slice, and these must be fully observed; no
observation depends on another.
"""

from __future__ import annotations

import math
import re
import warnings
from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ModelError, ModelWarning
from mdm.formats.markup import escape, quoted
from mdm.formats.target import write_text
from mdm.formats.writers import Speller, initial, unused, utilities
from mdm.models.factored.factoring import as_network, joined, unlinked
from mdm.models.factored.two_slice import Node, Potential, Table, tabulated

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from mdm.models import MDP, TwoSliceNetwork
    from mdm.models.factored.two_slice import Role

__all__ = ["write"]

_FOREIGN = re.compile("[\\s\x00-\x1f\ud800-\udfff\ufffe\uffff]")
_MANY = 1000
_FEW = 0.3
_ELEMENTS: tuple[tuple[Role, str, str], ...] = (
    ("state", "StateVar", "s"),
    ("action", "ActionVar", "a"),
    ("observation", "ObsVar", "o"),
)
_SECTIONS: tuple[tuple[Role, str], ...] = (
    ("state", "InitialStateBelief"),
    ("next_state", "StateTransitionFunction"),
    ("observation", "ObsFunction"),
)


def write(model: MDP, path: str | Path) -> None:
    """Write a model as POMDPX; a flat model is factored by the chain rule over its spaces' factors.

    Names that are not single words are changed, with a warning. Variables get unique names. An MDP is written as a
    model whose factors are all fully observed. State factors or observations that depend on each other in ways that
    SARSOP does not read are joined into one, with a warning.

    Raises:
        ModelError: If observations are events, which POMDPX lacks, or the model is too large for tables.
        FormatError: If the file cannot be written.
    """
    network = as_network(model)
    if network.event_observations:
        raise ModelError(
            "POMDPX cannot hold observations of events, P(o | s, a, s'): write .pgmx, or an archive (.npz)"
        )
    document = _Document(_without_links(network))
    write_text(path, "\n".join(document.lines(model.discount)) + "\n")
    document.speller.warn("POMDPX")


def _without_links(network: TwoSliceNetwork) -> TwoSliceNetwork:
    """Return a network without links that SARSOP refuses."""
    free = unlinked(network, "observation")
    if free is None:
        _warn(f"the {len(network.observation)} observations depend on each other; for SARSOP they are joined into one")
        free = joined(network, "observations")
    if _has_readable_states(free):
        return free
    other = unlinked(free, "next_state")
    if other is not None:
        return other
    seen = _observed(free)
    if any(seen) and not all(seen):
        _warn("state factors depend on others of the same slice, some of them hidden: SARSOP does not read this file")
        return free
    _warn(f"the {len(seen)} state factors depend on each other; for SARSOP they are joined into one")
    return joined(free, "states")


def _warn(text: str) -> None:
    warnings.warn(text, ModelWarning, stacklevel=5)


def _observed(network: TwoSliceNetwork) -> tuple[bool, ...]:
    """Return for each state factor whether it is written as fully observed."""
    return network.fully_observed if network.observations is not None else (True,) * len(network.states.factors)


def _has_readable_states(network: TwoSliceNetwork) -> bool:
    seen = _observed(network)
    links = (
        (node.place, parent.place)
        for node in (Node("next_state", place) for place in range(len(seen)))
        for parent in network.parents(node)
        if parent.role == "next_state"
    )
    return all(seen[parent] and not seen[child] for child, parent in links)


class _Document:
    def __init__(self, network: TwoSliceNetwork) -> None:
        self._network = network
        self.speller = Speller(_FOREIGN, {"-", "*"})
        titles = Speller(_FOREIGN, {"null"})
        self._variables: dict[Node, str] = {}
        self._values: dict[Node, list[str]] = {}
        for role, _, _ in _ELEMENTS:
            for place, factor in enumerate(network.factors(role)):
                node = Node(role, place)
                self._variables[node] = titles.spell([factor.name], self._taken, numbered=False)[0]
                self._values[node] = self.speller.spell(factor.names)
        for place in range(len(network.states.factors)):
            name = unused(f"{self._variables[Node('state', place)]}'", lambda found: found in self._taken)
            self._variables[Node("next_state", place)] = name
            self._values[Node("next_state", place)] = self._values[Node("state", place)]

    @property
    def _taken(self) -> set[str]:
        return set(self._variables.values())

    def lines(self, discount: float) -> list[str]:
        network = self._network
        lines = ['<?xml version="1.0" encoding="UTF-8"?>', '<pomdpx version="1.0" id="mdm">']
        lines += [f"<Discount>{discount!r}</Discount>", "<Variable>", *self._declarations(), "</Variable>"]
        for role, section in _SECTIONS:
            potentials = initial(network) if role == "state" else network.potentials(role)
            if not potentials:
                continue
            lines.append(f"<{section}>")
            for place, potential in enumerate(potentials):
                lines += self._function("CondProb", self._variables[Node(role, place)], potential, Node(role, place))
            lines.append(f"</{section}>")
        lines.append("<RewardFunction>")
        for index, utility in enumerate(utilities(network)):
            lines += self._function("Func", self._reward(index), utility, None)
        return [*lines, "</RewardFunction>", "</pomdpx>"]

    def _reward(self, index: int) -> str:
        return unused(f"reward{index}", lambda found: found in self._taken)

    def _declarations(self) -> list[str]:
        lines = []
        observed = _observed(self._network)
        for role, tag, prefix in _ELEMENTS:
            for place in range(len(self._network.factors(role))):
                node = Node(role, place)
                values = self._values[node]
                name = quoted(self._variables[node])
                if role == "state":
                    after = quoted(self._variables[Node("next_state", place)])
                    seen = "true" if observed[place] else "false"
                    begin = f'<{tag} vnamePrev={name} vnameCurr={after} fullyObs="{seen}">'
                else:
                    begin = f"<{tag} vname={name}>"
                counted = values == [f"{prefix}{index}" for index in range(len(values))]
                listed = f"<ValueEnum>{escape(' '.join(values))}</ValueEnum>"
                lines.append(begin + (f"<NumValues>{len(values)}</NumValues>" if counted else listed) + f"</{tag}>")
        lines += [f"<RewardVar vname={quoted(self._reward(index))}/>" for index in range(len(utilities(self._network)))]
        return lines

    def _function(self, tag: str, variable: str, potential: Potential, child: Node | None) -> list[str]:
        parents = [node for node in potential.scope if node != child]
        if child is not None and child.role == "next_state":
            # SARSOP multiplies these tables, and fails where none of them has an action or the state before.
            actions = [Node("action", place) for place in range(len(self._network.actions.factors))]
            parents += [node for node in (*actions, Node("state", child.place)) if node not in parents]
        elif not parents and (child is None or child.role != "state"):
            parents = [Node("action", 0)]  # only what is initial depends on nothing
        names = " ".join(self._variables[node] for node in parents) or "null"
        head = f"<{tag}><Var>{escape(variable)}</Var><Parent>{escape(names)}</Parent>"
        order = parents if child is None else [*parents, child]
        if _count_leaves(potential, {}) > math.prod(len(self._values[node]) for node in order):
            potential = tabulated(potential)
        entries = [
            line for fixed, table in _leaves(potential, {}) for line in self._entries(table, fixed, order, child)
        ]
        return [head, '<Parameter type="TBL">', *entries, f"</Parameter></{tag}>"]

    def _entries(self, table: Table, fixed: dict[Node, int], order: list[Node], child: Node | None) -> list[str]:
        """Return the entries of a table where some variables are fixed: one, or one for each number that is not 0."""
        at = tuple(fixed.get(node, slice(None)) for node in table.scope)
        scope = [node for node in table.scope if node not in fixed]
        values = table.values[at]
        if child is not None and child not in fixed and child not in scope:
            values = np.broadcast_to(values[..., None], (*values.shape, len(self._values[child])))
            scope.append(child)
        spread = [node for node in order if node in scope]
        values = values.transpose([scope.index(node) for node in spread])
        tag = "ValueTable" if child is None else "ProbTable"
        instance = [
            escape(self._values[node][fixed[node]]) if node in fixed else "-" if node in scope else "*"
            for node in order
        ]
        few = values.size > _MANY and np.count_nonzero(values) < _FEW * values.size
        if not few or (child is not None and child.role == "state"):
            numbers = " ".join(map(repr, values.ravel().tolist()))
            return [f"<Entry><Instance>{' '.join(instance)}</Instance><{tag}>{numbers}</{tag}></Entry>"]
        places = np.nonzero(values)
        columns = [
            np.array([escape(value) for value in self._values[node]], dtype=object)[places[spread.index(node)]]
            if node in spread
            else [word] * len(places[0])
            for node, word in zip(order, instance, strict=True)
        ]
        return [
            f"<Entry><Instance>{' '.join(words)}</Instance><{tag}>{number!r}</{tag}></Entry>"
            for *words, number in zip(*columns, values[places].tolist(), strict=True)
        ]


def _leaves(potential: Potential, fixed: dict[Node, int]) -> Iterator[tuple[dict[Node, int], Table]]:
    """Yield the tables at the ends of a tree, and the values of variables that lead to them."""
    if isinstance(potential, Table):
        yield fixed, potential
        return
    for value, choice in enumerate(potential.choice.tolist()):
        if fixed.get(potential.node, value) == value:
            yield from _leaves(potential.branches[choice], {**fixed, potential.node: value})


def _count_leaves(potential: Potential, done: dict[int, int]) -> int:
    """Return the number of paths through a tree."""
    if isinstance(potential, Table):
        return 1
    if id(potential) not in done:
        done[id(potential)] = sum(_count_leaves(potential.branches[choice], done) for choice in potential.choice)
    return done[id(potential)]
