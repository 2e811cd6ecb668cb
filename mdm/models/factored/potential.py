"""Potentials: functions of the variables of a two-slice network, as tables or trees.

A conditional probability is a potential over a variable (its *child*) and its parents; a utility has no child. Trees
are compact for context-specific independence, where a function depends on a variable only for certain values of others.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.models.matrices import Vector, numbers

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

__all__ = ["Digits", "Node", "Potential", "Role", "Table", "Tree", "tabulated"]

Role = Literal["state", "action", "next_state", "observation"]


class Node(NamedTuple):
    """A variable of a two-slice network: the role of a space in it, and the index of one of its factors."""

    role: Role
    place: int


Digits = "Mapping[Node, npt.NDArray[np.intp]]"
"""The values of variables, as arrays of one length."""


class Table:
    """A potential with a number for every combination of values.

    Args:
        scope: The variables, without duplicates.
        values: An array with an axis per variable, in the same order.

    Raises:
        ModelError: If the numbers do not fit the scope.
    """

    __slots__ = ("scope", "sizes", "values")

    def __init__(self, scope: Sequence[Node], values: npt.ArrayLike) -> None:
        self.scope = tuple(scope)
        self.values = numbers(values, "a potential's table")
        if self.values.ndim != len(self.scope) or len(set(self.scope)) != len(self.scope):
            raise ModelError(f"a table over {len(self.scope)} variables cannot have {self.values.ndim} axes")
        self.values.setflags(write=False)
        self.sizes = dict(zip(self.scope, self.values.shape, strict=True))
        """The number of values of each variable of the scope."""

    def rows(self, digits: Mapping[Node, Any], count: int, child: Node | None, size: int) -> Vector:
        """Return the numbers at some values of the variables.

        Args:
            digits: The values of every variable of the scope except the child.
            count: The length of these arrays.
            child: The variable whose values make the columns.
            size: The number of the child's values; 1 without a child.

        Returns:
            A count x size array.
        """
        chosen = tuple(digits[node] for node in self.scope if node != child)
        if child in self.scope:
            values = np.moveaxis(self.values, self.scope.index(child), -1)[chosen]
        else:
            values = self.values[chosen][..., None]
        return np.broadcast_to(values.reshape(-1, values.shape[-1]), (count, size))


class Tree:
    """A potential that chooses among others by the value of a variable.

    Args:
        node: The variable.
        choice: The branch of each of its values.
        branches: The other potentials, each with a scope of its own.

    Raises:
        ModelError: If a value has no branch, or branches disagree on the number of a variable's values.
    """

    __slots__ = ("branches", "choice", "node", "scope", "sizes")

    def __init__(self, node: Node, choice: Sequence[int], branches: Sequence[Potential]) -> None:
        self.node = node
        self.choice = np.array(choice, dtype=np.intp)
        self.branches = tuple(branches)
        if not len(choice) or not all(0 <= branch < len(self.branches) for branch in choice):
            raise ModelError("a tree needs a branch for every value of its variable")
        self.sizes: dict[Node, int] = {node: len(self.choice)}
        """The number of values of each variable of the scope."""
        for branch in self.branches:
            for inner, size in branch.sizes.items():
                if self.sizes.setdefault(inner, size) != size:
                    raise ModelError(
                        f"branches of a tree disagree: a variable has {size} or {self.sizes[inner]} values"
                    )
        self.scope: tuple[Node, ...] = tuple(self.sizes)

    def rows(self, digits: Mapping[Node, Any], count: int, child: Node | None, size: int) -> Vector:
        """Return the numbers at some values of the variables, as `Table.rows` does."""
        result = np.empty((count, size))
        for number, branch in enumerate(self.branches):
            if self.node == child:
                columns = np.flatnonzero(self.choice == number)
                if columns.size:
                    result[:, columns] = branch.rows(digits, count, child, size)[:, columns]
                continue
            chosen = np.flatnonzero(self.choice[digits[self.node]] == number)
            if chosen.size == count:
                return branch.rows(digits, count, child, size)
            if chosen.size:
                inner = {node: digits[node][chosen] for node in branch.scope if node != child}
                result[chosen] = branch.rows(inner, chosen.size, child, size)
        return result


Potential = Table | Tree


def tabulated(potential: Potential) -> Table:
    """Return a potential as a table over its scope."""
    if isinstance(potential, Table):
        return potential
    sizes = [potential.sizes[node] for node in potential.scope]
    grid = [axis.ravel() for axis in np.indices(sizes)]
    values = potential.rows(dict(zip(potential.scope, grid, strict=True)), math.prod(sizes), None, 1)
    return Table(potential.scope, values.reshape(sizes))
