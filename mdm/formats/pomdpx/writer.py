"""Writing POMDPX: tables as entries, trees as decision diagrams with templates for shared branches."""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ModelError
from mdm.formats.markup import escape, quoted
from mdm.formats.spelling import Speller, unused
from mdm.formats.target import write_text
from mdm.models.factored.factoring import as_network
from mdm.models.factored.potential import Node, Potential, Table

if TYPE_CHECKING:
    from pathlib import Path

    from mdm.models import MDP, TwoSliceNetwork
    from mdm.models.factored.potential import Role

__all__ = ["write"]

_FOREIGN = re.compile("[\\s\x00-\x1f\ud800-\udfff\ufffe\uffff]")
_MANY = 1000
_FEW = 0.3
_DEEPEST = 40
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
    model whose factors are all fully observed.

    Raises:
        ModelError: If observations are events, which POMDPX lacks, or the model is too large for tables.
        FormatError: If the file cannot be written.
    """
    network = as_network(model)
    if network.event_observations:
        raise ModelError(
            "POMDPX cannot hold observations of events, P(o | s, a, s'): write .pgmx, or an archive (.npz)"
        )
    document = _Document(network)
    write_text(path, "\n".join(document.lines(model.discount)) + "\n")
    document.speller.warn("POMDPX")


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
            potentials = network.potentials(role)
            if not potentials:
                continue
            lines.append(f"<{section}>")
            for place, potential in enumerate(potentials):
                lines += self._function("CondProb", self._variables[Node(role, place)], potential, Node(role, place))
            lines.append(f"</{section}>")
        lines.append("<RewardFunction>")
        for index, utility in enumerate(network.utilities):
            lines += self._function("Func", self._reward(index), utility, None)
        return [*lines, "</RewardFunction>", "</pomdpx>"]

    def _reward(self, index: int) -> str:
        return unused(f"reward{index}", lambda found: found in self._taken)

    def _declarations(self) -> list[str]:
        lines = []
        fully_observed = self._network.fully_observed
        for role, tag, prefix in _ELEMENTS:
            for place in range(len(self._network.factors(role))):
                node = Node(role, place)
                values = self._values[node]
                name = quoted(self._variables[node])
                if role == "state":
                    after = quoted(self._variables[Node("next_state", place)])
                    seen = "true" if self._network.observations is None or fully_observed[place] else "false"
                    begin = f'<{tag} vnamePrev={name} vnameCurr={after} fullyObs="{seen}">'
                else:
                    begin = f"<{tag} vname={name}>"
                counted = values == [f"{prefix}{index}" for index in range(len(values))]
                listed = f"<ValueEnum>{escape(' '.join(values))}</ValueEnum>"
                lines.append(begin + (f"<NumValues>{len(values)}</NumValues>" if counted else listed) + f"</{tag}>")
        lines += [f"<RewardVar vname={quoted(self._reward(index))}/>" for index in range(len(self._network.utilities))]
        return lines

    def _function(self, tag: str, variable: str, potential: Potential, child: Node | None) -> list[str]:
        parents = [node for node in potential.scope if node != child]
        names = " ".join(self._variables[node] for node in parents) or "null"
        kind = "TBL" if isinstance(potential, Table) else "DD"
        inner = (
            self._entries(potential, parents, child)
            if isinstance(potential, Table)
            else _Diagram(self._variables, self._values).lines(potential)
        )
        head = f"<{tag}><Var>{escape(variable)}</Var><Parent>{escape(names)}</Parent>"
        return [head, f'<Parameter type="{kind}">', *inner, f"</Parameter></{tag}>"]

    def _entries(self, table: Table, parents: list[Node], child: Node | None) -> list[str]:
        """Return one entry with all numbers, or, if most are 0, an entry for each other number."""
        order = [*parents, child] if child is not None else parents
        values = np.transpose(table.values, [table.scope.index(node) for node in order])
        tag = "ValueTable" if child is None else "ProbTable"
        if values.size <= _MANY or np.count_nonzero(values) >= _FEW * values.size:
            instance = " ".join("-" * len(order))
            numbers = " ".join(map(repr, values.ravel().tolist()))
            return [f"<Entry><Instance>{instance}</Instance><{tag}>{numbers}</{tag}></Entry>"]
        places = np.nonzero(values)
        columns = [
            np.array([escape(value) for value in self._values[node]], dtype=object)[at]
            for node, at in zip(order, places, strict=True)
        ]
        return [
            f"<Entry><Instance>{' '.join(words)}</Instance><{tag}>{number!r}</{tag}></Entry>"
            for *words, number in zip(*columns, values[places].tolist(), strict=True)
        ]


class _Diagram:
    """Writes a tree; a shared branch becomes a template."""

    def __init__(self, variables: dict[Node, str], values: dict[Node, list[str]]) -> None:
        self._variables = variables
        self._values = values
        self._uses: Counter[int] = Counter()
        self._templates: dict[int, list[str]] = {}
        self._names: dict[int, str] = {}

    def lines(self, potential: Potential) -> list[str]:
        self._count(potential)
        root = ["<DAG>", *self._write(potential, 0), "</DAG>"]
        templates = [
            line
            for key, body in self._templates.items()
            for line in (f'<SubDAGTemplate id="{self._names[key]}">', *body, "</SubDAGTemplate>")
        ]
        return root + templates

    def _count(self, potential: Potential) -> None:
        self._uses[id(potential)] += 1
        if isinstance(potential, Table) or self._uses[id(potential)] > 1:
            return
        for choice in potential.choice:
            self._count(potential.branches[choice])

    def _write(self, potential: Potential, depth: int) -> list[str]:
        key = id(potential)
        if depth and (self._uses[key] > 1 or depth >= _DEEPEST) and potential.scope:
            if key not in self._names:
                self._names[key] = f"t{len(self._names)}"
                self._templates[key] = self._body(potential, 0)
            return [f'<SubDAG type="template" idref="{self._names[key]}"/>']
        return self._body(potential, depth)

    def _body(self, potential: Potential, depth: int) -> list[str]:
        if not isinstance(potential, Table):
            branches = [self._write(potential.branches[choice], depth + 2) for choice in potential.choice]
            return self._node(potential.node, branches)
        if not potential.scope:
            return [f"<Terminal>{float(potential.values)!r}</Terminal>"]
        first, *rest = potential.scope
        return self._node(first, [self._body(Table(rest, part), depth + 2) for part in potential.values])

    def _node(self, node: Node, branches: list[list[str]]) -> list[str]:
        lines = [f"<Node var={quoted(self._variables[node])}>"]
        for value, branch in zip(self._values[node], branches, strict=True):
            lines += [f"<Edge val={quoted(value)}>", *branch, "</Edge>"]
        return [*lines, "</Node>"]
