"""Influences of the last observations on a decision.

An observation is removed, the policy's information is computed again without it (time has passed, and nothing of it
was seen), and so is the margin of the chosen action over the best other one. Of a joint observation each agent's or
factor's component is removed alone. Cost: one run of the filter over the updates for each component.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.errors import ModelError
from mdm.explanation.case import Rerun, belief_of, parts_of
from mdm.policies import Scores

if TYPE_CHECKING:
    from mdm.explanation.case import Case
    from mdm.models.matrices import Vector


class Influence(msgspec.Struct, frozen=True):
    """The influence of an observation on a decision.

    Attributes:
        epoch: The decision that came after the observation.
        of: The agent or factor whose component it is; empty where observations have one component.
        observation: Its name.
        without: The margin of the chosen action without it; None where none can be computed.
        change: The margin with it, less the margin without it; None where one of them is unknown.
        action: The name of the action that would have been chosen without it; None where the policy draws or searches.
        decisive: Whether that is another one.
    """

    epoch: int
    of: str
    observation: str
    without: float | None
    change: float | None
    action: str | None
    decisive: bool


def influences(case: Case) -> list[Influence]:
    """Return the influence of each observation of a case, the first one first.

    Raises:
        ModelError: If updates cannot be taken again; a sentence says why.
    """
    rerun = Rerun(case)
    searches = getattr(case.policy, "deliberates", False)
    with_it = _margin(case, case.at)
    found = []
    for number, update in enumerate(case.updates):
        for of, name, without in parts_of(case, update):
            changed = (*case.updates[:number], update._replace(observation=without), *case.updates[number + 1 :])
            at = rerun.at(changed)
            without_it = _margin(case._replace(at=at, updates=changed), at)
            change = None if with_it is None or without_it is None else with_it - without_it
            action = None if searches else _action(case, at)
            found.append(
                Influence(
                    *(update.epoch, of, name, without_it, change),
                    None if action is None else case.action_name(action),
                    action is not None and action != case.action,
                )
            )
    return found


def strongest(found: list[Influence]) -> Influence | None:
    """Return the influence that has changed the margin most; of equal ones the last, and None where none did.

    One without which another action would have been chosen, and the margin of this one would not even be known, comes
    before all whose change is a number.
    """
    lost = [each for each in found if each.change is None and each.decisive]
    known = [each for each in found if each.change]
    most = max((abs(each.change or 0.0) for each in known), default=0.0)
    return next(reversed(lost or [each for each in known if abs(each.change or 0.0) == most]), None)


def _margin(case: Case, at: object) -> float | None:
    scores = scores_at(case, at, belief_of(case))
    found = None if scores is None else margin(scores.numbers, case.action)
    return found if found is None or np.isfinite(found) else None


def _action(case: Case, at: object) -> int | None:
    try:
        return int(case.policy.action(at))
    except ModelError:  # as of a belief for which a policy has no vectors
        return None


def scores_at(case: Case, at: Any, belief: Vector | None) -> Scores | None:
    """Return the numbers that the policy of a case compares at an information state; None if it compares nothing.

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
