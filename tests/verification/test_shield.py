"""Shields, against an enumeration of all policies of small models."""

import itertools

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from mdm.errors import ConfigError
from mdm.models import MDP
from mdm.verification import shield, verify

SEEDS = st.integers(0, 10_000)


def drawn(seed, states=4, actions=2):
    """Return a model whose state 0 is a pit and whose state 1 is a goal, both left by nothing, from state 2 on."""
    random = np.random.default_rng(seed)
    moves = np.zeros((actions, states, states))
    for action, state in itertools.product(range(actions), range(states)):
        if state < 2:
            moves[action, state, state] = 1
            continue
        after = random.choice(states, size=random.integers(1, 3), replace=False)
        moves[action, state, after] = random.dirichlet(np.ones(len(after)))
    names = ["pit", "goal", *(f"at-{place}" for place in range(2, states))]
    begin = np.eye(states)[2]
    rewards = random.normal(size=(states, actions)).round(2)
    return MDP(moves, rewards, discount=0.9, states=names, initial_belief=begin)


def ends(model, actions, target):
    """Return the probabilities of ending in a state, by powers of the chain of some actions per state."""
    chain = np.stack([model.transition_matrix(action)[state] for state, action in enumerate(actions)])
    for _ in range(40):
        chain = chain @ chain
    return chain[:, target]


def all_ends(model, target, allowed=None):
    """Return those of all policies, and the policies."""
    size, count = len(model.state_space), len(model.action_space)
    each = [[a for a in range(count) if allowed is None or allowed[s][a]] for s in range(size)]
    found = list(itertools.product(*each))
    return np.array([ends(model, policy, target) for policy in found]), found


@hypothesis.given(seed=SEEDS)
@hypothesis.settings(max_examples=25, deadline=None)
def test_x_is_as_improbable_as_by_any_policy(seed):
    model = drawn(seed)
    least = all_ends(model, 0)[0].min(axis=0)
    for wrong in ([0] * 4, [1] * 4):
        if least[2] > 1e-9:
            with pytest.raises(ConfigError, match="no action keeps the start"):
                shield(wrong, model, avoid="pit")
            return
        try:
            safe = shield(wrong, model, avoid="pit")
        except ConfigError as error:
            assert "stand for ever" in str(error)
            continue
        assert ends(model, safe.table, 0) == pytest.approx(least, abs=1e-9)
        assert verify(model, "P(reach pit)", safe).result.value == 0


@hypothesis.given(seed=SEEDS)
@hypothesis.settings(max_examples=25, deadline=None)
def test_keep_attains_the_most_within_the_mask(seed):
    model = drawn(seed)
    pits = all_ends(model, 0)[0]
    safe = pits.min(axis=0) < 1e-9
    allowed = np.zeros((4, 2), dtype=bool)
    for state, action in itertools.product(range(4), range(2)):
        after = model.transition_matrix(action)[state] > 0
        allowed[state, action] = safe[after].all() if safe[state] else True
    if not safe[2]:
        return
    greatest = all_ends(model, 1, allowed)[0][:, 2].max()
    for wrong in ([0] * 4, [1] * 4, [0, 0, 0, 1]):
        if greatest < 1e-9:
            with pytest.raises(ConfigError, match="no way to"):
                shield(wrong, model, avoid="pit", keep="reach goal")
            continue
        its = shield(wrong, model, avoid="pit", keep="reach goal")
        assert ends(model, its.table, 1)[2] == pytest.approx(greatest, abs=1e-7)
        assert ends(model, its.table, 0)[2] == 0
        again = shield(wrong, model, avoid="pit", keep="reach goal", resolve=True)
        assert ends(model, again.table, 1)[2] == pytest.approx(greatest, abs=1e-7)
        assert ends(model, again.table, 0)[2] == 0
