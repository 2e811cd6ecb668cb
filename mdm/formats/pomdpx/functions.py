"""POMDPX's functions: tables of entries, and decision diagrams."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mdm.errors import ModelError
from mdm.formats.source import number
from mdm.models.factored.potential import Node, Potential, Table, Tree

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    from mdm.formats.markup import Element
    from mdm.models import Factor

__all__ = ["Variable", "function"]

_LARGEST = 50_000_000
_DEPTH = 100
"""Limit on chains of templates; real models stay far below."""


class Variable(NamedTuple):
    """A variable: its node in the network, and its values."""

    node: Node
    factor: Factor


def function(element: Element, variables: Mapping[str, Variable], child: Variable | None) -> Potential:
    """Read the potential of a ``CondProb`` (with a child) or a ``Func`` (without one).

    Args:
        element: The element.
        variables: The variables in scope, by name.
        child: The variable whose distribution it is, if any.

    Raises:
        FormatError: If the element is malformed, with the place and what was expected.
    """
    parents = element.find("Parent")
    words = parents.text.split() if parents is not None else []
    scope = []
    for word in words if words != ["null"] else []:
        if word not in variables:
            assert parents is not None
            parents.fail(f"there is no variable {word!r} here; there are {', '.join(variables)}")
        scope.append(variables[word])
    if child is not None:
        scope.append(child)
    if len({variable.node for variable in scope}) != len(scope):
        element.fail("the function lists a variable twice")
    parameter = element.need("Parameter")
    kind = parameter.attributes.get("type", "TBL").strip()
    if kind == "TBL":
        return _Entries(scope, child).table(parameter)
    if kind == "DD":
        return _Diagram(parameter, variables).potential()
    return parameter.fail(f"a function of type {kind!r} is neither TBL nor DD")


class _Entries:
    """Fills a table from entries; variables that are ``*`` in every entry are left out of its scope."""

    def __init__(self, scope: Sequence[Variable], child: Variable | None) -> None:
        self._scope = scope
        self._child = child

    def table(self, parameter: Element) -> Table:
        """Return the table; values without an entry are 0."""
        entries = [(entry, self._instance(entry)) for entry in parameter.all("Entry")]
        kept = [
            axis
            for axis, variable in enumerate(self._scope)
            if variable == self._child or any(words[axis] != "*" for _, words in entries)
        ]
        sizes = [len(self._scope[axis].factor) for axis in kept]
        if math.prod(sizes) > _LARGEST:
            parameter.fail(f"a table of {math.prod(sizes)} numbers is too large; use a decision diagram (DD)")
        values = np.zeros(sizes)
        for entry, words in entries:
            self._fill(values, entry, [words[axis] for axis in kept], kept)
        return Table([self._scope[axis].node for axis in kept], values)

    def _instance(self, entry: Element) -> list[str]:
        instance = entry.need("Instance")
        words = instance.text.split()
        if len(words) != len(self._scope):
            names = " ".join(variable.factor.name for variable in self._scope)
            instance.fail(f"{len(words)} words are given, but the function is over {len(self._scope)}: {names}")
        return words

    def _fill(self, values: npt.NDArray[np.float64], entry: Element, words: list[str], kept: list[int]) -> None:
        chosen: list[int | slice] = []
        shape: list[int] = []  # of the numbers; an axis of equal values has size 1
        for word, axis in zip(words, kept, strict=True):
            if word in {"-", "*"}:
                chosen.append(slice(None))
                shape.append(len(self._scope[axis].factor) if word == "-" else 1)
            else:
                chosen.append(_value(entry.need("Instance"), self._scope[axis].factor, word))
        given = entry.find("ProbTable") or entry.find("ValueTable") or entry.need("ProbTable")
        free = [size for word, size in zip((w for w in words if w in {"-", "*"}), shape, strict=True) if word == "-"]
        values[tuple(chosen)] = self._numbers(given, words, free).reshape(shape)

    def _numbers(self, given: Element, words: list[str], free: list[int]) -> npt.NDArray[np.float64]:
        """Return an entry's numbers over the variables with ``-``; the last changes fastest."""
        text = given.text.split()
        if text == ["uniform"]:
            if self._child is None or words[-1] not in {"-", "*"}:
                given.fail("'uniform' needs a distribution, with '-' for the last variable")
            size = len(self._child.factor)
            return np.full(free, 1 / size)
        if text == ["identity"]:
            if len(free) != 2 or free[0] != free[1]:
                given.fail("'identity' needs two '-' for variables of one size")
            return np.eye(free[0])
        count = math.prod(free)
        numbers = [_number(given, word) for word in text] if len(text) == count else None
        if numbers is None:
            given.fail(f"{len(text)} numbers are given, but the variables with '-' have {count} combinations of values")
        return np.array(numbers, dtype=np.float64).reshape(free)


