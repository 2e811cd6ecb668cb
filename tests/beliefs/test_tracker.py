from __future__ import annotations

import json
import warnings
from fractions import Fraction

import figures
import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from random_models import dense, flat_models, without_detection
from sentences import refused

from mdm import load_model
from mdm.beliefs import BeliefTracker, Support, dense as belief_dense, tracker as belief_tracker
from mdm.errors import ModelError, ModelWarning
from mdm.models import POMDP, Factor, Space
from mdm.problems import tiger

FILES = ("Access_Synch.pgmx", "DTPGMX.pgmx", "fireFighting_2_3_3.dpomdp.gz")


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


@pytest.mark.parametrize("problem", figures.COMPUTED)
@pytest.mark.parametrize("sparse", [False, True])
def test_agrees_with_madp(problem, sparse):
    """Belief sequences that MADP itself computed; for the patrol, with what is left to no event."""
    follow(
        as_matrices(figures.model(problem), sparse=sparse), figures.of(problem)["episodes"], figures.exactness(problem)
    )


@pytest.mark.parametrize("problem", ["fire_fighting_graph", "patrol"])
def test_agrees_with_madp_on_factored_models(problem):
    follow(figures.model(problem), figures.of(problem)["episodes"], figures.exactness(problem))


def follow(model, episodes, exactness):
    compared = 0
    for steps in episodes:
        tracker = BeliefTracker(model)
        for step in steps:
            probability = tracker.update(step["a"], step["o"])
            assert probability == pytest.approx(step["eta"], abs=exactness)
            if "b" in step and probability > 0:
                np.testing.assert_allclose(
                    tracker.belief, figures.belief(step["b"], len(tracker.belief)), atol=exactness
                )
                compared += 1
    assert compared >= 3


@pytest.mark.foreign("Access_Synch.pgmx, DTPGMX.pgmx and fireFighting_2_3_3.dpomdp of MADPToolbox/MADP")
def test_agrees_with_madp_on_files_of_other_problems(corpus):
    for file in FILES:
        oracle = json.loads((corpus / "oracles" / f"{file.removesuffix('.gz')}.json").read_text())
        tracker = BeliefTracker(load_model(corpus / "models" / "madp" / file))
        for sequence in oracle["belief_sequences_JointBelief"]:
            tracker.reset()
            for step in sequence["steps"]:
                assert tracker.update(step["a"], step["o"]) == pytest.approx(step["eta"], abs=1e-9), file
                np.testing.assert_allclose(tracker.belief, step["b"], atol=1e-9, err_msg=file)


def as_matrices(model, *, sparse):
    """Return a model as matrices of one kind."""
    flat = model.flatten()
    actions = range(len(flat.action_space))
    events = [
        [flat.event_matrix(action, seen) for seen in range(len(flat.observation_space))]
        for action in actions
        if flat.event_observations
    ]
    return POMDP(
        [flat.transition_matrix(action) for action in actions],
        events or [flat.observation_matrix(action) for action in actions],
        flat.rewards,
        discount=flat.discount,
        initial_belief=flat.initial_belief,
        event_observations=bool(events),
        sparse=sparse,
    )


