"""Every belief filter, with and without numba, against Bayes' rule written as sums over all states."""

from __future__ import annotations

import figures
import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from random_models import dense, flat_models

from mdm.beliefs import BeliefTracker, Support, choice as belief_choice
from mdm.beliefs.adaptive import AdaptiveFilter
from mdm.beliefs.choice import chosen_filter
from mdm.beliefs.compressed import CompressedFilter, GroupedFilter
from mdm.beliefs.dense import CompiledFoldedFilter, FoldedFilter, LikelyFilter
from mdm.beliefs.support import CompiledSupportFilter, SupportFilter
from mdm.models import POMDP
from mdm.models.compilation import can_compile
from mdm.models.dynamics import Dynamics

needs_numba = pytest.mark.skipif(not can_compile(), reason="numba is not there, or MDM_COMPILE is 0")

FILTERS = {
    "folded": FoldedFilter,
    "likely": lambda model: LikelyFilter(model, fast=False),
    "compressed": lambda model: CompressedFilter(Dynamics(model)),
    "support": lambda model: SupportFilter(Dynamics(model)),
    "adaptive": lambda model: AdaptiveFilter(SupportFilter(Dynamics(model)), CompressedFilter(Dynamics(model)), 2, 2),
}
COMPILED = {
    "compiled folded": CompiledFoldedFilter,
    "compiled likely": lambda model: LikelyFilter(model, fast=True),
    "grouped": lambda model: GroupedFilter(Dynamics(model)),
    "compiled support": lambda model: CompiledSupportFilter(Dynamics(model)),
    "compiled adaptive": lambda model: AdaptiveFilter(
        CompiledSupportFilter(Dynamics(model)), GroupedFilter(Dynamics(model)), 2, 2
    ),
}
MISSING = {"folded": FoldedFilter, "compressed": CompressedFilter}
MISSING_COMPILED = {"compiled folded": CompiledFoldedFilter, "grouped": GroupedFilter}


def params(*groups):
    plain, fast = groups
    return [*plain.items(), *(pytest.param(*each, marks=needs_numba, id=each[0]) for each in fast.items())]


def loaded(filter_, belief):
    belief = np.asarray(belief)
    (states,) = belief.nonzero()
    filter_.load(Support(states, belief[states]))
    return filter_


def joint_array(model):
    """Return P(s', o | s, a) as an A x O x S x S' array."""
    return np.array(
        [
            [dense(model.joint_matrix(a, o)) for o in range(len(model.observation_space))]
            for a in range(len(model.action_space))
        ]
    )


def assert_step(filter_, expected, probability):
    """Compare with the next belief, not normalised; return it normalised, or None where it is impossible."""
    total = expected.sum()
    assert probability == pytest.approx(total, abs=1e-12)
    if not total > 0:
        return None
    belief = expected / total
    np.testing.assert_allclose(filter_.dense(), belief, atol=1e-12)
    states, probabilities = filter_.support()
    again = np.zeros(len(belief))
    again[states] = probabilities
    np.testing.assert_allclose(again, belief, atol=1e-12)
    assert (probabilities > 0).all()
    assert len(np.unique(states)) == len(states)
    return belief


@pytest.mark.parametrize(("name", "make"), params(FILTERS, COMPILED))
@settings(max_examples=40)
@given(model=flat_models(kinds=("POMDP",), events=True, finer=False), data=st.data())
def test_agrees_with_sums_over_all_states(name, make, model, data):
    if "likely" in name and model.event_observations:
        return
    joint = joint_array(model)
    transitions = np.array([dense(model.transition_matrix(a)) for a in range(len(joint))])
    belief = model.initial_belief
    filter_ = loaded(make(model), belief)
    for _ in range(data.draw(st.integers(1, 6))):
        action = data.draw(st.integers(0, len(joint) - 1))
        observations = data.draw(st.sets(st.integers(0, joint.shape[1] - 1)))
        if not observations:
            expected, probability = np.einsum("s,st->t", belief, transitions[action]), filter_.predict(action)
        elif len(observations) == 1:
            (observation,) = observations
            expected = np.einsum("s,st->t", belief, joint[action, observation])
            probability = filter_.step(action, observation)
        else:
            expected = np.einsum("s,ost->t", belief, joint[action, sorted(observations)])
            probability = filter_.step_any(action, sorted(observations))
        found = assert_step(filter_, expected, probability)
        if found is None:
            np.testing.assert_allclose(filter_.dense(), belief, atol=1e-12)
        else:
            belief = found


