"""Every belief filter, with and without numba, against Bayes' rule written as sums over all states."""

from __future__ import annotations

from unittest.mock import patch

import figures
import numpy as np
import pytest
from belief_steps import assert_step, corridor, loaded, needs_numba
from hypothesis import given, settings, strategies as st
from random_models import dense, flat_models, leading_to_detection, without_detection

from mdm.beliefs import choice as belief_choice, dense as compact
from mdm.beliefs.choice import AdaptiveFilter, chosen_filter
from mdm.beliefs.compressed import CompressedFilter, GroupedFilter
from mdm.beliefs.dense import CompactFilter, FoldedFilter, LikelyFilter
from mdm.beliefs.support import CompiledSupportFilter, SupportFilter
from mdm.models import POMDP
from mdm.models.dynamics import Dynamics


def sparse(model):
    """Return a compact filter that leaves out all zeros."""
    with patch.object(compact, "_SPARSE", 2):
        return CompactFilter(model)


FILTERS = {
    "folded": FoldedFilter,
    "likely": lambda model: LikelyFilter(model, fast=False),
    "compressed": lambda model: CompressedFilter(Dynamics(model)),
    "support": lambda model: SupportFilter(Dynamics(model)),
    "adaptive": lambda model: AdaptiveFilter(SupportFilter(Dynamics(model)), CompressedFilter(Dynamics(model)), 2, 2),
}
COMPILED = {
    "compact": CompactFilter,
    "sparse compact": sparse,
    "compiled likely": lambda model: LikelyFilter(model, fast=True),
    "grouped": lambda model: GroupedFilter(Dynamics(model)),
    "compiled support": lambda model: CompiledSupportFilter(Dynamics(model)),
    "compiled adaptive": lambda model: AdaptiveFilter(
        CompiledSupportFilter(Dynamics(model)), GroupedFilter(Dynamics(model)), 2, 2
    ),
}
MISSING = {"folded": FoldedFilter, "compressed": CompressedFilter}
MISSING_COMPILED = {"compact": CompactFilter, "sparse compact": sparse, "grouped": GroupedFilter}


def params(*groups):
    plain, fast = groups
    return [*plain.items(), *(pytest.param(*each, marks=needs_numba, id=each[0]) for each in fast.items())]


def joint_array(model):
    """Return P(s', o | s, a) as an A x O x S x S' array."""
    return np.array(
        [
            [dense(model.joint_matrix(a, o)) for o in range(len(model.observation_space))]
            for a in range(len(model.action_space))
        ]
    )


@pytest.mark.parametrize(("name", "make"), params(FILTERS, COMPILED))
@settings(max_examples=40)
@given(model=flat_models(kinds=("POMDP",), events=True, finer=False), data=st.data())
def test_agrees_with_sums_over_all_states(name, make, model, data):
    if "likely" in name and model.event_observations:
        return
    model = model.step_by_step()
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
def test_steps_without_a_detection_are_solved_for(name, make, model, data):
    joint = joint_array(model)
    size, count = joint.shape[-1], joint.shape[1]
    symbol = data.draw(st.none() | st.integers(0, count - 1)) if count > 1 else None
    tells_all = data.draw(st.booleans())
    # States from which nothing else can follow add nothing: as if they ended all.
    missed = [
        leading_to_detection(without_detection(model, action, symbol, tells_all=tells_all))
        for action in range(len(joint))
    ]
    model = (model.step_by_step() if tells_all else model).with_false_negatives(symbol)
    filter_ = make(model if name.endswith(("folded", "compact")) else Dynamics(model))
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
    steps = 1_000_000 if name == "compact" else 3_000
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
    monkeypatch.setattr(belief_choice, "FOLDED", folded)
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
    monkeypatch.setattr(belief_choice, "FOLDED", folded)
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
