"""Observations of events, and beliefs by them: with false negatives, missing components, impossible events."""

from __future__ import annotations

import warnings

import figures
import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_models import dense, distributions
from sentences import refused

from mdm import BeliefTracker, ModelError, load_model, save_model
from mdm.errors import ModelWarning
from mdm.models import POMDP, Factor, FactoredPOMDP, Node, Space, Table, TwoSliceNetwork
from mdm.problems import patrol


def by_events(transitions, told, initial, sparse, **names):
    """Return the model without rewards of which T(a, s, s') and O(a, o, s, s') are these numbers."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        return POMDP(
            transitions,
            told,
            np.zeros((len(initial), len(transitions))),
            discount=0.9,
            initial_belief=initial,
            event_observations=True,
            sparse=sparse,
            **names,
        )


@st.composite
def models(draw):
    """Return a model with event observations, and its numbers T(a, s, s') and O(a, o, s, s')."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    size, count = draw(st.integers(1, 4)), draw(st.integers(1, 2))
    shape = draw(st.lists(st.integers(1, 3), min_size=1, max_size=2))
    observations = Space(Factor(f"agent{index}", width) for index, width in enumerate(shape))
    transitions = distributions(random, count, size, size)
    told = np.moveaxis(distributions(random, count, size, size, len(observations)), -1, 1)
    if draw(st.booleans()):
        told = told * random.choice([1.0, 0.5], size=(count, 1, size, size))
    initial = distributions(random, size)
    return by_events(transitions, told, initial, draw(st.booleans()), observation_names=observations), transitions, told


@given(models())
def test_numbers_are_kept_as_they_are_given(described):
    model, transitions, told = described
    for a, o in np.ndindex(*told.shape[:2]):
        np.testing.assert_array_equal(dense(model.joint_matrix(a, o)), transitions[a] * told[a, o])
        kept = dense(model.event_matrix(a, o))
        np.testing.assert_array_equal(kept[transitions[a] > 0], told[a, o][transitions[a] > 0])
    for a, s, t in np.ndindex(*transitions.shape):
        if transitions[a, s, t] > 0:
            np.testing.assert_array_equal(model.observation(a, t, state=s), told[a, :, s, t])


def left_open(transition, told):
    """Return P(s', nothing is observed | s, a), but for what is taken for rounding."""
    rest = transition * (1 - told.sum(axis=0)).round(12)
    return rest if rest.sum(axis=1).max() > 1e-5 else np.zeros_like(rest)


def series(joint, belief, missed, symbols, unseen, terms=4000):
    """Return the sum over 0, 1, 2, ... steps without a detection before one of some events, term by term."""
    detected = sum(joint[symbol] for symbol in symbols)
    if list(symbols) == [missed]:
        return belief @ detected
    undetected = unseen if missed is None else unseen + joint[missed]
    total = np.zeros(len(belief))
    for _ in range(terms):
        total = total + belief @ detected
        belief = belief @ undetected
        if not belief.any():
            break
    return total


@pytest.mark.parametrize("folded", [4_000_000, 0])
@given(described=models(), data=st.data())
def test_beliefs_are_what_bayes_rule_says(folded, described, data):
    model, transitions, told = described
    count, width = told.shape[:2]
    missed = data.draw(st.none() | st.integers(0, width - 1)) if width > 1 else None
    tells_all = data.draw(st.booleans())
    missing = model.with_false_negatives(missed)
    if tells_all:
        missing, missed = missing.step_by_step(), None  # each symbol is of one step then
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mdm.beliefs.choice.FOLDED", folded)
        tracker = BeliefTracker(missing)
    belief = model.initial_belief
    shape = model.observation_space.shape
    for _ in range(data.draw(st.integers(1, 4))):
        action = data.draw(st.integers(0, count - 1))
        joint = transitions[action] * told[action]
        unseen = np.zeros_like(joint[0]) if tells_all else left_open(transitions[action], told[action])
        seen = data.draw(
            st.integers(0, width - 1) | st.none() | st.tuples(*(st.none() | st.integers(0, n - 1) for n in shape))
        )
        if seen is None:
            expected = belief @ transitions[action]
        else:
            every = list(np.ndindex(*shape))
            symbols = (
                [seen]
                if isinstance(seen, int)
                else [i for i, o in enumerate(every) if all(c in (None, x) for c, x in zip(seen, o, strict=True))]
            )
            if len(symbols) > 1:
                symbols = [symbol for symbol in symbols if symbol != missed]
            expected = series(joint, belief, missed, symbols, unseen)
        total = expected.sum()
        probability = tracker.update(action, seen)
        assert probability == pytest.approx(total, abs=1e-7)
        if total > 1e-6:
            belief = expected / total
            np.testing.assert_allclose(tracker.belief, belief, atol=1e-6)
        elif probability > 0:
            belief = tracker.belief
        assert tracker.belief.sum() == pytest.approx(1, abs=1e-9)