@pytest.mark.parametrize(("name", "make"), params(MISSING, MISSING_COMPILED))
@settings(max_examples=30)
@given(model=flat_models(kinds=("POMDP",), events=True, finer=False), data=st.data())
def test_false_negatives_are_solved_for(name, make, model, data):
    joint = joint_array(model)
    size, count = joint.shape[-1], joint.shape[1]
    assume(count > 1)
    symbol = data.draw(st.integers(0, count - 1))
    missed = joint[:, symbol].copy()
    for rows in missed:  # states from which nothing else can follow add nothing: as if they ended all
        leads = rows.sum(axis=1) < 1 - 1e-9
        for _ in range(size):
            leads = leads | (rows @ leads > 0)
        rows[~leads] = 0
    model = model.with_false_negatives(symbol)
    filter_ = make(model if name.endswith("folded") else Dynamics(model))
    belief = model.initial_belief
    loaded(filter_, belief)
    for _ in range(data.draw(st.integers(1, 4))):
        action = data.draw(st.integers(0, len(joint) - 1))
        observation = data.draw(st.integers(0, count - 1))
        reached = belief
        if observation != symbol:
            reached = np.linalg.solve((np.eye(size) - missed[action]).T, belief)
        expected = reached @ joint[action, observation]
        probability = filter_.step(action, observation)
        total = expected.sum()
        assert probability == pytest.approx(total, abs=1e-9)
        if total > 1e-9:
            belief = expected / total
            np.testing.assert_allclose(filter_.dense(), belief, atol=1e-9)
            loaded(filter_, belief)  # on from one belief: what is not quite the same must not add up
        else:
            loaded(filter_, belief)


def corridor(size, observations=3):
    """A walk in a ring by 1, 2 or 3 places, whose last observation tells that the state is one of four."""
    random = np.random.default_rng(size)
    rows = np.repeat(np.arange(size), 3)
    columns = (rows + np.tile([1, 2, 3], size)) % size
    weights = random.random(3 * size) + 0.1
    transition = np.zeros((size, size))
    transition[rows, columns] = weights
    transition /= transition.sum(axis=1, keepdims=True)
    told = random.random((size, observations)) + 0.1
    told[:, -1] = 0
    told[:4, -1] = 5
    told /= told.sum(axis=1, keepdims=True)
    return POMDP([transition], [told], np.zeros((size, 1)), discount=0.9, initial_belief=np.eye(size)[0], sparse=True)


@pytest.mark.parametrize("fast", [False, pytest.param(True, marks=needs_numba)])
def test_the_support_grows_and_shrinks_and_grows_again(fast, monkeypatch):
    monkeypatch.setattr(belief_choice, "_GATHERED", (0, 8))
    size = 240
    model = corridor(size)
    filter_ = chosen_filter(model, fast=fast)
    transition, told = dense(model.transition_matrix(0)), dense(model.observation_matrix(0))
    belief = model.initial_belief
    loaded(filter_, belief)
    kinds = []
    for step in range(120):
        observation = 2 if step % 60 == 59 else step % 2
        if observation == 2:
            # a belief in which the four states have a part, whatever the walk
            belief = (belief + np.eye(size)[:8].sum(axis=0) / 8) / 2
            loaded(filter_, belief)
        belief = assert_step(filter_, belief @ transition * told[:, observation], filter_.step(0, observation))
        kinds.append(filter_.is_sparse)
        if kinds[-1]:
            assert np.count_nonzero(belief) <= size // 8
        else:
            assert np.count_nonzero(belief) >= size // 16
    assert kinds[0]
    assert not kinds[58]
    assert kinds[59]
    assert not kinds[-2]
    assert kinds[-1]


