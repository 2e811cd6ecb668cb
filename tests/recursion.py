"""Values of policies by plain recursion over what may be detected."""

from __future__ import annotations

import numpy as np
from hypothesis import settings, strategies as st
from random_models import dense, leading_to_detection, without_detection

from mdm.policies import (
    AlphaVectors,
)

SEEDS = st.integers(0, 2**32 - 1)


FEW = settings(max_examples=25, derandomize=True)


def vectors_for(model, random):
    """Return a policy that has nothing to do with the model's values."""
    count = len(model.action_space)
    return AlphaVectors(random.normal(size=(count + 2, len(model.state_space))), [*range(count), 0, count - 1], count)


def by_recursion(model, policy, steps, false_negative=None, belief=None):
    """Return what a policy is worth: over all that may be detected, with the true weights beside the agent's belief."""
    size = len(model.state_space)
    identity = np.eye(size)

    def joint(action, observation):
        return dense(model.joint_matrix(action, observation))

    def worth(weights, belief, left):
        action = policy.action(belief)
        if left == 1:
            return weights @ model.rewards[:, action]
        detected = [o for o in range(len(model.observation_space)) if o != false_negative]
        missed = dense(model.transition_matrix(action)) - sum(joint(action, o) for o in detected)
        lasting = np.linalg.solve((identity - model.discount * missed).T, weights)
        total = lasting @ model.rewards[:, action]
        unseen = leading_to_detection(without_detection(model, action, false_negative))
        before = np.linalg.solve((identity - unseen).T, belief)
        for o in detected:
            after = before @ joint(action, o)
            if after.sum() > 1e-12:
                total += worth(model.discount * lasting @ joint(action, o), after / after.sum(), left - 1)
        return total

    first = model.initial_belief if belief is None else belief
    return worth(first, first, steps)


def assert_within(result, exact):
    assert abs(result.mean - exact) < 5 * result.standard_error + 1e-9 * (1 + abs(exact))
