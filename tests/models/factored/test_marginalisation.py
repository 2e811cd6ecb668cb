"""A state factor dropped: sums over its values, entry by entry."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_models import dense, distributions
from sentences import refused

from mdm import ModelError, load_model
from mdm.errors import ModelWarning
from mdm.models import MDP, POMDP, Factor, Space


@st.composite
def models(draw):
    """Return a model with a factor that nothing depends on, which factor it is, and its numbers.

    The numbers are P(y, f' | x, a), P(o | x, a, y, f') (the same for all x unless observations are events), R(x, a).
    """
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    sizes = draw(st.lists(st.integers(1, 3), min_size=2, max_size=3))
    place = draw(st.integers(0, len(sizes) - 1))
    values, rest = sizes[place], int(np.prod(sizes)) // sizes[place]
    actions, count = draw(st.integers(1, 2)), draw(st.integers(1, 3))
    events = draw(st.booleans())
    moves = distributions(random, actions, rest, rest * values).reshape(actions, rest, rest, values)
    seen = distributions(random, actions, rest if events else 1, rest, values, count)
    seen = np.broadcast_to(seen, (actions, rest, rest, values, count))
    rewards = random.normal(size=(rest, actions))
    # joint[x, f] is the index of the rest at x and the factor at f
    joint = np.moveaxis(np.arange(rest * values).reshape(sizes), place, -1).reshape(rest, values)
    size = rest * values
    transitions, told = np.zeros((actions, size, size)), np.zeros((actions, count, size, size))
    table = np.zeros((size, actions))
    for x, f, y, g in np.ndindex(rest, values, rest, values):
        transitions[:, joint[x, f], joint[y, g]] = moves[:, x, y, g]
        told[:, :, joint[x, f], joint[y, g]] = seen[:, x, y, g]
        table[joint[x, f]] = rewards[x]
    start = distributions(random, size)
    common = {
        "discount": 0.9,
        "states": Space(Factor(f"f{index}", count_) for index, count_ in enumerate(sizes)),
        "initial_belief": start,
        "sparse": draw(st.booleans()),
    }
    if draw(st.booleans()):
        model = MDP(transitions, table, **common)
    elif events:
        model = POMDP(transitions, told, table, event_observations=True, **common)
    else:
        model = POMDP(transitions, told[:, :, 0].swapaxes(1, 2), table, **common)
    return model, f"f{place}", moves, seen, rewards, start[joint].sum(axis=1)


@given(models())
def test_sums_over_the_dropped_factor(described):
    model, name, moves, seen, rewards, start = described
    small = model.marginalize(name)
    assert name not in [factor.name for factor in small.state_space.factors]
    assert small.discount == model.discount
    np.testing.assert_allclose(small.initial_belief, start, atol=1e-12)
    np.testing.assert_allclose(small.rewards, rewards, atol=1e-12)
    for action in range(len(moves)):
        np.testing.assert_allclose(dense(small.transition_matrix(action)), moves[action].sum(axis=-1), atol=1e-12)
        if model.kind == "MDP":
            continue
        for x, y in np.ndindex(moves.shape[1], moves.shape[2]):
            chances = moves[action, x, y]
            if chances.sum() > 0:
                expected = chances @ seen[action, x, y] / chances.sum()
                found = small.observation(action, y, state=x)
                np.testing.assert_allclose(found, expected, atol=1e-12)


def test_what_others_depend_on_is_kept():
    states = Space([Factor("here", ["a", "b"]), Factor("lamp", ["off", "on"])])
    copies = np.zeros((1, 4, 4))
    for x, f in np.ndindex(2, 2):
        copies[0, 2 * x + f, 2 * f + f] = 1  # here' is what lamp was
    with refused(ModelError):
        MDP(copies, np.zeros((4, 1)), discount=0.9, states=states).marginalize("lamp")
    paid = np.array([[0.0], [1.0], [0.0], [1.0]])
    with refused(ModelError):
        MDP([np.eye(4)], paid, discount=0.9, states=states).marginalize("lamp")
    small = MDP([np.eye(4)], paid, discount=0.9, states=states).marginalize("here")
    assert small.state_space.factors[0].names == ("off", "on")
    with refused(ModelError):
        MDP([np.eye(4)], paid, discount=0.9, states=states).marginalize("nope")
    with refused(ModelError):
        small.marginalize("lamp")


@pytest.mark.foreign("MAISS_TopLevel.pgmx of MADPToolbox/MADP")
def test_the_original_s_factor_of_events(corpus):
    """Nothing depends on the present value of Events: so MADP drops it for the top level's controllers."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        model = load_model(corpus / "models" / "madp" / "MAISS_TopLevel.pgmx")
        small = model.marginalize("Events")
    assert len(small.state_space) == 1584 // 11
    assert small.event_observations
    assert [factor.name for factor in small.state_space.factors] == (
        [factor.name for factor in model.state_space.factors if factor.name != "Events"]
    )
    for action in range(16):
        np.testing.assert_allclose(np.asarray(small.transition_matrix(action).sum(axis=1)).ravel(), 1, atol=1e-9)