class _Diagram:
    """Reads a decision diagram; a template is read once and shared by all references to it."""

    def __init__(self, parameter: Element, variables: Mapping[str, Variable]) -> None:
        self._parameter = parameter
        self._variables = variables
        self._templates = {template.attribute("id"): template for template in parameter.all("SubDAGTemplate")}
        self._read: dict[str, Potential] = {}

    def potential(self) -> Potential:
        return self._inside(self._parameter.need("DAG"), 0)

    def _inside(self, element: Element, depth: int) -> Potential:
        """Return the potential of an element's only child."""
        if depth > _DEPTH:
            element.fail(f"templates refer to each other more than {_DEPTH} deep")
        if len(element.children) != 1:
            element.fail(f"<{element.tag}> needs one <Node>, <Terminal> or <SubDAG>, not {len(element.children)}")
        inner = element.children[0]
        if inner.tag == "Node":
            return self._node(inner, depth + 1)
        if inner.tag == "Terminal":
            return Table([], _number(inner, inner.text.strip()))
        if inner.tag == "SubDAG":
            return self._shortcut(inner, depth + 1)
        return inner.fail(f"<Node>, <Terminal> or <SubDAG> was expected, not <{inner.tag}>")

    def _node(self, element: Element, depth: int) -> Potential:
        variable = self._variable(element)
        factor = variable.factor
        branches: list[Potential] = []
        choice = [-1] * len(factor)
        for edge in element.all("Edge"):
            value = _value(edge, factor, edge.attribute("val"))
            if choice[value] >= 0:
                edge.fail(f"a second edge for {factor.names[value]!r}")
            choice[value] = len(branches)
            branches.append(self._inside(edge, depth))
        if -1 in choice:  # values without an edge are 0, as in tables
            choice = [len(branches) if branch < 0 else branch for branch in choice]
            branches.append(Table([], 0.0))
        try:
            return Tree(variable.node, choice, branches)
        except ModelError as error:
            return element.fail(str(error))

    def _shortcut(self, element: Element, depth: int) -> Potential:
        kind = element.attribute("type")
        if kind == "template":
            return self._template(element, depth)
        if kind not in {"uniform", "deterministic", "persistent"}:
            element.fail(
                f"a <SubDAG> has the type {kind!r}: uniform, deterministic, persistent or template was expected"
            )
        variable = self._variable(element)
        size = len(variable.factor)
        if kind == "uniform":
            return Table([variable.node], np.full(size, 1 / size))
        if kind == "deterministic":
            value = _value(element, variable.factor, element.attribute("val"))
            return Table([variable.node], np.eye(size)[value])
        if variable.node.role not in {"state", "next_state"}:
            element.fail(f"{variable.factor.name!r} is not a state variable, so 'persistent' has no previous value")
        place = variable.node.place
        return Table([Node("state", place), Node("next_state", place)], np.eye(size))

    def _template(self, element: Element, depth: int) -> Potential:
        name = element.attribute("idref")
        if name not in self._templates:
            element.fail(f"there is no template {name!r}; there are {', '.join(self._templates) or 'none'}")
        if name not in self._read:
            self._read[name] = self._inside(self._templates[name], depth)
        return self._read[name]

    def _variable(self, element: Element) -> Variable:
        name = element.attribute("var")
        if name not in self._variables:
            element.fail(f"there is no variable {name!r} here; there are {', '.join(self._variables)}")
        return self._variables[name]


def _value(element: Element, factor: Factor, word: str) -> int:
    try:
        return factor.index(word)
    except ModelError as error:
        return element.fail(str(error))


def _number(element: Element, word: str) -> float:
    value = number(word)
    if value is None or not math.isfinite(value):
        element.fail(f"{word[:40]!r} is not a finite number")
    return value