def test_what_is_kept_of_missing_components_has_a_bound(monkeypatch):
    monkeypatch.setattr(belief_tracker, "_MOST_KEPT", 2)
    monkeypatch.setattr(belief_dense, "_KEPT", 8)
    random = np.random.default_rng(3)
    transitions, observations = random.dirichlet(np.ones(2), size=(2, 2)), random.dirichlet(np.ones(12), size=(2, 2))
    space = Space([Factor("left", 3), Factor("right", 4)])
    model = POMDP(transitions, observations, np.zeros((2, 2)), discount=0.9, observation_names=space)
    tracker, belief = BeliefTracker(model), list(model.initial_belief)
    for _ in range(2):
        for left, right in [(0, None), (None, 3), (2, None), (None, 0), (1, None)]:
            likely = [o for o in range(12) if left in (None, o // 4) and right in (None, o % 4)]
            total, belief = plain_update(model, belief, 1, likely)
            assert tracker.update(1, (left, right)) == pytest.approx(total)
            np.testing.assert_allclose(tracker.belief, belief)


def test_a_belief_that_was_handed_out_never_changes():
    tracker = BeliefTracker(tiger())
    tracker.update(0, 0)
    handed = tracker.belief
    copy = handed.copy()
    tracker.update(0, 1)
    np.testing.assert_array_equal(handed, copy)
    with refused(ValueError):
        handed[0] = 1


def test_the_support_says_what_the_belief_does():
    tracker = BeliefTracker(tiger())
    tracker.reset([0, 1])
    states, probabilities = tracker.support
    assert (states.tolist(), probabilities.tolist()) == ([1], [1.0])
    np.testing.assert_array_equal(tracker.support.dense(2), tracker.belief)
    with refused(ValueError):
        tracker.support.dense(2)[0] = 1
    assert not tracker.is_sparse


def test_begins_from_a_support():
    tracker = BeliefTracker(tiger())
    tracker.reset(Support(np.array([1, 0]), np.array([0.25, 0.75])))
    np.testing.assert_array_equal(tracker.belief, [0.75, 0.25])
    tracker.reset()
    np.testing.assert_array_equal(tracker.belief, [0.5, 0.5])


@pytest.mark.parametrize(
    ("states", "probabilities", "message"),
    [
        ([0, 2], [0.5, 0.5], "not among the 2 states"),
        ([-1], [1.0], "not among the 2 states"),
        ([], [], "not among the 2 states"),
        ([0.5], [1.0], "not among the 2 states"),
        ([False, True], [0.5, 0.5], "not among the 2 states"),
        ([1, 1], [0.5, 0.5], "a state twice"),
        ([0, 1], [0.5, 0.6], "sums to 1.1"),
        ([0, 1], [1.0], "needs 2 numbers"),
        ([0, 1], [np.nan, 1.0], "not a probability"),
    ],
)
def test_a_support_that_is_none_is_refused_and_changes_nothing(states, probabilities, message):
    tracker = BeliefTracker(tiger())
    tracker.update(0, 0)
    before = tracker.belief
    with pytest.raises(ModelError, match=message):
        tracker.reset(Support(np.array(states), np.array(probabilities)))
    assert tracker.belief is before


@pytest.mark.parametrize("step", [(0, 0.5), (0.5, 0), (0, "hear"), (None, None), (0, [0.5, 1])])
def test_what_is_no_symbol_is_taken_for_none(step):
    tracker = BeliefTracker(tiger())
    before = tracker.belief
    with refused(ModelError):
        tracker.update(*step)
    assert tracker.belief is before


@given(models(), st.data())
def test_several_steps_are_as_one_after_another(model, data):
    shape = model.observation_space.shape
    step = st.tuples(
        st.integers(0, len(model.action_space) - 1),
        st.none()
        | st.integers(0, len(model.observation_space) - 1)
        | st.tuples(*(st.none() | st.integers(0, size - 1) for size in shape)),
    )
    steps = data.draw(st.lists(step, max_size=5))
    tracker, other = BeliefTracker(model), BeliefTracker(model)
    probabilities = [other.update(*each) for each in steps]
    product = np.prod(probabilities)
    assert tracker.update_all(iter(steps)) == pytest.approx(product, abs=1e-15)
    if product > 0:
        np.testing.assert_allclose(tracker.belief, other.belief, atol=1e-15)
    else:
        np.testing.assert_array_equal(tracker.belief, model.initial_belief)


def test_several_steps_of_which_one_is_none_change_nothing():
    tracker = BeliefTracker(tiger())
    tracker.update(0, 0)
    before = tracker.belief
    with refused(ModelError):
        tracker.update_all([(0, 0), (0, 5)])
    assert tracker.belief is before
    assert tracker.update(0, 0) == pytest.approx(0.85**2 + 0.15**2)


def test_a_state_that_is_certain_goes_by_name_or_index():
    tracker = BeliefTracker(tiger())
    for state, belief in (("tiger-right", [0, 1]), (0, [1, 0])):
        tracker.reset(state)
        assert tracker.belief.tolist() == belief
    for wrong in ("tiger-lft", 2, True):
        with refused(ModelError):
            tracker.reset(wrong)
    assert tracker.belief.tolist() == [1, 0]


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
    with refused(ModelError):
        tracker.reset(belief)
    assert tracker.belief is before


@pytest.mark.parametrize(
    ("action", "observation", "message"),
    [(3, 0, "no action 3"), (-1, 0, "no action -1"), (0, 2, "no observation 2"), (0, -1, "no observation -1")]
    + [
        (0, (0, None), "1 components, not 2"),
        (0, (0, 1), "needs a component for each of agent"),
        (0, (5,), "no symbol 5"),
        (3, None, "no action 3"),
    ],
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


@pytest.mark.foreign("a collection of model files with one quirk each")
def test_agrees_with_the_traces_of_quirky_files(corpus):
    """P(o), and the belief by the sum of (i + 1) b[i], from the initial belief on."""
    compared = []
    for file, entry in json.loads((corpus / "edge" / "expected.json").read_text()).items():
        trace = entry.get("expect", {}).get("belief_trace")
        if not trace:
            continue
        for sparse in (False, True):
            tracker = BeliefTracker(load_quietly(corpus / "edge" / file, sparse=sparse))
            for step in trace:
                probability = tracker.update(step["a"], step["o"])
                assert probability == pytest.approx(step["p"], abs=1e-9), (file, step)
                checksum = tracker.belief @ np.arange(1, len(tracker.belief) + 1)
                assert checksum == pytest.approx(step["belief_checksum"], abs=1e-9), (file, step)
        compared.append(file.split("/")[0])
    assert {kind: compared.count(kind) for kind in set(compared)} == {"pomdp": 22, "dpomdp": 5, "pgmx": 2, "pomdpx": 3}


def load_quietly(path, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        return load_model(path, **options)


@pytest.mark.parametrize("folded", [4_000_000, 0])
@given(model=flat_models(kinds=("POMDP",), events=True), data=st.data())
def test_something_is_observed_unless_the_model_leaves_it_open(folded, model, data):
    """P(o) sums to 1 over o, or over all ways to fill what is missing; step by step to what events leave of it.

    Else it sums to 1 all the same: where something may be observed at each step, something is at last.
    """
    tells_all = data.draw(st.booleans())
    action = data.draw(st.integers(0, len(model.action_space) - 1))
    count, shape = len(model.observation_space), model.observation_space.shape
    size = len(model.state_space)
    expected = sum(
        model.initial_belief[s] * model.transition(action, s, t) * model.observation(action, t, state=s).sum()
        for s, t in np.ndindex(size, size)
        if model.transition(action, s, t) > 0
    )
    if tells_all:
        model = model.step_by_step()
    else:
        expected = 1
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mdm.beliefs.choice.FOLDED", folded)
        tracker = BeliefTracker(model)

    def probability(observation):
        tracker.reset()
        return tracker.update(action, observation)

    assert sum(map(probability, range(count))) == pytest.approx(expected, abs=1e-9)
    assert sum(probability((first, *[None] * (len(shape) - 1))) for first in range(shape[0])) == pytest.approx(expected)
    assert probability((None,) * len(shape)) == pytest.approx(expected)
    assert probability(None) == pytest.approx(1)


def solved(matrix, right):
    """Solve x (I - matrix) = right by elimination with fractions, exactly."""
    size = len(right)
    rows = [
        [Fraction(int(s == t)) - Fraction(matrix[t][s]) for t in range(size)] + [Fraction(right[s])]
        for s in range(size)
    ]
    for pivot in range(size):
        best = next(row for row in range(pivot, size) if rows[row][pivot] != 0)
        rows[pivot], rows[best] = rows[best], rows[pivot]
        rows[pivot] = [value / rows[pivot][pivot] for value in rows[pivot]]
        for row in range(size):
            if row != pivot:
                rows[row] = [a - rows[row][pivot] * b for a, b in zip(rows[row], rows[pivot], strict=True)]
    return [float(row[-1]) for row in rows]


@pytest.mark.parametrize("folded", [4_000_000, 0])
@given(model=flat_models(kinds=("POMDP",), events=True), data=st.data())
def test_steps_without_a_detection_are_what_the_equations_say(folded, model, data):
    """b (I - N)^-1 H_o, over states from which something may be detected; also where observations tell of states."""
    size, count = len(model.state_space), len(model.observation_space)
    assume(count > 1)
    action = data.draw(st.integers(0, len(model.action_space) - 1))
    missed = data.draw(st.integers(0, count - 1))
    tells_all = data.draw(st.booleans())
    joints = [dense(model.joint_matrix(action, o)) for o in range(count)]
    detected = [o for o in range(count) if o != missed]
    steps = without_detection(model, action, missed, tells_all=tells_all)
    # States from which something may be detected: found by walking back.
    leads = {s for s in range(size) if 1 - steps[s].sum() > 1e-9}
    while True:
        wider = leads | {s for s in range(size) if any(steps[s, t] > 0 for t in leads)}
        if wider == leads:
            break
        leads = wider
    inner = [[steps[s, t] if s in leads else 0.0 for t in range(size)] for s in range(size)]
    reached = np.array(solved(inner, model.initial_belief))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mdm.beliefs.choice.FOLDED", folded)
        missing = model.with_false_negatives(missed)
        tracker = BeliefTracker(missing.step_by_step() if tells_all else missing)
    total = 0.0
    for o in detected:
        tracker.reset()
        expected = reached @ joints[o]
        assert tracker.update(action, o) == pytest.approx(expected.sum(), abs=1e-9)
        if expected.sum() > 1e-9:
            np.testing.assert_allclose(tracker.belief, expected / expected.sum(), atol=1e-9)
        total += expected.sum()
    assert total <= 1 + 1e-9
    tracker.reset()
    assert tracker.update(action, missed) == pytest.approx((model.initial_belief @ joints[missed]).sum())
    # Which of the detected ones it was is not known: their sum, without the missed unless each step is told.
    total += (model.initial_belief @ joints[missed]).sum() if tells_all else 0.0
    tracker.reset()
    missing = (None,) * len(model.observation_space.factors)
    assert tracker.update(action, missing) == pytest.approx(total, abs=1e-9)


@pytest.mark.parametrize("sparse", [False, True])
def test_false_negatives_by_hand(sparse):
    """Each step one in four is detected, and the state moves on: P(detected in state s) is a geometric series."""
    moves = np.roll(np.eye(3), 1, axis=1)
    model = POMDP(
        [moves],
        [np.tile([0.75, 0.25], (3, 1))],
        np.zeros((3, 1)),
        discount=0.9,
        observation_names=["nothing", "something"],
        initial_belief=[1, 0, 0],
        sparse=sparse,
    )
    tracker = BeliefTracker(model.with_false_negatives("nothing"))
    assert tracker.update(0, 1) == pytest.approx(1)
    first = 0.25 / (1 - 0.75**3)
    np.testing.assert_allclose(tracker.belief, [first * 0.75**2, first, first * 0.75], atol=1e-12)
    assert tracker.update(0, 0) == pytest.approx(0.75)
    np.testing.assert_allclose(tracker.belief, [first * 0.75, first * 0.75**2, first], atol=1e-12)


def test_false_negatives_lead_nowhere_else_by_rounding():
    """A state that cannot be reached has no weight at all, and what cannot be detected probability 0."""
    size = 8
    for seed in range(60):
        random = np.random.default_rng(seed)

        def rows(count, share, random=random):
            array = np.where(random.random((1, size, count)) < share, random.random((1, size, count)), 0.0)
            array[..., 0] += array.sum(axis=-1) == 0
            return array / array.sum(axis=-1, keepdims=True)

        moves, told = rows(size, 0.3), rows(3, 0.5)
        model = POMDP(moves, told, np.zeros((size, 1)), discount=0.9)
        tracker = BeliefTracker(model.with_false_negatives(0))
        for start in np.eye(size):
            before, missed = start > 0, moves[0] * told[0, :, 0] > 0
            for _ in range(size):
                before = before | (before @ missed)
            for symbol in (1, 2):
                reached = before @ (moves[0] * told[0, :, symbol] > 0)
                tracker.reset(start)
                assert (tracker.update(0, symbol) > 0) == reached.any()
                assert (tracker.belief >= 0).all()
                assert not tracker.belief[~reached].any() or not reached.any()


@pytest.mark.parametrize("sparse", [False, True])
def test_what_is_detected_many_false_negatives_later_counts(sparse):
    """Five states in a row, of which only the step out of the last makes a sound; it leads back to the first."""
    told = np.zeros((1, 2, 5, 5))
    told[0, 0] = 1
    told[0, :, 4, 0] = [0, 1]
    model = POMDP(
        [np.roll(np.eye(5), 1, axis=1)],
        told,
        np.zeros((5, 1)),
        discount=0.9,
        event_observations=True,
        sparse=sparse,
    )
    tracker = BeliefTracker(model.with_false_negatives(0))
    assert tracker.update(0, 1) == pytest.approx(1)
    np.testing.assert_allclose(tracker.belief, [1, 0, 0, 0, 0], atol=1e-12)
