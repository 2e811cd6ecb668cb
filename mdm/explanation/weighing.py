"""Weighing: what a policy compares at a decision, and by how much the chosen action is ahead of the others."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import ModelError
from mdm.policies import Scores

if TYPE_CHECKING:
    from mdm.explanation.case import Case
    from mdm.models.matrices import Vector

__all__ = ["margin", "scores_at", "second"]


def scores_at(case: Case, at: Any, belief: Vector | None) -> Scores | None:
    """Return what the policy of a case compares at an information state; None if it compares nothing.

    A policy of another kind is asked for ``q_values``, where it has them. Of a plan whose nodes have values, the number
    of an action is the value of the present node, or of the best node that stands for it, at the belief.

    Args:
        case: The case.
        at: The information state.
        belief: The belief there, where it is known and ``at`` is none.
    """
    policy: Any = case.policy
    if getattr(policy, "input", "belief") == "observation":
        if belief is None or len(policy.controllers) > 1 or policy.controllers[0].values is None:
            return None
        (controller,), (node,) = policy.controllers, at
        values = controller.values.dot(belief)
        numbers = np.full(controller.num_actions, -np.inf)
        np.maximum.at(numbers, list(controller.actions), values)
        numbers[controller.actions[node]] = values[node]
        return Scores("value", numbers)
    found: Scores | None = policy.scores(at) if hasattr(policy, "scores") else None
    if found is None and hasattr(policy, "q_values"):
        return Scores("value", np.asarray(policy.q_values(at), dtype=np.float64))
    return found


def second(numbers: Vector, action: int) -> int | None:
    """Return the best of the other actions, the lowest of equal ones; None where none is weighed."""
    if not 0 <= action < len(numbers):
        raise ModelError(f"there is no action {action}; the {len(numbers)} actions count from 0")
    others = np.array(numbers, dtype=np.float64)
    others[action] = -np.inf
    best = int(others.argmax())
    return None if others[best] == -np.inf else best


def margin(numbers: Vector, action: int) -> float | None:
    """Return by how much an action is ahead of the best other one; below 0 where it is behind.

    It is None where either is not weighed.
    """
    best = second(numbers, action)
    return None if best is None or numbers[action] == -np.inf else float(numbers[action] - numbers[best])
