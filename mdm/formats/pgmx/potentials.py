"""ProbModelXML's potentials: tables, uniform distributions, and trees with labelled, shared branches."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mdm.errors import ModelError
from mdm.formats.source import number
from mdm.models.factored.potential import Node, Potential, Table, Tree

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from mdm.formats.markup import Element

__all__ = ["Potentials", "Variable", "names_of", "reference"]

_TABLES = {"Table", "ProbTable", "Exact"}
_TREES = {"Tree/ADD", "Tree-ADD"}
_LARGEST = 20_000_000
_DEPTH = 100
"""Limit on chains of references between branches; real models stay far below."""


class Variable(NamedTuple):
    """A variable of one time slice."""

    name: str
    time: int
    role: str
    names: tuple[str, ...]
    agent: str | None
    element: Element

    @property
    def key(self) -> tuple[str, int]:
        """Its name and time slice, which identify it."""
        return self.name, self.time


def reference(element: Element) -> tuple[str, int | None]:
    """Return the name and time slice of a variable; files have the slice as an attribute, in the name, or both."""
    name = element.attribute("name")
    time = element.attributes.get("timeSlice")
    if time is None:
        for suffix in ("[0]", "[1]"):
            if name.endswith(suffix):
                return name.removesuffix(suffix).strip(), int(suffix[1])
        return name, None
    if not time.strip().isdecimal() or len(time) > 9:
        element.fail(f"{time[:40]!r} is not a time slice")
    return name.removesuffix(f"[{int(time)}]").strip(), int(time)


def names_of(element: Element) -> tuple[str, ...]:
    """Return the names of the states listed in an element."""
    states = element.find("States")
    return () if states is None else tuple(state.attribute("name") for state in states.all("State"))


class Potentials:
    """Turns elements into potentials.

    Args:
        variable: Returns the variable named by an element.
        nodes: The network's nodes by name and time slice of their variable.
    """

    def __init__(self, variable: Callable[[Element], Variable], nodes: Mapping[tuple[str, int], Node]) -> None:
        self._variable = variable
        self._nodes = nodes

    def conditional(self, element: Element, child: Variable) -> Potential:
        """Return the conditional probability of a variable."""
        return _Reader(self._variable, self._nodes, element, child).potential(element, 0)

    def utility(self, element: Element) -> Potential:
        """Return a utility."""
        return _Reader(self._variable, self._nodes, element, None).potential(element, 0)


class _Reader:
    """Reads one potential; a labelled branch is read once and shared by all references to it."""

    def __init__(
        self,
        variable: Callable[[Element], Variable],
        nodes: Mapping[tuple[str, int], Node],
        root: Element,
        child: Variable | None,
    ) -> None:
        self._variable = variable
        self._nodes = nodes
        self._child = child
        self._labels: dict[str, Element] = {}
        self._shared: dict[str, Potential] = {}
        self._find_labels(root)

    def _find_labels(self, element: Element) -> None:
        label = element.find("Label") if element.tag == "Branch" else None
        if label is not None:
            self._labels.setdefault(label.text.strip(), element)
        for inner in element.children:
            self._find_labels(inner)

    def potential(self, element: Element, depth: int) -> Potential:
        if depth > _DEPTH:
            element.fail(f"branches refer to each other more than {_DEPTH} deep")
        kind = element.attribute("type")
        if kind in _TREES:
            return self._tree(element, depth)
        if kind == "Uniform":
            return self._uniform()
        if kind in _TABLES:
            return self._table(element)
        return element.fail(
            f"a potential of type {kind!r} is not supported; Table, ProbTable, Exact, Uniform and Tree/ADD are"
        )

    def _uniform(self) -> Potential:
        if self._child is None:
            return Table([], 0.0)
        size = len(self._child.names)
        return Table([self._nodes[self._child.key]], np.full(size, 1 / size))

    def _scope(self, element: Element) -> list[Variable]:
        listed = element.find("Variables")
        found = [] if listed is None else [self._variable(each) for each in listed.all("Variable")]
        if len({variable.key for variable in found}) != len(found):
            element.fail("a potential lists a variable twice")
        return [variable for variable in found if variable.role != "utility"]

    def _table(self, element: Element) -> Potential:
        scope = self._scope(element)
        sizes = [len(variable.names) for variable in scope]
        count = math.prod(sizes)
        if count > _LARGEST:
            element.fail(f"a table of {count} numbers exceeds the limit of {_LARGEST}")
        given = element.need("Values")
        words = given.text.split()
        try:
            values = np.array(words, dtype=np.float64)
        except ValueError:
            wrong = next(word for word in words if number(word) is None)
            given.fail(f"{wrong[:40]!r} is not a number")
        if not np.isfinite(values).all():
            given.fail(f"{words[int((~np.isfinite(values)).argmax())]} is not a finite number")
        if len(values) == 1:
            values = np.full(count, values[0])
        if len(values) != count:
            over = " x ".join(map(str, sizes)) or "1"
            given.fail(f"{len(values)} numbers are given, but the table has {over} = {count}")
        array = values.reshape(sizes[::-1]).T
        kept = [index for index, variable in enumerate(scope) if self._known(variable, element)]
        array = array[tuple(slice(None) if index in kept else 0 for index in range(len(scope)))]
        return Table([self._nodes[scope[index].key] for index in kept], array)

    def _known(self, variable: Variable, element: Element) -> bool:
        """Whether a variable is in the network; constants are not, and other variables are refused."""
        if variable.key in self._nodes:
            return True
        if len(variable.names) == 1:
            return False
        return element.fail(
            f"a potential depends on {variable.name!r} of time slice {variable.time}, which is neither state, action "
            f"nor observation: only two-slice decision processes, as MADP reads them, are supported"
        )

    def _tree(self, element: Element, depth: int) -> Potential:
        top = self._variable(element.need("TopVariable"))
        branches = element.need("Branches").all("Branch")
        choice: dict[str, int] = {}
        for index, branch in enumerate(branches):
            names = names_of(branch)
            if branch.find("Thresholds") is not None or branch.find("Threshold") is not None:
                branch.fail("branches by thresholds need numeric variables, which decision processes do not have")
            for name in names or top.names:
                if name not in top.names:
                    branch.fail(f"{top.name!r} has no state {name!r}; it has {', '.join(top.names)}")
                choice.setdefault(name, index)
        left = [name for name in top.names if name not in choice]
        if left:
            element.fail(f"the tree over {top.name!r} has no branch for {', '.join(left)}")
        potentials = [self._branch(branch, depth + 1) for branch in branches]
        if not self._known(top, element):
            return potentials[choice[top.names[0]]]
        try:
            return Tree(self._nodes[top.key], [choice[name] for name in top.names], potentials)
        except ModelError as error:
            return element.fail(str(error))

    def _branch(self, branch: Element, depth: int) -> Potential:
        inner = branch.find("Potential")
        if inner is not None:
            label = branch.find("Label")
            if label is not None:
                return self._labelled(label.text.strip(), inner, depth)
            return self.potential(inner, depth)
        name = branch.need("Reference").text.strip()
        target = self._labels.get(name)
        if target is None:
            known: Sequence[str] = sorted(self._labels)
            branch.fail(f"there is no branch with the label {name!r}; there are {', '.join(known) or 'none'}")
        return self._labelled(name, target.need("Potential"), depth)

    def _labelled(self, name: str, element: Element, depth: int) -> Potential:
        if name not in self._shared:
            self._shared[name] = self.potential(element, depth)
        return self._shared[name]