def test_states_from_which_nothing_is_detected_add_nothing():
    """From the second state nothing but false negatives follow, for ever: I - H would be singular."""
    transitions = [[[0.5, 0.5], [0.0, 1.0]]]
    told = np.array([[[[0.5, 1.0], [0.0, 1.0]], [[0.5, 0.0], [0.0, 0.0]]]])
    for sparse in (False, True):
        model = POMDP(
            transitions,
            told,
            np.zeros((2, 1)),
            discount=0.9,
            event_observations=True,
            sparse=sparse,
            initial_belief=[1, 0],
        )
        tracker = BeliefTracker(model.with_false_negatives(0))
        # detected at once 1/4, after one false negative in the first state 1/4 * 1/4, ...: 1/3 in all
        assert tracker.update(0, 1) == pytest.approx(1 / 3)
        np.testing.assert_allclose(tracker.belief, [1, 0])
        tracker.reset([0, 1])
        before = tracker.belief
        assert tracker.update(0, 1) == 0
        assert tracker.belief is before


def test_what_cannot_be_is_refused():
    transitions, half = [np.eye(2)], np.full((1, 2, 2, 2), 0.5)
    with refused(ModelError):
        POMDP(transitions, half * 1.5, np.zeros((2, 1)), discount=0.9, event_observations=True)
    with refused(ModelError):
        POMDP(transitions, -half, np.zeros((2, 1)), discount=0.9, event_observations=True)
    with refused(ModelError):
        POMDP(transitions, half[..., :1], np.zeros((2, 1)), discount=0.9, event_observations=True)
    with pytest.warns(ModelWarning, match="as little as 0.5"):
        model = POMDP(transitions, half / 2, np.zeros((2, 1)), discount=0.9, event_observations=True)
    with refused(ModelError):
        model.observation_matrix(0)
    with refused(ModelError):
        model.observation(0, 0)


@pytest.mark.parametrize("key", ["episodes", "episodes_event_driven"])
def test_agrees_with_madp_on_events(key):
    model, compared = patrol(), 0
    for steps in figures.of("patrol")[key]:
        tracker = BeliefTracker(model)
        for step in steps:
            assert tracker.update(step["a"], step["o"]) == pytest.approx(step["eta"], abs=2e-6)
            if "b" in step:
                np.testing.assert_allclose(tracker.belief, figures.belief(step["b"], 126), atol=2e-6)
                compared += 1
    assert compared >= 20


def test_agrees_with_madp_s_truncated_series_of_false_negatives():
    """MADP adds up to 10 terms and stops, from the second on, at one below 0.01, though later ones may be large.

    So its probabilities are those of the truncated series; its beliefs are near the exact ones all the same.
    """
    model = patrol()
    tracker = BeliefTracker(model.with_false_negatives("False Negative"))
    for steps in figures.of("patrol")["episodes_false_negatives"]:
        before = model.initial_belief
        for step in steps:
            tracker.reset(before)
            missed, detected = (dense(model.joint_matrix(step["a"], o)) for o in (0, step["o"]))
            total = np.zeros(126)
            for count in range(10):
                term = before @ detected
                total, before = total + term, before @ missed
                if count and term.sum() < 0.01:
                    break
            theirs = figures.belief(step["b"], 126)
            assert total.sum() == pytest.approx(step["eta"], abs=2e-5)
            np.testing.assert_allclose(total / total.sum(), theirs, atol=2e-5)
            assert tracker.update(step["a"], step["o"]) >= step["eta"] - 2e-5
            np.testing.assert_allclose(tracker.belief, theirs, atol=0.02)
            before = theirs / theirs.sum()  # on from MADP's own belief, so that its truncation does not add up


