"""Solving where not all actions are available: what solvers are given, and the policies that are made of theirs.

Values of an MDP are right as they are, for the first available action stands in. In a POMDP what an action tells would
still count where it is not available: it is made so dear there that any available policy earns more. The agent knows
what is available (`mdm.models.availability.check_known`), so that bounds at beliefs that occur stay those of available
actions. Alpha vectors are kept for the states where their action is available. Beside them stand those of a policy that
takes the first available action: where the best vector's action is not available, these are above it.
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import ConfigError
from mdm.models.availability import first_available
from mdm.policies import AlphaVectors, DeterministicPolicy, MaskedAlphaVectors, QTable, StagedPolicy
from mdm.solvers.evaluation import state_values

if TYPE_CHECKING:
    from mdm.models import MDP, Durations

__all__ = ["dear", "limited"]


def dear(model: MDP, solver: str, options: dict[str, Any]) -> MDP:
    """Return a model to be solved, in which what is not available is too dear to be chosen; an MDP is itself.

    Raises:
        ConfigError: If the solver cannot tell what is available, or the discount of a POMDP is 1.
    """
    if model.available is None or model.pomdp is None:
        return model
    if solver == "jesp" or options.get("horizon") is not None:
        raise ConfigError(
            "plans for the agents of a team, and for a horizon, do not know which actions are available: take sarsop, "
            "or perseus without a horizon",
            key="solver",
        )
    if model.discount == 1:
        raise ConfigError("where not all actions of a POMDP are available, its discount is below 1", key="discount")
    least, most = (float(end) / (1 - model.discount) for end in (model.rewards.min(), model.rewards.max()))
    price = least - model.discount * most - max(most - least, 1.0)
    made = copy.copy(model)
    rewards = np.where(model.available, model.rewards, price)
    rewards.setflags(write=False)
    vars(made).update(_rewards=rewards, outcome_rewards=None, available=None, stacked={})
    return made


def limited(policy: Any, model: MDP, durations: Durations | None) -> Any:
    """Return the policy of a solver that chooses available actions alone."""
    available = model.available
    if available is None:
        return policy
    if isinstance(policy, QTable | StagedPolicy):
        return type(policy)(np.where(available, policy.values, -np.inf))
    assert isinstance(policy, AlphaVectors)
    first = first_available(available)
    values = state_values(model, DeterministicPolicy(first, available.shape[1]), durations=durations)
    vectors = [{int(s): float(values[s]) for s in np.flatnonzero(first == action)} for action in np.unique(first)]
    actions = np.unique(first).tolist()
    for action, vector in zip(policy.actions, policy.vectors, strict=True):
        if (states := np.flatnonzero(available[:, action])).size:
            vectors.append(dict(zip(states.tolist(), vector[states].tolist(), strict=True)))
            actions.append(action)
    return MaskedAlphaVectors(vectors, actions, *available.shape)