@pytest.mark.parametrize("fast", [False, pytest.param(True, marks=needs_numba)])
def test_a_belief_between_the_two_bounds_is_held_as_it_was(fast):
    told = np.zeros((64, 3))
    told[:3, 0] = told[3:9, 1] = told[9:, 2] = 1
    dynamics = Dynamics(POMDP([np.eye(64)], [told], np.zeros((64, 1)), discount=0.9, sparse=True))
    narrow, wide = (CompiledSupportFilter, GroupedFilter) if fast else (SupportFilter, CompressedFilter)
    filter_ = AdaptiveFilter(narrow(dynamics), wide(dynamics), 8, 4)
    for states, observation, sparse_before, sparse in (
        (8, 1, True, True),  # 5 states are left
        (9, 1, False, False),  # 6 states are left
        (9, 0, False, True),  # 3 states are left
    ):
        filter_.load(Support(np.arange(states), np.full(states, 1 / states)))
        assert filter_.is_sparse == sparse_before
        filter_.step(0, observation)
        assert filter_.is_sparse == sparse


@pytest.mark.parametrize(("name", "make"), params(FILTERS, COMPILED))
def test_stays_normalised_and_finite(name, make):
    """Observations that are seldom what the belief expects: the product of their probabilities is as good as 0."""
    random = np.random.default_rng(1)
    size = 6
    transition = random.dirichlet(np.full(size, 0.2), size=(2, size))
    told = random.dirichlet(np.full(3, 0.05), size=(2, size)) + 1e-9
    model = POMDP(
        transition / transition.sum(axis=2, keepdims=True),
        told / told.sum(axis=2, keepdims=True),
        np.zeros((size, 2)),
        discount=0.9,
    )
    filter_ = loaded(make(model), model.initial_belief)
    steps = 1_000_000 if name.startswith("compiled f") else 3_000
    step = filter_.step
    pattern = list(zip(random.integers(2, size=997).tolist(), random.integers(3, size=997).tolist(), strict=True))
    for index in range(steps):
        action, observation = pattern[index % 997]
        assert step(action, observation) > 0
    belief = filter_.dense()
    assert np.isfinite(belief).all()
    assert belief.sum() == pytest.approx(1, abs=1e-12)
    # Another 50 steps from here agree with a plain computation: nothing was lost on the way.
    joint = joint_array(model)
    for action, observation in pattern[:50]:
        belief = belief @ joint[action, observation]
        belief /= belief.sum()
        filter_.step(action, observation)
    np.testing.assert_allclose(filter_.dense(), belief, atol=1e-12)


@pytest.mark.parametrize(("name", "make"), params(FILTERS, COMPILED))
def test_an_observation_as_good_as_impossible_leaves_no_garbage(name, make):
    model = POMDP(
        [np.eye(3)],
        [[[1e-200, 1.0], [3e-200, 1.0], [0.0, 1.0]]],
        np.zeros((3, 1)),
        discount=0.9,
    )
    filter_ = loaded(make(model), [0.5, 0.25, 0.25])
    assert filter_.step(0, 0) == pytest.approx(1.25e-200)
    np.testing.assert_allclose(filter_.dense(), [0.4, 0.6, 0], atol=1e-12)
    assert filter_.step(0, 0) == pytest.approx(2.2e-200)
    np.testing.assert_allclose(filter_.dense(), [0.4 / 2.2, 1.8 / 2.2, 0], atol=1e-12)


@pytest.mark.parametrize(("name", "make"), params(FILTERS, COMPILED))
def test_what_was_handed_out_never_changes(name, make):
    model = corridor(40)
    filter_ = loaded(make(model), model.initial_belief)
    filter_.step(0, 0)
    belief, (states, probabilities) = filter_.dense(), filter_.support()
    copies = belief.copy(), states.copy(), probabilities.copy()
    for step in range(6):
        filter_.step(0, step % 2)
        filter_.predict(0)
        filter_.step_any(0, [0, 1])
    for handed, copy in zip((belief, states, probabilities), copies, strict=True):
        np.testing.assert_array_equal(handed, copy)


