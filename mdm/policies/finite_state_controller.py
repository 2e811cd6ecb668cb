"""Finite-state controllers: graphs with an action per node and an edge per observation; and one for each agent.

A controller executes the action of its node and follows the edge of the observation; it needs no belief. Policy graphs
and policy trees have this form (E. A. Hansen, *Solving POMDPs by searching in policy space*, UAI 1998). A step costs a
look-up per agent, and needs no model.

Joint policies of decentralised POMDPs have a controller per agent, each by its agent's own observations (D. S.
Bernstein, R. Givan, N. Immerman and S. Zilberstein, *The complexity of decentralized control of Markov decision
processes*, Mathematics of Operations Research 27, 2002). A plan of finite horizon is a tree with a node per history of
observations.
"""

from __future__ import annotations

import itertools
import math
import operator
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, SupportsIndex

import numpy as np

from mdm.errors import ModelError
from mdm.models.matrices import distribution, numbers
from mdm.policies.batch import ENDED
from mdm.policies.policy import Kind, listed, other_sizes, whole

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    import numpy.typing as npt

    from mdm.models import MDP, POMDP
    from mdm.models.matrices import Vector
    from mdm.policies.batch import Batch, Indices
    from mdm.policies.policy import Arrays, Packed


class Plan(Kind):
    """The base of finite-state controllers: a single one, or one per agent."""

    input: Literal["observation"] = "observation"
    num_observations: int

    @property
    def controllers(self) -> tuple[FiniteStateController, ...]:
        """The controllers, one per agent."""
        raise NotImplementedError

    def information(self, model: MDP | None) -> Walk:
        """Return the first nodes."""
        known = model is not None and self.num_states is not None
        return Walk(self.controllers, model.initial_belief if known and model is not None else None)

    def action(self, nodes: Sequence[int]) -> int:
        """Return the (joint) action at the node of each controller."""
        action = 0
        for controller, node in zip(self.controllers, nodes, strict=True):
            action = action * controller.num_actions + controller.actions[node]
        return action

    def batch(self, model: MDP) -> Batch | None:
        """Return its decisions for a batch of episodes."""
        return None if model.pomdp is None else PlanBatch(self.controllers, model.pomdp)


