"""Expectations: a model's next states and observations, after an action in a state or on a belief.

Next states are predicted by T; an observation's probability is that of Bayes' rule, P(o | b, a), as the belief's filter
has it. Cost: a step of the filter for each observation.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import numpy as np

from mdm.beliefs import BeliefTracker, Support
from mdm.errors import ModelError
from mdm.explanation.case import spelt

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mdm.explanation.case import Case
    from mdm.models import MDP
    from mdm.models.matrices import Vector

_MOST = 1_000
"""Observations whose probabilities are computed."""


class Chance(msgspec.Struct, frozen=True):
    """A state or observation, by name, and its probability."""

    name: str
    probability: float


def likeliest(pairs: Iterable[tuple[str, float]], most: int) -> tuple[Chance, ...]:
    """Return the most probable of names with probabilities, the first of equal ones; none of probability 0."""
    known = [Chance(name, float(probability)) for name, probability in pairs if probability > 0]
    return tuple(sorted(known, key=lambda chance: -chance.probability)[:most])


def expected_next(case: Case, belief: Vector, most: int = 3) -> tuple[tuple[Chance, ...], tuple[Chance, ...]]:
    """Return the most probable next states and observations after the action of a case.

    Args:
        case: The case.
        belief: The belief that it was decided on, S numbers; of a known state it is certain.
        most: How many of each.

    Returns:
        Chances of states and of observations; of an MDP there are no observations.

    Raises:
        ModelError: If there is no model, or one of another kind; a sentence says so.
    """
    model = case.model
    if model is None:
        raise ModelError("there is no model: what comes next is unknown")
    if len(belief) != len(model.state_space) or not 0 <= case.action < len(model.action_space):
        raise ModelError("the model is the whole team's, and one agent decided: what comes next is unknown")
    (states,) = np.nonzero(belief)
    here = Support(states, belief[states])
    after = _next_states(model, here, case.action)
    space = model.state_space
    top = np.argsort(-after.probabilities, kind="stable")[:most].tolist()
    expected = [(spelt(space, space.unravel(int(after.states[i]))), float(after.probabilities[i])) for i in top]
    return likeliest(expected, most), _next_observations(model, here, case.action, most)


def _next_states(model: MDP, here: Support, action: int) -> Support:
    if model.pomdp is not None:
        tracker = BeliefTracker(model.pomdp)
        tracker.reset(here)
        tracker.update(action, None)
        found = tracker.support
        order = np.argsort(found.states)
        return Support(found.states[order], found.probabilities[order])
    total = sum(
        probability * np.asarray(model.transition(action, state))
        for state, probability in zip(here.states.tolist(), here.probabilities.tolist(), strict=True)
    )
    dense: Vector = np.asarray(total)
    (states,) = dense.nonzero()
    return Support(states, dense[states])


def _next_observations(model: MDP, here: Support, action: int, most: int) -> tuple[Chance, ...]:
    if model.pomdp is None:
        return ()
    space = model.pomdp.observation_space
    if len(space) > _MOST:
        return ()
    tracker = BeliefTracker(model.pomdp)
    chances = []
    for observation in range(len(space)):
        tracker.reset(here)
        chances.append((spelt(space, space.unravel(observation)), tracker.update(action, observation)))
    return likeliest(chances, most)