@pytest.mark.parametrize("folded", [4_000_000, 0])
@pytest.mark.parametrize("fast", [False, pytest.param(True, marks=needs_numba)])
def test_agrees_with_every_sequence_of_madp(fast, folded, monkeypatch):
    monkeypatch.setattr(belief_choice, "_FOLDED", folded)
    compared = 0
    for problem in figures.COMPUTED:
        found = figures.model(problem)
        filter_ = chosen_filter(found, fast=fast)
        for steps in figures.of(problem)["episodes"]:
            loaded(filter_, found.initial_belief)
            for step in steps:
                assert filter_.step(step["a"], step["o"]) == pytest.approx(step["eta"], abs=figures.exactness(problem))
                if "b" in step:
                    theirs = figures.belief(step["b"], len(found.state_space))
                    np.testing.assert_allclose(filter_.dense(), theirs, atol=figures.exactness(problem))
            compared += 1
    assert compared >= 20


@pytest.mark.parametrize("folded", [4_000_000, 0])
@pytest.mark.parametrize("fast", [False, pytest.param(True, marks=needs_numba)])
def test_false_negatives_of_a_real_model_are_solved_for(fast, folded, monkeypatch):
    """Along MADP's own episodes, against numpy's solver; MADP itself truncates the series."""
    monkeypatch.setattr(belief_choice, "_FOLDED", folded)
    found = figures.model("patrol").with_false_negatives(0)
    joint = joint_array(found)
    filter_ = chosen_filter(found, fast=fast)
    identity = np.eye(len(found.state_space))
    compared = 0
    for steps in figures.of("patrol")["episodes_false_negatives"]:
        before = found.initial_belief
        loaded(filter_, before)
        for step in steps:
            action, observation = step["a"], step["o"]
            reached = before if observation == 0 else np.linalg.solve((identity - joint[action, 0]).T, before)
            expected = reached @ joint[action, observation]
            assert filter_.step(action, observation) == pytest.approx(expected.sum(), rel=1e-9)
            before = expected / expected.sum()
            np.testing.assert_allclose(filter_.dense(), before, atol=1e-9)
            compared += observation != 0
    assert compared >= 20


def dense_model(size, filled):
    random = np.random.default_rng(0)
    transition = random.random((1, size, size)) * (random.random((1, size, size)) < filled)
    transition[:, :, 0] += 0.01
    told = random.random((1, size, 2)) + 0.1
    return POMDP(
        transition / transition.sum(axis=2, keepdims=True),
        told / told.sum(axis=2, keepdims=True),
        np.zeros((size, 1)),
        discount=0.9,
    )


@pytest.mark.parametrize(
    ("size", "filled", "folded", "plain", "compiled"),
    [
        (20, 0.1, 4_000_000, FoldedFilter, CompiledFoldedFilter),
        (150, 0.5, 4_000_000, FoldedFilter, CompiledFoldedFilter),
        (150, 0.5, 0, LikelyFilter, LikelyFilter),
        (150, 0.01, 4_000_000, CompressedFilter, AdaptiveFilter),
    ],
)
def test_the_filter_suits_the_model(size, filled, folded, plain, compiled, monkeypatch):
    monkeypatch.setattr(belief_choice, "_FOLDED", folded)
    model = dense_model(size, filled)
    assert type(chosen_filter(model, fast=False)) is plain
    if can_compile():
        assert type(chosen_filter(model, fast=True)) is compiled


def test_a_million_states_are_tracked_by_their_support():
    """Memory is that of the model and little more, and an update touches what the belief does."""
    from scipy.sparse import csr_array

    size = 1_000_000
    states = np.arange(size)
    rows, columns = np.repeat(states, 2), np.stack([states, (states + 1) % size], axis=1).ravel()
    moves = csr_array((np.tile([0.25, 0.75], size), (rows, columns)), shape=(size, size))
    told = csr_array((np.ones(size), (states, states % 7)), shape=(size, 7))
    start = np.zeros(size)
    start[5] = 1
    tracker = BeliefTracker(
        POMDP([moves], [told], np.zeros((size, 1)), discount=0.9, initial_belief=start, sparse=True)
    )
    assert tracker.is_sparse
    assert tracker.update(0, 6) == pytest.approx(0.75)
    assert tracker.update(0, None) == pytest.approx(1)
    found = dict(zip(*(part.tolist() for part in tracker.support), strict=True))
    assert found == pytest.approx({6: 0.25, 7: 0.75})
    assert tracker.belief[6:8].tolist() == pytest.approx([0.25, 0.75])
    assert tracker.is_sparse
