"""The scope of a control layer: the whole team's symbols, or those of the one agent whose controller it runs."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from mdm.errors import ConfigError
from mdm.formats.fit import misfit
from mdm.models import Factor, Space
from mdm.policies import Controller, FiniteStateController, JointController

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.models import MDP
    from mdm.policies import Policy

__all__ = ["Scope", "agent_index"]


class Scope(NamedTuple):
    """What a control layer runs, and the symbols that it speaks in.

    Attributes:
        policy: The policy.
        actions: What its actions are called; None without a model.
        observations: The observations that it takes; None where it takes none that are known.
    """

    policy: Policy | Controller
    actions: Space | None
    observations: Space | None

    @classmethod
    def of(cls, policy: Policy | Controller, model: MDP | None, agent: int | str | None) -> Scope:
        """Return the scope of the team (None) or of one agent, by its index or name.

        Raises:
            ConfigError: If there is no such agent, the policy has no part that is an agent's own, or a controller does
                not fit the model.
        """
        actions: Space | None = None if model is None else model.action_space
        observations: Space | None = getattr(model, "observation_space", None)
        if not isinstance(policy, FiniteStateController | JointController):
            if agent is not None:
                raise ConfigError(
                    "the policy decides for the whole team: only a controller per agent can be run by one agent alone",
                    key="local",
                )
            return cls(policy, actions, observations)
        wrong = None if model is None else misfit(policy, model)
        if wrong is not None:
            raise ConfigError(wrong, key="policy")
        controllers = policy.controllers if isinstance(policy, JointController) else (policy,)
        if observations is None:
            observations = Space(Factor(f"agent{i}", each.num_observations) for i, each in enumerate(controllers))
        if agent is None:
            return cls(policy, actions, observations)
        if not isinstance(policy, JointController):
            raise ConfigError("the policy is one controller for the whole team, not one for each agent", key="local")
        names = [] if actions is None else [factor.name for factor in actions.factors]
        own = agent_index(agent, names, policy.num_agents)
        return cls(
            controllers[own],
            None if actions is None else Space([actions.factors[own]]),
            Space([observations.factors[own]]),
        )


def agent_index(agent: int | str, names: Sequence[str], count: int) -> int:
    """Return which of a team's agents one is, given by index or by name.

    Raises:
        ConfigError: If there is no such agent.
    """
    if isinstance(agent, str):
        if agent not in names:
            known = f"the agents are {', '.join(names)}" if names else "without a model agents go by their index"
            raise ConfigError(f"there is no agent {agent!r}; {known}", key="agent")
        return list(names).index(agent)
    if not 0 <= agent < count:
        raise ConfigError(f"there is no agent {agent}; the model has {count}, from 0 on", key="agent")
    return agent
