"""What the sub-commands that tell a policy's value have in common: its world, and the value that it claims."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.formats import load_model, load_policy
from mdm.models import POMDP
from mdm.models.factored.mixed import MixedPOMDP
from mdm.policies import mismatch

if TYPE_CHECKING:
    import argparse

    from mdm.models import MDP
    from mdm.models.matrices import Vector

__all__ = ["claim", "load", "load_for", "revealed", "shown", "with_false_negatives"]


def load(path: str, discount: float | None) -> MDP:
    """Load a model, with another discount if one is given."""
    model = load_model(path)
    return model if discount is None else model.with_discount(discount)


def revealed(model: MDP) -> MDP:
    """Return a model as its agent sees it: with those factors of the state observed that are fully observed."""
    return model.revealed() if isinstance(model, POMDP) and not model.event_observations else model


def shown(model: MDP) -> str | None:
    """Return a sentence about what is seen of the state; None where nothing is but by observations."""
    if not isinstance(model, MixedPOMDP):
        return None
    names = [model.state_space.factors[place].name for place in model.observed]
    return f"the agent sees {', '.join(names)} at every step, and at the start: as the model says"


def load_for(model: MDP, path: str, arguments: argparse.Namespace) -> tuple[Any, MDP]:
    """Load a policy; return it, and the model as it is to see it, with the false negative that is asked for.

    Controllers that were made for the model's own observations see no more of the state than these tell.
    """
    seen, seed = revealed(model), arguments.seed
    if seen is not model:
        policy: Any = load_policy(path, seed=seed)
        if policy.input == "observation":
            if mismatch(policy, seen) is None:
                return policy, with_false_negatives(seen, arguments)
            seen = model
    return load_policy(path, model, seed=seed), with_false_negatives(seen, arguments)


def with_false_negatives(model: MDP, arguments: argparse.Namespace) -> MDP:
    """Return a model with the false negative that a command was given; without one as it is."""
    symbol = arguments.false_negative
    return model if symbol is None else model.with_false_negatives(symbol)


def claim(model: MDP, policy: Any) -> float | None:
    """Return what a policy says that it is worth at the start; None where it says nothing."""
    start = model.initial_belief
    if policy.input != "belief":
        value: float | None = policy.value_at(start)
        return value
    return float(sum(weight * policy.value(belief) for weight, belief in _first_beliefs(model, start)))


def _first_beliefs(model: MDP, start: Vector) -> list[tuple[float, Vector]]:
    if not isinstance(model, MixedPOMDP):
        return [(1.0, start)]
    states = np.flatnonzero(start)
    _, first = np.unique(model.seen_in[states], return_index=True)
    beliefs = [model.belief_at_start(int(state)) for state in states[first]]
    return [(float(start[belief > 0].sum()), belief) for belief in beliefs]
