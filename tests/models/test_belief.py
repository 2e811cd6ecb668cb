from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, strategies as st

from mdm import load_model
from mdm.errors import ModelError
from mdm.models import POMDP, BeliefTracker, Factor, Space

PROBLEMS = ("GridSmall", "broadcastChannel", "dectiger", "fireFighting_2_3_3", "recycling", "relay4")


@st.composite
def models(draw):
    states, actions = draw(st.integers(1, 5)), draw(st.integers(1, 3))
    shape = draw(st.lists(st.integers(1, 3), min_size=1, max_size=2))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))

    def rows(*size):
        array = random.random(size) * (random.random(size) < 0.6)
        array[..., 0] += 0.05
        return array / array.sum(axis=-1, keepdims=True)

    observations = Space(Factor(f"agent{i}", size) for i, size in enumerate(shape))
    return POMDP(
        rows(actions, states, states),
        rows(actions, states, len(observations)),
        np.zeros((states, actions)),
        discount=0.9,
        observation_names=observations,
        initial_belief=rows(states),
        sparse=draw(st.booleans()),
    )


def plain_update(model, belief, action, likely):
    """Bayes' rule with loops over single entries."""
    transitions, observations = model.transition_matrix(action), model.observation_matrix(action)
    size = len(belief)
    joint = [
        sum(belief[s] * transitions[s, t] for s in range(size)) * sum(observations[t, o] for o in likely)
        for t in range(size)
    ]
    total = sum(joint)
    return total, [value / total for value in joint] if total > 0 else belief


@given(models(), st.data())
def test_agrees_with_bayes_rule(model, data):
    tracker = BeliefTracker(model)
    belief = list(model.initial_belief)
    shape = model.observation_space.shape
    for _ in range(data.draw(st.integers(1, 6))):
        action = data.draw(st.integers(0, len(model.action_space) - 1))
        observation = data.draw(
            st.none()
            | st.integers(0, len(model.observation_space) - 1)
            | st.tuples(*(st.none() | st.integers(0, size - 1) for size in shape))
        )
        every = list(np.ndindex(*shape))
        if isinstance(observation, tuple):
            likely = [
                i for i, o in enumerate(every) if all(c in (None, x) for c, x in zip(observation, o, strict=True))
            ]
        else:
            likely = range(len(every)) if observation is None else [observation]
        expected, belief = plain_update(model, belief, action, likely)
        before = tracker.belief
        assert tracker.update(action, observation) == pytest.approx(expected, abs=1e-12)
        np.testing.assert_allclose(tracker.belief, belief, atol=1e-12)
        if expected == 0:
            assert tracker.belief is before


@pytest.mark.parametrize("problem", PROBLEMS)
@pytest.mark.parametrize("sparse", [False, True])
def test_agrees_with_madp(corpus, problem, sparse):
    """Belief sequences that MADP itself computed, to 1e-12."""
    oracle = json.loads((corpus / "oracles" / f"{problem}.dpomdp.json").read_text())
    path = next((corpus / "models" / "madp").glob(f"{problem}.dpomdp*"))
    model = load_model(path, sparse=sparse)
    compared = 0
    for sequence in oracle["belief_sequences_JointBelief"]:
        tracker = BeliefTracker(model)
        for step in sequence["steps"]:
            probability = tracker.update(step["a"], step["o"])
            assert probability == pytest.approx(step["eta"], abs=1e-12)
            if probability > 0:
                np.testing.assert_allclose(tracker.belief, step["b"], atol=1e-12)
                compared += 1
    assert compared > 0


def tiger():
    listen = [[0.85, 0.15], [0.15, 0.85]]
    return POMDP([np.eye(2)], [listen], [[-1.0], [-1.0]], discount=0.95)


def test_a_belief_that_was_handed_out_never_changes():
    tracker = BeliefTracker(tiger())
    tracker.update(0, 0)
    handed = tracker.belief
    copy = handed.copy()
    tracker.update(0, 1)
    np.testing.assert_array_equal(handed, copy)
    with pytest.raises(ValueError, match="read-only"):
        handed[0] = 1


def test_stays_normalised_through_many_updates():
    tracker = BeliefTracker(tiger())
    for step in range(20_000):
        tracker.update(0, step % 7 % 2)
    assert tracker.belief.sum() == pytest.approx(1, abs=1e-12)
    assert np.isfinite(tracker.belief).all()


@pytest.mark.parametrize("belief", [[0.5, 0.6], [np.nan, 1], [-0.1, 1.1], [1.0], [0.5, 0.25, 0.25], [np.inf, 0]])
def test_what_is_no_distribution_is_refused_and_changes_nothing(belief):
    tracker = BeliefTracker(tiger())
    tracker.update(0, 0)
    before = tracker.belief
    with pytest.raises(ModelError, match="the belief"):
        tracker.reset(belief)
    assert tracker.belief is before


@pytest.mark.parametrize(
    ("action", "observation", "message"),
    [(1, 0, "no action 1"), (-1, 0, "no action -1"), (0, 2, "no observation 2"), (0, -1, "no observation -1")]
    + [(0, (0, 1), "1 components, not 2"), (0, (5,), "no symbol 5"), (3, None, "no action 3")],
)
def test_unknown_symbols_are_refused(action, observation, message):
    tracker = BeliefTracker(tiger())
    with pytest.raises(ModelError, match=message):
        tracker.update(action, observation)


def test_symbols_may_be_numbers_of_numpy_or_names():
    tracker, same = BeliefTracker(tiger()), BeliefTracker(tiger())
    for observation in (np.int64(1), ("1",), (np.int32(1),)):
        assert tracker.update(np.int64(0), observation) == pytest.approx(same.update(0, 1))
        np.testing.assert_allclose(tracker.belief, same.belief, atol=1e-15)
