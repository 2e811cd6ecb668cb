"""Whether a table over states is still that of its model, as far as a moment of work tells.

A text file of a table holds numbers alone. Where the states of the model were put in another order since, or its
rewards changed, the sizes still fit, and the robot would act on another model. One backup of Bellman's equation tells:
of values that solve the model, or of the exact values of a list of actions, it changes nothing (R. Bellman, *Dynamic
programming*, 1957). It costs A products with an S x S matrix, and for a list of actions a linear system besides.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import Error
from mdm.models.durations import discounts_in_time
from mdm.models.units import check_steps
from mdm.policies import DeterministicPolicy, QTable

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.models import MDP, Durations
    from mdm.models.matrices import Vector

__all__ = ["stale"]

_MOST = 4_000_000
"""Entries of T, over all actions, up to which a table is looked at."""
_SHARE = 0.01
"""The part of the greatest reward by which values may differ: solvers stop at a gap, and files round."""


def stale(model: MDP, policy: Any, model_file: str, policy_file: str, durations: Durations | None = None) -> str | None:
    """Return that a policy's file seems to be of another model, with the state that shows it; None where it does not.

    Args:
        model: The model.
        policy: The policy; only tables over states of one action each are looked at.
        model_file: The file of the model, to be named.
        policy_file: The file of the policy, to be named.
        durations: How long actions take in the model.
    """
    size = len(model.state_space)
    if type(policy) not in {DeterministicPolicy, QTable} or size**2 * policy.num_actions > _MOST:
        return None
    if policy.mismatch(model) is not None:
        return None
    try:
        backed_up = _backup(model, durations)
        if isinstance(policy, QTable):
            found = _of_values(model, policy, backed_up)
        else:
            from mdm.solvers.evaluation import state_values  # noqa: PLC0415 - values of actions need no solver

            values = backed_up(state_values(model, policy, durations=durations))
            found = _of_actions(model, policy, values)
    except Error:
        return None  # there may be no value at a discount of 1, nor at one of a second without times
    if found is None:
        return None
    policy_name, model_name = Path(policy_file).name, Path(model_file).name
    return f"{policy_name} is not that of {model_name}: {found}; solve again, if the model was changed since"


def _backup(model: MDP, durations: Durations | None) -> Callable[[Vector], Vector]:
    """Return what turns V(s') into R(s, a) + g sum T(s' | s, a) V(s'), S x A.

    Raises:
        ModelError: If it is not known how much time is discounted.
    """
    rewards, discounts = model.rewards, np.full(model.rewards.shape, model.discount)
    if durations is None:
        check_steps(model)
    else:
        discounts, rewards = discounts_in_time(model, durations), durations.rewards(model)

    def backed_up(values: Vector) -> Vector:
        nexts = [model.transition_matrix(action) @ values for action in range(len(model.action_space))]
        result: Vector = rewards + discounts * np.stack(nexts, axis=1)
        return result

    return backed_up


def _margin(model: MDP) -> float:
    return _SHARE * float(np.abs(model.rewards).max())


def _of_values(model: MDP, policy: QTable, backed_up: Callable[[Vector], Vector]) -> str | None:
    values = backed_up(policy.values.max(axis=1))
    differ = np.abs(values - policy.values)
    differ[~np.isfinite(policy.values)] = 0  # an action that is not allowed there
    state, action = np.unravel_index(int(differ.argmax()), differ.shape)
    if differ[state, action] <= _margin(model):
        return None
    pair = f"{model.action_space.names[int(action)]!r} in {model.state_space.names[int(state)]!r}"
    return f"of {pair} it says {policy.values[state, action]:.4g}, where that model gives {values[state, action]:.4g}"


def _of_actions(model: MDP, policy: DeterministicPolicy, values: Vector) -> str | None:
    own = values[np.arange(len(values)), list(policy.actions)]
    lost = values.max(axis=1) - own
    state = int(lost.argmax())
    if lost[state] <= _margin(model):
        return None
    better, chosen = model.action_space.names[int(values[state].argmax())], policy.actions[state]
    return (
        f"in {model.state_space.names[state]!r} that model has {better!r} worth {lost[state]:.4g} more than "
        f"{model.action_space.names[chosen]!r}"
    )
