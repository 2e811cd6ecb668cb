"""Finite-state controllers: graphs with an action per node and an edge per observation.

A controller executes the action of its node and follows the edge of the observation; it needs no belief. Policy graphs
and policy trees have this form (E. A. Hansen, *Solving POMDPs by searching in policy space*, UAI 1998). A step costs
one look-up.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self, SupportsIndex

import numpy as np

from mdm.errors import ModelError
from mdm.models.matrices import numbers
from mdm.policies.plan import Plan
from mdm.policies.policy import listed, other_sizes, whole

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.policies.policy import Arrays, Packed

__all__ = ["FiniteStateController"]


class FiniteStateController(Plan):
    """A graph of nodes, each with an action, and a successor per observation.

    It is immutable, and does not hold the present node: a `Controller` does.

    Args:
        actions: The N nodes' actions.
        successors: A row per node, with a node per observation; None if the observation is impossible or the plan ends.
        num_actions: The number of actions; by default one more than the largest.
        values: The value of each node in each state, N x S, if known.
        start: The first node, unless a belief and ``values`` choose one.

    Raises:
        ModelError: If sizes do not fit, an action or node does not exist, or a value is not finite.

    Example::

        # Action 0 until observation 1, then action 1 for ever.
        policy = mdm.policies.FiniteStateController([0, 1], [[0, 1], [1, 1]])
        policy.next_node(0, 1)  # 1
    """

    kind: ClassVar[str] = "controller"
    form = "a finite-state controller"

    def __init__(
        self,
        actions: Sequence[int],
        successors: Sequence[Sequence[int | None]],
        num_actions: int | None = None,
        *,
        values: npt.ArrayLike | None = None,
        start: int = 0,
    ) -> None:
        if not len(actions) or len(actions) != len(successors):
            raise ModelError(f"there are {len(actions)} nodes' actions, but {len(successors)} rows of successors")
        self.actions = tuple(int(action) if isinstance(action, SupportsIndex) else -1 for action in actions)
        self.successors = tuple(tuple(None if node is None else int(node) for node in row) for row in successors)
        self.num_nodes = len(self.actions)
        self.num_actions = max(self.actions) + 1 if num_actions is None else num_actions
        self.num_observations = len(self.successors[0])
        for node, action in enumerate(self.actions):
            if not 0 <= action < self.num_actions:
                raise ModelError(
                    f"node {node} is for action {actions[node]}, but the actions are 0 to {self.num_actions - 1}"
                )
        for node, row in enumerate(self.successors):
            if len(row) != self.num_observations:
                raise ModelError(f"node {node} has {len(row)} successors, but node 0 has {self.num_observations}")
            for observation, successor in enumerate(row):
                if successor is not None and not 0 <= successor < self.num_nodes:
                    raise ModelError(
                        f"node {node} is followed by node {successor} after observation {observation}, but the nodes "
                        f"are 0 to {self.num_nodes - 1}"
                    )
        self._check_node(start)
        self.start = start
        self.values = None if values is None else self._checked(values)

    @property
    def controllers(self) -> tuple[FiniteStateController, ...]:
        """The controller itself."""
        return (self,)

    def joined(self) -> FiniteStateController:
        """Return the controller itself."""
        return self

    def mismatch(self, model: MDP) -> str | None:
        """Return why it does not fit a model, as a sentence; None if it fits."""
        if model.observation_space is None:
            return "the policy needs observations, but the model has none"
        ours, theirs = (
            (self.num_actions, self.num_observations),
            (len(model.action_space), len(model.observation_space)),
        )
        if ours != theirs:
            return other_sizes(ours, ("actions", "observations"), theirs)
        if self.num_states not in {None, len(model.state_space)}:
            return f"the nodes' values are for {self.num_states} states, but the model has {len(model.state_space)}"
        return None

    def value_at(self, belief: Vector) -> float | None:
        """Return the value of the best node at a belief; None if the nodes have no values."""
        return None if self.values is None else self.value(belief)

    def facts(self) -> dict[str, Any]:
        """Return its sizes by name."""
        return {**super().facts(), "observations": self.num_observations, "nodes": self.num_nodes}

    def packed(self) -> Packed:
        """Return its sizes and arrays."""
        rows = [[-1 if node is None else node for node in row] for row in self.successors]
        arrays: dict[str, npt.NDArray[Any]] = {
            "actions": whole(self.actions),
            "successors": np.array(rows, dtype=np.int64),
        }
        if self.values is not None:
            arrays["values"] = self.values
        return {"actions": self.num_actions, "start": self.start}, arrays

    @classmethod
    def unpacked(cls, sizes: Mapping[str, int], arrays: Arrays, seed: int | None) -> Self:
        """Return a packed policy."""
        table = arrays["successors"]
        if table.ndim != 2:
            raise ModelError(f"successors are a nodes x observations array, not one of shape {table.shape}")
        return cls(
            listed(arrays["actions"]),
            [[None if node == -1 else int(node) for node in row] for row in table.tolist()],
            sizes["actions"],
            values=arrays.get("values"),
            start=sizes["start"],
        )

    @property
    def num_states(self) -> int | None:  # type: ignore[override]
        """The number of states of its values; None if it has none."""
        return None if self.values is None else self.values.shape[1]

    def action_at(self, node: int) -> int:
        """Return a node's action."""
        self._check_node(node)
        return self.actions[node]

    def next_node(self, node: int, observation: int) -> int | None:
        """Return the next node; None if the observation is impossible or the plan ends."""
        self._check_node(node)
        if not 0 <= observation < self.num_observations:
            raise ModelError(
                f"there is no observation {observation}; the controller's {self.num_observations} count from 0"
            )
        return self.successors[node][observation]

    def is_last(self, node: int) -> bool:
        """Return whether a node is the last of a plan, without successors."""
        self._check_node(node)
        return node in self._last

    @cached_property
    def _last(self) -> frozenset[int]:
        return frozenset(node for node, row in enumerate(self.successors) if all(after is None for after in row))

    @cached_property
    def horizon(self) -> int | None:  # type: ignore[override]
        """The number of decisions on the longest path; None if there is a cycle.

        Paths begin at ``start``, or at any node if the nodes have values.
        """
        reached = dict.fromkeys([self.start] if self.values is None else range(self.num_nodes), 0)
        nodes = list(reached)
        for node in nodes:  # it grows meanwhile
            for after in self._following(node):
                if after not in reached:
                    nodes.append(after)
                reached[after] = reached.get(after, 0) + 1
        decisions, ready = dict.fromkeys(nodes, 1), [node for node in nodes if not reached[node]]
        for node in ready:  # it grows meanwhile, in topological order
            for after in self._following(node):
                decisions[after] = max(decisions[after], decisions[node] + 1)
                reached[after] -= 1
                if not reached[after]:
                    ready.append(after)
        return max(decisions.values()) if len(ready) == len(nodes) else None

    def _following(self, node: int) -> list[int]:
        return [after for after in self.successors[node] if after is not None]

    def start_node(self, belief: npt.NDArray[np.float64]) -> int:
        """Return the first node of the greatest value at a belief.

        Raises:
            ModelError: If the nodes have no values, or the belief is not over their states.
        """
        return int(self._values(belief).argmax())

    def value(self, belief: npt.NDArray[np.float64]) -> float:
        """Return the value of the best node at a belief.

        Raises:
            ModelError: If the nodes have no values, or the belief is not over their states.
        """
        return float(self._values(belief).max())

    def _values(self, belief: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        if self.values is None:
            raise ModelError("the controller's nodes have no values: evaluate it on its model")
        if np.shape(belief) != (self.values.shape[1],):
            raise ModelError(
                f"the controller's values are for beliefs of {self.values.shape[1]} numbers, not of shape "
                f"{np.shape(belief)}"
            )
        values: npt.NDArray[np.float64] = self.values.dot(belief)
        return values

    def _check_node(self, node: int) -> None:
        if not 0 <= node < self.num_nodes:
            raise ModelError(f"there is no node {node}; the controller's {self.num_nodes} count from 0")

    def _checked(self, values: npt.ArrayLike) -> npt.NDArray[np.float64]:
        matrix = numbers(values, "the array of nodes' values")
        if matrix.ndim != 2 or len(matrix) != self.num_nodes or not matrix.shape[1]:
            raise ModelError(f"nodes' values are a nodes x states array, not one of shape {matrix.shape}")
        if not np.isfinite(matrix).all():
            raise ModelError(f"the value of node {int((~np.isfinite(matrix)).any(axis=1).argmax())} is not finite")
        matrix.setflags(write=False)
        return matrix