def test_events_stay_with_their_transitions_where_rows_are_normalised(tmp_path):
    """T's rows are off by little, and have entries of 0: what is told of a transition must not move to another."""
    now, later, seen = Node("state", 0), Node("next_state", 0), Node("observation", 0)
    rows = np.array([[0.33333, 0.33333, 0.33333], [0.0, 0.5, 0.5], [0.25, 0.75, 0.0]])
    told = np.zeros((3, 3, 2))
    told[..., 0] = np.arange(9).reshape(3, 3) / 10
    told[..., 1] = 1 - told[..., 0]
    network = TwoSliceNetwork(
        Space.single("x", 3),
        Space.single("act", 1),
        Space.single("eye", 2),
        initial=[Table([now], [1.0, 0.0, 0.0])],
        transitions=[Table([now, later], rows)],
        observation=[Table([now, later, seen], told)],
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        for sparse in (False, True):
            model = FactoredPOMDP(network, discount=0.9, sparse=sparse).flatten()
            save_model(model, tmp_path / "m.npz")
            for each in (model, load_model(tmp_path / "m.npz")):
                transition = dense(each.transition_matrix(0))
                np.testing.assert_allclose(transition.sum(axis=1), 1, atol=1e-15)
                for o in range(2):
                    np.testing.assert_allclose(dense(each.joint_matrix(0, o)), transition * told[..., o], atol=1e-15)


@given(models())
def test_rests_are_what_events_leave(described):
    model, transitions, told = described
    for action, rest in enumerate(model.events.rests):
        expected = left_open(transitions[action], told[action])
        assert model.waits_in(action) == (rest is not None) == bool(expected.any())
        if rest is not None:
            np.testing.assert_allclose(dense(rest), expected, atol=1e-12)
    assert model.waits == any(rest is not None for rest in model.events.rests)


def test_what_rows_lack_by_rounding_alone_is_no_rest():
    """Files give six digits: such steps would cost each update something, and change nothing."""
    told = np.full((1, 3, 2, 2), 0.333333)
    for sparse in (False, True):
        model = POMDP(
            [np.full((2, 2), 0.5)], told, [[0.0], [0.0]], discount=0.9, event_observations=True, sparse=sparse
        )
        assert not model.waits
        with refused(ModelError):
            model.resolvent(0)


def simulated(model, transitions, told, actions, episodes, random):
    """Return the hidden states, and what was observed after each action, of many episodes; -1 where nothing ever is."""
    size, width = len(model.state_space), told.shape[1]
    states = random.choice(size, p=model.initial_belief, size=episodes)
    history = np.full((episodes, len(actions)), -1)
    for step, action in enumerate(actions):
        going = np.flatnonzero((history[:, :step] >= 0).all(axis=1))
        for _ in range(2000):
            if not len(going):
                break
            rows = transitions[action, states[going]].cumsum(axis=1)
            after = (random.random((len(going), 1)) > rows).sum(axis=1).clip(max=size - 1)
            chances = told[action][:, states[going], after].T.cumsum(axis=1)
            seen = (random.random((len(going), 1)) > chances).sum(axis=1)
            states[going] = after
            history[going[seen < width], step] = seen[seen < width]
            going = going[seen == width]
    return states, history


@pytest.mark.parametrize("folded", [4_000_000, 0])
@pytest.mark.parametrize("seed", range(8))
def test_beliefs_are_the_shares_of_hidden_states(seed, folded, monkeypatch):
    """Of all simulated episodes in which the same was observed; how many steps went unseen nobody knows."""
    monkeypatch.setattr("mdm.beliefs.choice.FOLDED", folded)
    random = np.random.default_rng(seed)
    size, count, width, episodes = 3, 2, 2, 100_000
    transitions = distributions(random, count, size, size)
    told = np.moveaxis(distributions(random, count, size, size, width), -1, 1)
    told *= random.uniform(0.1, 1, size=(count, 1, size, size))
    model = by_events(transitions, told, distributions(random, size), bool(seed % 2))
    actions = [0, 1, 1]
    states, history = simulated(model, transitions, told, actions, episodes, random)
    tracker, compared = BeliefTracker(model), 0
    for observations in np.ndindex(*[width] * len(actions)):
        which = (history == observations).all(axis=1)
        share, number = which.mean(), which.sum()
        tracker.reset()
        probability = tracker.update_all(zip(actions, observations, strict=True))
        assert abs(probability - share) < 5 * np.sqrt(max(share, 1e-4) / episodes)
        if number > 500:
            found = np.bincount(states[which], minlength=size) / number
            assert np.abs(tracker.belief - found).max() < 2.5 / np.sqrt(number)
            compared += 1
    assert compared >= 3


@pytest.mark.parametrize("sparse", [False, True])
def test_states_in_which_nothing_is_ever_observed(sparse):
    """The third state is never left and tells nothing: I - N would be singular, and it cannot be where one sees."""
    transitions = [[[0.5, 0.25, 0.25], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]]
    told = np.zeros((1, 1, 3, 3))
    told[0, 0, 0, 0], told[0, 0, 1, 1] = 0.5, 0.5
    model = by_events(transitions, told, [1, 0, 0], sparse)
    tracker = BeliefTracker(model)
    # N = [[1/4, 1/4, 1/4], [0, 1/2, 0], [0, 0, 1]]: 4/3 unseen visits of the first state, 2/3 of the second
    assert tracker.update(0, 0) == pytest.approx(2 / 3)
    np.testing.assert_allclose(tracker.belief, [1 / 2, 1 / 2, 0])
    tracker.reset([0, 0, 1])
    before = tracker.belief
    assert tracker.update(0, 0) == 0
    assert tracker.belief is before
    assert tracker.update(0, None) == 1
