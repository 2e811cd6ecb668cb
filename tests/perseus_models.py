"""Models and plain recursion for the tests of Perseus."""

from __future__ import annotations

import warnings

import numpy as np
from hypothesis import strategies as st
from random_models import dense, flat_models

from mdm import ModelWarning
from mdm.models import POMDP

SEEDS = st.integers(0, 2**32 - 1)
SMALL = flat_models(kinds=("POMDP",), joint=False, events=True, finer=False)


def parts(model, false_negative=None):
    """Return for each action what is earned until something is detected, and what then follows each observation."""
    size = len(model.state_space)
    result = []
    for action in range(len(model.action_space)):
        joints = {
            o: dense(model.joint_matrix(action, o)) for o in range(len(model.observation_space)) if o != false_negative
        }
        missed = dense(model.transition_matrix(action)) - sum(joints.values())
        missed[np.abs(missed) < 1e-9] = 0
        during = np.linalg.inv(np.eye(size) - model.discount * missed)
        result.append((during @ model.rewards[:, action], [during @ joint for joint in joints.values()]))
    return result


def recursion(each, discount, belief, depth, rest=0.0):
    """Return the greatest value of so many decisions from an unnormalised belief; then comes the rest."""
    if not depth:
        return rest * belief.sum()
    return max(
        belief @ earned
        + discount * sum(recursion(each, discount, belief @ m, depth - 1, rest) for m in after if (belief @ m).any())
        for earned, after in each
    )


def reachable(each, belief, depth):
    """Return all beliefs that so many decisions lead to, and those on the way."""
    found, level = [belief], [belief]
    for _ in range(depth):
        after = [b @ m for b in level for _, matrices in each for m in matrices]
        level = [b / b.sum() for b in after if b.sum() > 1e-12]
        found += level
    return np.stack(found)


def events(seed, *, told=1.0, size=4):
    """Return a random model whose observations tell of transitions."""
    random = np.random.default_rng(seed)
    observations = told * np.moveaxis(random.dirichlet(np.ones(3), size=(2, size, size)), -1, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        return POMDP(
            random.dirichlet(np.ones(size), size=(2, size)),
            observations,
            random.normal(size=(size, 2)),
            discount=0.85,
            event_observations=True,
        )
