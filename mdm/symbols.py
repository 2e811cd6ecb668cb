"""The symbols of a decision process: states, observations and actions by index, name or components."""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING, Any, Literal, SupportsIndex

import numpy as np

from mdm.beliefs import Support
from mdm.errors import ConfigError, ModelError
from mdm.models import Factor, Space
from mdm.models.matrices import distribution

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.models.space import Symbol

__all__ = ["Symbols", "agent_index"]


class Symbols:
    """The symbols of a policy, for the whole team or for one agent's part of a plan.

    Args:
        policy: The policy.
        model: The model with their names, or None.
        agent: The agent, by index or name; None for the whole team.

    Raises:
        ConfigError: If there is no such agent, or the policy has no part for a single agent.

    Attributes:
        policy: The policy, or the agent's part of it.
        state_space, action_space, observation_space: The symbols; None if they are unknown.
        takes: The input of the policy: ``state`` or ``observation``.
        num_states: S; None if it is unknown.
    """

    takes: Literal["state", "observation"] = "observation"

    def __init__(self, policy: Any, model: MDP | None, agent: int | str | None) -> None:
        self.policy = policy
        self.state_space: Space | None = None if model is None else model.state_space
        self.action_space: Space | None = None if model is None else model.action_space
        self.observation_space: Space | None = getattr(model, "observation_space", None)
        self._take_part(agent)
        self.num_states: int | None = getattr(self.policy, "num_states", None)
        self.known_names: dict[int, str] = {}
        """The cache of action names."""

    def _take_part(self, agent: int | str | None) -> None:
        """Set the symbols of the whole team, or of one agent's part."""
        policy = self.policy
        plans = getattr(policy, "controllers", None)
        if plans is not None and self.observation_space is None:
            self.observation_space = Space(
                Factor(f"agent{index}", each.num_observations) for index, each in enumerate(plans)
            )
        if agent is None:
            return
        if plans is None:
            raise ConfigError(
                "the policy decides for the whole team: one agent needs a policy with a controller for each",
                key="local",
            )
        if not hasattr(policy, "num_agents"):
            raise ConfigError("the policy is one controller for the whole team, not one for each agent", key="local")
        space = self.action_space
        own = agent_index(agent, [] if space is None else [factor.name for factor in space.factors], len(plans))
        self.policy = plans[own]
        assert self.observation_space is not None
        self.observation_space = Space([self.observation_space.factors[own]])
        self.action_space = None if space is None else Space([space.factors[own]])

    def state_index(self, state: Symbol) -> int:
        """Return the index of a state, given by index or name.

        Raises:
            ModelError: If there is no such state.
        """
        if self.state_space is not None:
            return self.state_space.index(state)
        count = self.num_states
        if isinstance(state, str):
            raise ModelError(f"without a model states have no names: give the index of {state!r}")
        if isinstance(state, bool) or not isinstance(state, SupportsIndex):
            raise ModelError(f"{state!r} is not a state: give its index")
        index = operator.index(state)
        if count is not None and not 0 <= index < count:
            raise ModelError(f"there is no state {index}; the policy is for {count} states, which count from 0")
        return index

    def observed(self, observation: Any) -> tuple[int | None, tuple[int | None, ...]]:
        """Return the index of an observation, given by index, name or components, and the indices of its components.

        The index is None if a component is missing.

        Raises:
            ModelError: If there is no such observation, or the policy decides on states.
        """
        if self.takes == "state":
            raise ModelError("the policy decides on states, not on observations: give a state")
        space = self.observation_space
        if space is None:
            raise ModelError("observations need a model: there is none, or it is an MDP")
        if isinstance(observation, list | tuple) and None in observation:
            if len(observation) != len(space.factors):
                raise ModelError(f"an observation has {len(space.factors)} components, not {len(observation)}")
            indices: list[int | None] = []
            for factor, word in zip(space.factors, observation, strict=True):
                given = word is None or (word.__class__ is int and -1 < word < len(factor.names))
                indices.append(word if given else factor.index(word))
            return None, tuple(indices)
        index = space.index(observation)
        return index, space.unravel(index)

    def belief_of(self, given: Any) -> Vector:
        """Return a belief, given as an array or by the name or index of a certain state.

        Raises:
            ModelError: If there is no such state, or the policy takes no beliefs.
        """
        if self.takes == "state":
            raise ModelError("the policy is over states: it takes no belief")
        if isinstance(given, str | int | np.integer):
            if isinstance(given, bool):
                raise ModelError(f"{given!r} is no belief: give numbers, or the name or index of a state")
            if self.num_states is None:
                raise ModelError("the nodes of the plan have no values: give no belief")
            certain: Vector = np.zeros(self.num_states)
            certain[self.state_index(given)] = 1
            return certain
        if self.num_states is None:
            raise ModelError("the nodes of the plan have no values: give no belief")
        if isinstance(given, Support):
            given = given.dense(self.num_states)
        try:
            return distribution(given, what="the belief", size=self.num_states)
        except (TypeError, ValueError, OverflowError) as error:
            raise ModelError(
                f"a belief is {self.num_states} numbers, or the name or index of a state: {error}"
            ) from None

    def action_name(self, action: int) -> str:
        """Return the name of an action; its index if it has none."""
        name = self.known_names.get(action)
        if name is None:
            name = self.known_names[action] = (
                str(action) if self.action_space is None else self.action_space.names[action]
            )
        return name

    def observation_name(self, observation: Any) -> str:
        """Return the name of an observation, in quotes; its index or components if it has none."""
        space = self.observation_space
        if space is None or not isinstance(observation, int) or not 0 <= observation < len(space):
            return repr(observation)
        return repr(space.names[observation])


def agent_index(agent: int | str, names: Sequence[str], count: int) -> int:
    """Return the index of an agent, given by index or name.

    Raises:
        ConfigError: If there is no such agent.
    """
    if isinstance(agent, str):
        if agent not in names:
            known = f"the agents are {', '.join(names)}" if names else "without a model agents have indices only"
            raise ConfigError(f"there is no agent {agent!r}; {known}", key="agent")
        return list(names).index(agent)
    if not 0 <= agent < count:
        raise ConfigError(f"there is no agent {agent}; the model has {count}, which count from 0", key="agent")
    return agent
