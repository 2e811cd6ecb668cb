"""Whether a policy is of a model's sizes."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from mdm.models import POMDP
from mdm.policies import (
    AlphaVectors,
    DeterministicPolicy,
    FiniteStateController,
    JointController,
    MaskedAlphaVectors,
    MixedAlphaVectors,
    QTable,
    StagedPolicy,
    StochasticPolicy,
)

if TYPE_CHECKING:
    from mdm.models import MDP

__all__ = ["LoadedPolicy", "misfit"]

LoadedPolicy: TypeAlias = (
    AlphaVectors
    | DeterministicPolicy
    | FiniteStateController
    | JointController
    | MaskedAlphaVectors
    | MixedAlphaVectors
    | QTable
    | StagedPolicy
    | StochasticPolicy
)
"""Whatever a policy's file may hold."""


def misfit(policy: LoadedPolicy, model: MDP) -> str | None:
    """Return what is wrong between a policy and the model that it is to be for, or None."""
    sizes = len(model.state_space), len(model.action_space)
    if isinstance(policy, FiniteStateController | JointController):
        if not isinstance(model, POMDP):
            return "the policy goes by observations, but the model has none"
        if isinstance(policy, JointController):
            return _joint_misfit(policy, model)
        seen = policy.num_actions, policy.num_observations
        has = len(model.action_space), len(model.observation_space)
        if seen != has:
            return _sentence(*seen, "actions", "observations", *has)
        if policy.num_states not in {None, sizes[0]}:
            return f"the nodes' values are for {policy.num_states} states, but the model has {sizes[0]}"
        return None
    if (policy.num_states, policy.num_actions) != sizes:
        return _sentence(policy.num_states, policy.num_actions, "states", "actions", *sizes)
    return None


def _joint_misfit(policy: JointController, model: POMDP) -> str | None:
    if policy.num_agents != model.num_agents:
        return f"the policy is for {policy.num_agents} agents, but the model has {model.num_agents}"
    if len(model.observation_space.factors) != model.num_agents:
        return f"the model's observations are not one for each of its {model.num_agents} agents"
    factors = zip(policy.controllers, model.action_space.factors, model.observation_space.factors, strict=True)
    for agent, (controller, actions, observations) in enumerate(factors):
        seen, has = (controller.num_actions, controller.num_observations), (len(actions), len(observations))
        if seen != has:
            return f"agent {agent}: {_sentence(*seen, 'actions', 'observations', *has)}"
    return None


def _sentence(first: int, second: int, what: str, other: str, has_first: int, has_second: int) -> str:
    return f"the policy is for {first} {what} and {second} {other}, but the model has {has_first} and {has_second}"