class Walk:
    """The present node of each controller: the `Information` of a plan, without a belief.

    The symbols of a team are joint, with the first agent the most significant. Each controller is updated by its
    agent's own component. If the nodes have values, the first node is the best one at a given or the initial belief.

    Args:
        controllers: One per agent.
        initial: The initial belief.
    """

    belief: None = None
    expected: None = None

    def __init__(self, controllers: Sequence[FiniteStateController], initial: Vector | None = None) -> None:
        self._controllers = tuple(controllers)
        self._counts = tuple(each.num_observations for each in self._controllers)
        self._initial = initial
        self.current: tuple[int, ...] = ()
        self.reset()

    @property
    def ended(self) -> bool:
        """Whether the present action is the last: the node of some agent has no successors."""
        return any(each.is_last(node) for each, node in zip(self._controllers, self.current, strict=True))

    @property
    def impossible(self) -> str:
        """Why an observation is impossible, in words."""
        return f"has no edge at the nodes {self.current}"

    def reset(self, belief: npt.ArrayLike | None = None) -> None:
        """Begin at the first nodes.

        Raises:
            ModelError: If a belief is given, but the nodes have no values for it; the nodes stay as they were.
        """
        given = self._initial if belief is None else belief
        if given is None:
            self.current = tuple(each.start for each in self._controllers)
            return
        size = self._controllers[0].num_states
        if size is None or len(self._controllers) > 1:
            raise ModelError("the controller's nodes have no values: it cannot begin from a belief")
        self.current = (self._controllers[0].start_node(distribution(given, what="the belief", size=size)),)

    def update(self, action: int | None, observation: int | tuple[int | None, ...] | frozenset[int] | None) -> float:
        """Follow the edges of an observation.

        Args:
            action: Ignored: the nodes determine it.
            observation: The index of the (joint) observation; or a component per agent, with None for a missing one;
                or None for no observation. Without an observation an agent stays at its node.

        Returns:
            1; or 0 if a controller has no edge for the observation, and stays at its node.

        Raises:
            ModelError: If there is no such observation; the nodes are unchanged.
        """
        if observation is None:
            return 1.0
        if isinstance(observation, frozenset):
            raise ModelError("a plan has an edge for each whole observation: it cannot go by a part of one")
        if not isinstance(observation, tuple):
            total = int(np.prod(self._counts))
            if not 0 <= observation < total:
                raise ModelError(f"there is no observation {observation}; the controller's {total} count from 0")
            observation = tuple(int(part) for part in np.unravel_index(observation, self._counts))
        if len(observation) != len(self._controllers):
            raise ModelError(f"an observation has {len(self._controllers)} components, not {len(observation)}")
        moves = zip(self._controllers, self.current, observation, strict=True)
        after = [node if part is None else controller.next_node(node, part) for controller, node, part in moves]
        self.current = tuple(node if later is None else later for node, later in zip(self.current, after, strict=True))
        return 0.0 if None in after else 1.0

    def snapshot(self) -> Any:
        """Return the nodes."""
        return list(self.current)

    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot.

        Raises:
            ModelError: If a node is none of its controller; the nodes are unchanged.
        """
        nodes = tuple(operator.index(node) for node in snapshot)
        for controller, node in zip(self._controllers, nodes, strict=True):
            if not 0 <= node < controller.num_nodes:
                raise ModelError(f"there is no node {node}; the controller's {controller.num_nodes} count from 0")
        self.current = nodes


class PlanBatch:
    """The nodes of a batch of episodes, one per episode and agent.

    Args:
        controllers: One per agent.
        model: The model.
    """

    def __init__(self, controllers: Sequence[FiniteStateController], model: POMDP) -> None:
        self._controllers = tuple(controllers)
        self._model = model
        team = len(self._controllers) > 1
        self._shape = model.action_space.shape if team else (len(model.action_space),)
        self._seen = model.observation_space.shape if team else (len(model.observation_space),)
        self._actions = [np.array(controller.actions) for controller in self._controllers]
        self._successors = [
            np.array([[ENDED if node is None else node for node in row] for row in controller.successors])
            for controller in self._controllers
        ]
        self._nodes = np.empty((len(self._controllers), 0), dtype=np.intp)

    def begin(self, states: Indices, numbers: Vector) -> Indices:
        """Return the first actions."""
        alone = self._controllers[0] if len(self._controllers) == 1 else None
        if alone is not None and alone.values is not None:  # begin at the best node for the initial belief
            first, inverse = np.unique(states, return_inverse=True)
            nodes = np.array([alone.start_node(self._model.belief_at_start(int(state))) for state in first])
            self._nodes = nodes[None, inverse]
        else:
            starts = np.array([controller.start for controller in self._controllers])
            self._nodes = np.repeat(starts[:, None], len(states), axis=1)
        return self._at(self._nodes)

    def next(self, episodes: Indices, states: Indices, actions: Indices, seen: Indices, numbers: Vector) -> Indices:
        """Return the next actions."""
        parts = np.unravel_index(seen, self._seen)
        for agent, (successors, part) in enumerate(zip(self._successors, parts, strict=True)):
            self._nodes[agent, episodes] = successors[self._nodes[agent, episodes], part]
        nodes = self._nodes[:, episodes]
        return np.where((nodes == ENDED).any(axis=0), ENDED, self._at(nodes))

    def keep(self, which: npt.NDArray[np.bool_]) -> None:
        """Drop the other episodes' nodes."""
        self._nodes = self._nodes[:, which]

    def _at(self, nodes: Indices) -> Indices:
        parts = [actions[row] for actions, row in zip(self._actions, nodes, strict=True)]
        joint: Indices = np.ravel_multi_index(parts, self._shape)
        return joint


# -- A controller ------------------------------------------------------------------------------------------------------


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
        nodes = [self.start] if self.values is None else list(range(self.num_nodes))
        following: dict[int, list[int]] = {}
        for node in nodes:  # it grows meanwhile
            if node not in following:
                following[node] = [after for after in self.successors[node] if after is not None]
                nodes += following[node]
        decisions: dict[int, int] = {}
        try:
            for node in TopologicalSorter(following).static_order():  # successors first
                decisions[node] = 1 + max((decisions[after] for after in following[node]), default=0)
        except CycleError:
            return None
        return max(decisions.values())

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


# -- A controller per agent --------------------------------------------------------------------------------------------

_MOST = 20_000
"""The largest number of joint nodes."""


