"""Two-slice Bayesian networks: factored dynamics, observations and rewards of a decision process.

The first slice holds state factors and actions, the second next state factors and observations. Each initial factor,
next factor and observation has a conditional probability given its parents; utilities add up to the reward (T. Dean
and K. Kanazawa, *A model for reasoning about persistence and causation*, Computational Intelligence 5, 1989; for trees
C. Boutilier, R. Dearden and M. Goldszmidt, *Stochastic dynamic programming with factored representations*, Artificial
Intelligence 121, 2000).

These functions of the network's variables are potentials: tables or trees. A conditional probability is a potential
over a variable (its *child*) and its parents; a utility has no child. Trees are compact for context-specific
independence, where a function depends on a variable only for certain values of others.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.models.matrices import TOLERANCE, Vector, numbers
from mdm.models.validation import report

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from mdm.models.space import Factor, Space

    Indices = npt.NDArray[np.intp]

Role = Literal["state", "action", "next_state", "observation"]
_BLOCK = 1 << 16
_LARGEST = 50_000_000
_TOLD = 100
_EXACT = 1e-12
"""The largest error in a sum of probabilities that is one of rounding alone."""
_PARENTS: dict[Role, frozenset[Role]] = {
    "state": frozenset({"state"}),
    "next_state": frozenset({"state", "action", "next_state"}),
    "observation": frozenset({"state", "action", "next_state", "observation"}),
}


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


class PotentialError(ModelError):
    """The distribution of a variable is invalid.

    Attributes:
        node: The variable.
    """

    def __init__(self, message: str, node: Node) -> None:
        super().__init__(message)
        self.node = node


class TwoSliceNetwork:
    """The structure and numbers of a factored decision process.

    Args:
        states: The state factors.
        actions: A factor per agent.
        observations: A factor per agent; None for an MDP.
        initial: For each state factor its initial distribution; it may depend on other factors.
        transitions: For each state factor the distribution of its next value.
        observation: For each observation factor its distribution.
        utilities: Potentials over any variables, whose sum is the reward.
        fully_observed: For each state factor whether agents observe it without error; by default none.
        event_observations: Whether observations are events, P(o | s, a, s'). They are in any case if a state factor is
            a parent of an observation.

    Raises:
        ModelError: If a potential is missing, depends on a later variable or in a circle on itself, or if
            probabilities do not sum to 1. (Event observations are checked when the network is flattened.)

    Example::

        from mdm.models import FactoredMDP, Node, Space, Table, TwoSliceNetwork

        lamp, button = Node("state", 0), Node("action", 0)
        network = TwoSliceNetwork(
            Space.single("lamp", ["off", "on"]),
            Space.single("button", ["leave", "press"]),
            initial=[Table([lamp], [1, 0])],
            transitions=[Table([lamp, button, Node("next_state", 0)], [[[1, 0], [0, 1]], [[0, 1], [1, 0]]])],
            utilities=[Table([lamp], [0, 1])],
        )
        FactoredMDP(network, discount=0.9).transition("press", "off", "on")  # 1.0
    """

    def __init__(
        self,
        states: Space,
        actions: Space,
        observations: Space | None = None,
        *,
        initial: Sequence[Potential],
        transitions: Sequence[Potential],
        observation: Sequence[Potential] = (),
        utilities: Sequence[Potential] = (),
        fully_observed: Sequence[bool] | None = None,
        event_observations: bool = False,
    ) -> None:
        self.states = states
        self.actions = actions
        self.observations = observations
        self.initial = tuple(initial)
        self.transitions = tuple(transitions)
        self.observation = tuple(observation)
        self.utilities = tuple(utilities)
        self.fully_observed = (
            tuple(fully_observed) if fully_observed is not None else (False,) * len(self.states.factors)
        )
        if len(self.fully_observed) != len(states.factors):
            raise ModelError(
                f"fully_observed is for {len(self.fully_observed)} state factors, but there are {len(states.factors)}"
            )
        if observations is None and (event_observations or self.observation):
            raise ModelError("distributions of observations are given, but the network has no observation space")
        self.event_observations = event_observations or any(
            node.role == "state" for potential in self.observation for node in potential.scope
        )
        self.orders: dict[Role, tuple[int, ...]] = {
            "state": self._order("state", self.initial),
            "next_state": self._order("next_state", self.transitions),
            "observation": self._order("observation", self.observation),
        }
        for utility in self.utilities:
            self._check_sizes(utility, "a utility")
        checked: tuple[Role, ...] = ("state", "next_state", "observation")
        for role in checked[: 2 if self.event_observations else 3]:
            for index, potential in enumerate(self.potentials(role)):
                self._check_sums(Node(role, index), potential, set())

    def factors(self, role: Role) -> tuple[Factor, ...]:
        """Return the variables of a role."""
        space = {
            "state": self.states,
            "next_state": self.states,
            "action": self.actions,
            "observation": self.observations,
        }[role]
        return () if space is None else space.factors

    def factor(self, node: Node) -> Factor:
        """Return the factor of a variable: its name and values."""
        return self.factors(node.role)[node.place]

    def potentials(self, role: Role) -> tuple[Potential, ...]:
        """Return the conditional probabilities of a role's variables."""
        return {
            "state": self.initial,
            "next_state": self.transitions,
            "observation": self.observation,
            "action": (),
        }[role]

    def name(self, node: Node) -> str:
        """Return a variable's name; a next state factor's ends with ``'``."""
        return self.factor(node).name + ("'" if node.role == "next_state" else "")

    def parents(self, node: Node) -> tuple[Node, ...]:
        """Return the parents of a variable."""
        return tuple(other for other in self.potentials(node.role)[node.place].scope if other != node)

    @cached_property
    def is_exact(self) -> bool:
        """Whether all distributions of the second slice sum to 1 but for rounding.

        A variable on which nothing depends can then be left out of a sum. Event observations may leave something to no
        observation, and numbers in a file may be written with few digits.
        """
        roles: tuple[Role, ...] = ("next_state", "observation")
        return all(
            (np.abs(rows.sum(axis=1) - 1) <= _EXACT).all()
            for role in roles
            for place, potential in enumerate(self.potentials(role))
            for leaf in _leaves(Node(role, place), potential, {})
            for _, rows in self._blocks(Node(role, place), leaf)
        )

    def _order(self, role: Role, potentials: Sequence[Potential]) -> tuple[int, ...]:
        """Return the variables of a role in an order in which parents come first."""
        factors = self.factors(role)
        if len(potentials) != len(factors):
            raise ModelError(f"{len(potentials)} distributions are given for {len(factors)} {role.replace('_', ' ')}s")
        waiting: dict[int, set[int]] = {}
        for index, potential in enumerate(potentials):
            name = f"the distribution of {self.name(Node(role, index))!r}"
            if Node(role, index) not in potential.scope:
                raise PotentialError(f"{name} does not have it in its scope", Node(role, index))
            self._check_sizes(potential, name)
            for node in potential.scope:
                if node.role not in _PARENTS[role]:
                    raise PotentialError(f"{name} depends on {self.name(node)!r}, a later variable", Node(role, index))
            waiting[index] = {node.place for node in potential.scope if node.role == role} - {index}
        order: list[int] = []
        while waiting:
            ready = next((index for index, parents in waiting.items() if parents.issubset(order)), None)
            if ready is None:
                names = " and ".join(repr(self.name(Node(role, index))) for index in _circle(waiting))
                raise ModelError(f"{names} depend on each other in a circle")
            order.append(ready)
            del waiting[ready]
        return tuple(order)

    def _check_sizes(self, potential: Potential, name: str) -> None:
        for node, size in potential.sizes.items():
            if not 0 <= node.place < len(self.factors(node.role)):
                raise ModelError(
                    f"{name} has {node.role.replace('_', ' ')} {node.place} in its scope, but there is none"
                )
            if size != len(self.factor(node)):
                raise ModelError(
                    f"{name} is for {size} values of {self.name(node)!r}, but there are {len(self.factor(node))}"
                )

    def _check_sums(self, node: Node, potential: Potential, done: set[int], among: str = "") -> None:
        if id(potential) in done:  # a branch shared by several choices
            return
        done.add(id(potential))
        if isinstance(potential, Tree) and potential.node != node:
            names = self.factor(potential.node).names
            for number, branch in enumerate(potential.branches):
                values = [name for name, choice in zip(names, potential.choice, strict=True) if choice == number]
                if values:
                    where = f"{among}{', ' if among else ''}{self.name(potential.node)}={'|'.join(values)}"
                    self._check_sums(node, branch, done, where)
            return
        for digits, rows in self._blocks(node, potential):
            wrong = ~(np.isfinite(rows).all(axis=1) & (rows >= 0).all(axis=1))
            wrong |= ~(np.abs(rows.sum(axis=1) - 1) <= TOLERANCE)
            if not wrong.any():
                continue
            for at in np.flatnonzero(wrong)[:_TOLD].tolist():
                given = [among] if among else []
                given += [f"{self.name(parent)}={self.factor(parent).names[of[at]]}" for parent, of in digits.items()]
                row = rows[at]
                bad = row[~((row >= 0) & np.isfinite(row))]
                what = f"{bad[0]:g} is not a probability" if bad.size else f"they sum to {row.sum():.6g}, not to 1"
                where = f" given {', '.join(given)}" if given else ""
                problem = f"the probabilities of {self.name(node)!r}{where}: {what}"
                if not report(problem, is_sum=bool(not bad.size and row.sum() > 0), at=node):
                    raise PotentialError(problem, node)

    def _blocks(self, child: Node, potential: Potential) -> Iterator[tuple[dict[Node, Indices], Vector]]:
        """Yield blocks of values of a variable's parents, and its distributions given them."""
        parents = [node for node in potential.scope if node != child]
        shape = tuple(len(self.factor(node)) for node in parents)
        size = len(self.factor(child))
        total = math.prod(shape)
        if total > _LARGEST:
            raise ModelError(
                f"{self.name(child)!r} has {len(parents)} parents with {total} combinations of values: too many"
            )
        step = max(1, _BLOCK // size)
        for start in range(0, total, step):
            flat = np.arange(start, min(start + step, total))
            digits = dict(zip(parents, np.unravel_index(flat, shape), strict=True)) if parents else {}
            yield digits, potential.rows(digits, len(flat), child, size)


def _leaves(child: Node, potential: Potential, found: dict[int, Potential]) -> Iterable[Potential]:
    """Return the parts of a distribution that trees choose among by other variables than the child, each once."""
    if isinstance(potential, Tree) and potential.node != child:
        for branch in set(potential.choice.tolist()):
            _leaves(child, potential.branches[branch], found)
    else:
        found[id(potential)] = potential
    return found.values()


def _circle(parents: Mapping[int, set[int]]) -> list[int]:
    """Return a circle of variables, each of which has a parent among them."""
    path = [min(parents)]
    while True:
        after = min(parents[path[-1]] & parents.keys())
        if after in path:
            return sorted(path[path.index(after) :])
        path.append(after)