class JointController(Plan):
    """A `FiniteStateController` per agent, each updated by its agent's own observations.

    Args:
        controllers: One per agent, in the agents' order, over that agent's own actions and observations.

    Raises:
        ModelError: If there is none.

    Example::

        listen = mdm.policies.FiniteStateController([0], [[0, 0]], num_actions=3)
        policy = mdm.policies.JointController([listen, listen])
        mdm.Controller(policy, mdm.problems.dec_tiger()).start().action_name  # 'listen listen'
    """

    kind: ClassVar[str] = "joint"
    form = "a finite-state controller per agent"

    def __init__(self, controllers: Iterable[FiniteStateController]) -> None:
        self._controllers = tuple(controllers)
        if not self._controllers:
            raise ModelError("a joint policy needs at least one agent's controller")

    @property
    def controllers(self) -> tuple[FiniteStateController, ...]:
        """The agents' controllers."""
        return self._controllers

    @property
    def num_agents(self) -> int:
        """The number of agents."""
        return len(self.controllers)

    @property
    def num_actions(self) -> int:  # type: ignore[override]
        """The number of joint actions."""
        return math.prod(controller.num_actions for controller in self.controllers)

    @property
    def num_states(self) -> None:  # type: ignore[override]
        """None: it has no values."""

    @property
    def start(self) -> tuple[int, ...]:
        """The agents' first nodes."""
        return tuple(controller.start for controller in self.controllers)

    @property
    def num_observations(self) -> int:  # type: ignore[override]
        """The number of joint observations."""
        return math.prod(controller.num_observations for controller in self.controllers)

    @property
    def horizon(self) -> int | None:  # type: ignore[override]
        """The number of decisions up to the end of the first agent's plan; None if no plan ends."""
        return min((each.horizon for each in self.controllers if each.horizon is not None), default=None)

    def actions_at(self, nodes: Sequence[int]) -> tuple[int, ...]:
        """Return each agent's own action at its node."""
        pairs = zip(self.controllers, self._per_agent(nodes, "nodes"), strict=True)
        return tuple(controller.action_at(node) for controller, node in pairs)

    def next_nodes(self, nodes: Sequence[int], observations: Sequence[int]) -> tuple[int | None, ...]:
        """Return each agent's next node after its own observation; None at the end of its plan."""
        seen = self._per_agent(observations, "observations")
        given = zip(self.controllers, self._per_agent(nodes, "nodes"), seen, strict=True)
        return tuple(controller.next_node(node, observation) for controller, node, observation in given)

    def _per_agent(self, given: Sequence[int], what: str) -> Sequence[int]:
        if len(given) != self.num_agents:
            raise ModelError(f"{len(given)} {what} are given for {self.num_agents} agents")
        return given

    def joined(self) -> FiniteStateController | None:
        """Return a single controller over joint actions and observations; None if it has more than 20,000 nodes.

        Its nodes are the reachable combinations of the agents' nodes.
        """
        actions = [controller.num_actions for controller in self.controllers]
        seen = list(itertools.product(*(range(controller.num_observations) for controller in self.controllers)))
        index = {self.start: 0}
        pending = [self.start]
        found: list[int] = []
        successors: list[list[int | None]] = []
        for nodes in pending:  # it grows meanwhile
            found.append(int(np.ravel_multi_index(self.actions_at(nodes), actions)))
            row: list[int | None] = []
            for observations in seen:
                after = self.next_nodes(nodes, observations)
                joint = tuple(node for node in after if node is not None)
                if len(joint) < len(after):
                    row.append(None)
                    continue
                if joint not in index:
                    if len(index) == _MOST:
                        return None
                    index[joint] = len(index)
                    pending.append(joint)
                row.append(index[joint])
            successors.append(row)
        return FiniteStateController(found, successors, self.num_actions)

    def mismatch(self, model: MDP) -> str | None:
        """Return why it does not fit a model, as a sentence; None if it fits."""
        if model.observation_space is None:
            return "the policy needs observations, but the model has none"
        if self.num_agents != model.num_agents:
            return f"the policy is for {self.num_agents} agents, but the model has {model.num_agents}"
        if len(model.observation_space.factors) != model.num_agents:
            return f"the model's observations need a factor for each of its {model.num_agents} agents"
        factors = zip(self.controllers, model.action_space.factors, model.observation_space.factors, strict=True)
        for agent, (controller, actions, observations) in enumerate(factors):
            ours, theirs = (controller.num_actions, controller.num_observations), (len(actions), len(observations))
            if ours != theirs:
                return f"agent {agent}: {other_sizes(ours, ('actions', 'observations'), theirs)}"
        return None

    def facts(self) -> dict[str, Any]:
        """Return its sizes by name."""
        nodes = [controller.num_nodes for controller in self.controllers]
        return {**super().facts(), "agents": self.num_agents, "nodes": nodes}

    def packed(self) -> Packed:
        """Return its sizes and arrays."""
        sizes: dict[str, int] = {"agents": self.num_agents}
        arrays: dict[str, Any] = {}
        for agent, controller in enumerate(self.controllers):
            own_sizes, own_arrays = controller.packed()
            sizes |= {f"agent{agent}_{name}": size for name, size in own_sizes.items()}
            arrays |= {f"agent{agent}_{name}": array for name, array in own_arrays.items()}
        return sizes, arrays

    @classmethod
    def unpacked(cls, sizes: Mapping[str, int], arrays: Arrays, seed: int | None) -> Self:
        """Return a packed policy."""

        def own(agent: int, of: Mapping[str, Any]) -> dict[str, Any]:
            prefix = f"agent{agent}_"
            return {name.removeprefix(prefix): value for name, value in of.items() if name.startswith(prefix)}

        controllers = []
        for agent in range(sizes["agents"]):
            try:
                controllers.append(FiniteStateController.unpacked(own(agent, sizes), own(agent, arrays), seed))
            except KeyError as error:
                raise KeyError(f"agent{agent}_{error.args[0]}") from None
        return cls(controllers)
