"""False negatives as part of a model: resolvents and beliefs against power series, and what copies keep of them."""

from __future__ import annotations

import copy
import pickle
import warnings

import figures
import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from random_models import dense, distributions, factored_models, flat_models, without_detection
from sentences import refused

from mdm import ConfigError, Controller, Ensemble, ModelError
from mdm.beliefs import BeliefTracker
from mdm.errors import ModelWarning
from mdm.models import MDP, POMDP, Factor, MixedPOMDP, Space
from mdm.models.digest import digest
from mdm.models.events import Resolvent
from mdm.models.matrices import csr
from mdm.policies import AlphaVectors
from mdm.solvers import solve

SEEDS = st.integers(0, 2**32 - 1)


def series(steps, last):
    """Return the sum of the powers of a matrix, times another: twice as many terms at a time, until it stands still."""
    total, power = last, steps
    for _ in range(60):
        more = total + power @ total
        if np.abs(more - total).max(initial=0) < 1e-15:
            return more
        total, power = more, power @ power
    raise AssertionError("the series does not converge")


def tiger_like(seed=0, *, sparse=None, size=4, width=3):
    random = np.random.default_rng(seed)
    return POMDP(
        distributions(random, 2, size, size),
        distributions(random, 2, size, width),
        random.normal(size=(size, 2)),
        discount=0.9,
        initial_belief=distributions(random, size),
        observation_names=["nothing", *(f"o{o}" for o in range(1, width))],
        sparse=sparse,
    )


# -- The resolvent -------------------------------------------------------------------------------------------------


@given(SEEDS, st.integers(1, 6), st.integers(1, 4), st.booleans())
def test_a_resolvent_is_the_sum_of_all_powers(seed, size, count, compressed):
    random = np.random.default_rng(seed)
    steps = distributions(random, size, size) * random.uniform(0, 0.95, size=(size, 1))
    expected = series(steps, np.eye(size))
    resolvent = Resolvent(csr(steps) if compressed else steps)
    rows = random.random((count, size)) * (random.random((count, size)) < 0.5)
    for each in (resolvent, copy.deepcopy(resolvent), pickle.loads(pickle.dumps(resolvent))):
        np.testing.assert_allclose(each.weights(rows), rows @ expected, atol=1e-12)
        np.testing.assert_allclose(each.weights(rows[0]), rows[0] @ expected, atol=1e-12)
        np.testing.assert_allclose(dense(each.weights(csr(rows))), rows @ expected, atol=1e-12)
        np.testing.assert_allclose(each.values(rows.T), expected @ rows.T, atol=1e-12)
        np.testing.assert_allclose(each.values(rows[0]), expected @ rows[0], atol=1e-12)


@pytest.mark.parametrize("inverses", [4_000_000, 0])
@given(flat_models(kinds=("POMDP",), events=True, finer=False) | factored_models(events=True), st.data())
@settings(max_examples=30)
def test_a_model_s_resolvents_sum_its_false_negatives(inverses, model, data):
    assume(model.kind == "POMDP")
    count = len(model.observation_space)
    assume(count > 1)
    missed = data.draw(st.integers(0, count - 1))
    with warnings.catch_warnings(), pytest.MonkeyPatch.context() as patch:
        warnings.simplefilter("ignore", ModelWarning)
        patch.setattr("mdm.models.pomdp._INVERSES", inverses)
        missing = model.with_false_negatives(missed)
        assert not missing.step_by_step().waits
        assert not model.step_by_step().with_false_negatives(missed).waits
        for action in range(len(model.action_space)):
            steps = without_detection(model, action, missed)
            weights = missing.resolvent(action).weights(model.initial_belief)
            for o in range(count):
                if o != missed:
                    last = dense(model.joint_matrix(action, o))
                    expected = model.initial_belief @ series(steps, last)
                    np.testing.assert_allclose(weights @ last, expected, atol=1e-9)


def belief_by_series(model, belief, action, missed, seen, *, tells_all=False):
    last = dense(model.joint_matrix(action, seen))
    if seen == missed:
        return belief @ last
    return belief @ series(without_detection(model, action, missed, tells_all=tells_all), last)


def observed(model):
    """Return the model as its agent sees it, where there is such a thing."""
    return model if model.event_observations else model.revealed()


@given(flat_models(kinds=("POMDP",), events=True, finer=False) | factored_models(events=True), st.data())
@settings(max_examples=30)
def test_a_tracker_takes_what_it_needs_from_its_model(model, data):
    assume(model.kind == "POMDP")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        model = observed(model)
        count = len(model.observation_space)
        assume(count > 1)
        missed = data.draw(st.integers(0, count - 1))
        tells_all = data.draw(st.booleans())
        tracker = BeliefTracker((model.step_by_step() if tells_all else model).with_false_negatives(missed))
        belief = model.initial_belief
        for _ in range(data.draw(st.integers(1, 3))):
            action = data.draw(st.integers(0, len(model.action_space) - 1))
            seen = data.draw(st.integers(0, count - 1))
            expected = belief_by_series(model, belief, action, missed, seen, tells_all=tells_all)
            assert tracker.update(action, seen) == pytest.approx(expected.sum(), abs=1e-9)
            assume(expected.sum() > 1e-6)
            belief = expected / expected.sum()
            np.testing.assert_allclose(tracker.belief, belief, atol=1e-8)


def test_beliefs_of_a_real_model_are_those_of_the_series():
    """Along MADP's own episodes. MADP truncates the series, which `tests/models/test_events.py` accounts for."""
    model = figures.model("patrol")
    tracker, compared = BeliefTracker(model.with_false_negatives("False Negative")), 0
    for steps in figures.of("patrol")["episodes_false_negatives"][:2]:
        tracker.reset()
        belief = model.initial_belief
        for step in steps[:6]:
            expected = belief_by_series(model, belief, step["a"], 0, step["o"])
            assert tracker.update(step["a"], step["o"]) == pytest.approx(expected.sum(), rel=1e-9)
            belief = expected / expected.sum()
            np.testing.assert_allclose(tracker.belief, belief, atol=1e-12)
            compared += step["o"] != 0
    assert compared >= 4


# -- The model -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sparse", [False, True])
def test_it_is_the_same_model_by_name_or_index(sparse):
    model = tiger_like(sparse=sparse)
    for symbol in ("nothing", 0):
        missing = model.with_false_negatives(symbol)
        assert (model.false_negative, missing.false_negative) == (None, 0)
        assert missing.transition_matrix(1) is model.transition_matrix(1)
        assert missing.observation_matrix(1) is model.observation_matrix(1)
        assert missing.rewards is model.rewards
        assert repr(missing) == "<POMDP: 4 states, 2 actions, 3 observations, false negative 'nothing'>"
        assert missing.with_false_negatives(None).false_negative is None
    assert missing.with_false_negatives("o2").false_negative == 2


def test_resolvents_are_made_once_for_all_discounts():
    missing = tiger_like().with_false_negatives("nothing")
    slower = missing.with_discount(0.5)
    assert slower.false_negative == 0
    assert slower.resolvent(0) is missing.resolvent("0")
    assert missing.with_false_negatives("o1").resolvent(0) is not missing.resolvent(0)


def test_what_was_flattened_is_kept():
    model = MixedPOMDP(factored(observed=()), [0])
    flat = model.flatten()
    missing = model.with_false_negatives(1)
    assert missing.flatten().transition_matrix(0) is flat.transition_matrix(0)
    assert missing.flatten().false_negative == 1
    assert missing.flatten().resolvent(0) is missing.resolvent(0)
    assert missing.with_discount(0.3).flatten().resolvent(0) is missing.resolvent(0)
    assert missing.revealed() is missing


@pytest.mark.parametrize("sparse", [False, True])
def test_a_model_in_use_can_be_copied(sparse, monkeypatch):
    monkeypatch.setattr("mdm.models.pomdp._INVERSES", 0)
    missing = tiger_like(sparse=sparse).with_false_negatives(0)
    weights = missing.resolvent(1).weights(missing.initial_belief)
    again = pickle.loads(pickle.dumps(missing))
    assert again.false_negative == 0
    np.testing.assert_array_equal(again.resolvent(1).weights(again.initial_belief), weights)


def factored(observed=(0,)):
    from mdm.models import FactoredPOMDP
    from mdm.models.factored.factoring import as_network

    random = np.random.default_rng(3)
    flat = POMDP(
        distributions(random, 2, 6, 6),
        distributions(random, 2, 6, 3),
        random.normal(size=(6, 2)),
        discount=0.9,
        states=Space([Factor("door", 2), Factor("room", 3)]),
        observation_names=["nothing", "bell", "knock"],
    )
    network = as_network(flat)
    network.fully_observed = tuple(place in observed for place in range(2))
    return FactoredPOMDP(network, discount=0.9)


def test_what_is_seen_at_every_step_is_no_false_negative_alone():
    with refused(ModelError):
        factored().with_false_negatives("nothing").revealed()
    assert factored(observed=()).with_false_negatives("nothing").revealed().false_negative == 0
    seen = factored().revealed().with_false_negatives(0)
    assert seen.observation_space.unravel(seen.false_negative) == (0, 0)


def test_a_factor_is_dropped_under_false_negatives():
    """The belief over the other factors is the sum of that over all."""
    random = np.random.default_rng(8)
    moves = np.kron(distributions(random, 2, 3, 3), np.full((2, 2), 0.5))
    states = Space([Factor("room", 3), Factor("coin", 2)])
    told = distributions(random, 2, 6, 3)
    model = POMDP(moves, told, np.zeros((6, 2)), discount=0.9, states=states).with_false_negatives(1)
    small = model.marginalize("coin")
    assert small.false_negative == 1
    whole, part = BeliefTracker(model), BeliefTracker(small)
    for action, seen in ((0, 2), (1, 0), (1, 1), (0, 0)):
        assert part.update(action, seen) == pytest.approx(whole.update(action, seen), abs=1e-12)
        np.testing.assert_allclose(part.belief, whole.belief.reshape(3, 2).sum(axis=1), atol=1e-12)


def test_what_makes_no_sense_is_refused():
    model = tiger_like()
    with refused(ModelError):
        model.with_false_negatives("silence")
    with refused(ModelError):
        model.with_false_negatives(7)
    with refused(ModelError):
        tiger_like(width=1).with_false_negatives("nothing")
    with refused(ModelError):
        model.resolvent(0)
    chain = MDP(np.eye(2)[None], [[0.0], [1.0]], discount=0.5)
    assert chain.false_negative is None
    assert chain.with_false_negatives(None) is chain
    with refused(ModelError):
        chain.with_false_negatives(0)


@pytest.mark.parametrize("solver", ["qmdp", "fib", "jesp"])
def test_solvers_that_cannot_plan_for_them_refuse(solver):
    with refused(ModelError):
        solve(tiger_like().with_false_negatives(0), solver)


def test_the_default_solver_plans_for_them():
    model = tiger_like().with_false_negatives(0)
    assert solve(model, beliefs=10).solver == "perseus"
    assert solve(model, iterations=10).solver == "sarsop"


# -- The option of an ensemble ---------------------------------------------------------------------------------------


def test_an_ensemble_s_option_is_the_model_s():
    model = tiger_like()
    policy = AlphaVectors(np.zeros((1, 4)), [0], 2)
    ensemble = Ensemble("robot", policy=policy, model=model, actions={0: print, 1: print}, false_negative="nothing")
    assert ensemble.controller.model.false_negative == 0
    with refused(ConfigError):
        Ensemble("robot", policy=policy, model=model, actions={0: print, 1: print}, false_negative="silence")


# -- An agent that is told of each time step -------------------------------------------------------------------------


def seldom(*, sparse=None):
    """Return a model whose states are told apart by how seldom something is observed in them alone."""
    told = np.array([0.9, 0.3])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        return POMDP(
            [np.eye(2)],
            np.tile(told, (1, 1, 2, 1)),
            np.zeros((2, 1)),
            discount=0.9,
            observation_names=["something"],
            event_observations=True,
            sparse=sparse,
        )


@pytest.mark.parametrize("sparse", [False, True])
def test_a_model_step_by_step_counts_no_unseen_steps(sparse):
    model = seldom(sparse=sparse)
    each = model.step_by_step()
    assert (model.waits, each.waits, each.with_discount(0.5).waits) == (True, False, False)
    tracker = BeliefTracker(model)
    assert tracker.update(0, 0) == pytest.approx(1)  # at last, in either state
    np.testing.assert_allclose(tracker.belief, [0.5, 0.5])
    tracker = BeliefTracker(each)
    assert tracker.update(0, 0) == pytest.approx(0.6)
    np.testing.assert_allclose(tracker.belief, [0.75, 0.25])
    with refused(ModelError):
        each.resolvent(0)
    assert each.transition_matrix(0) is model.transition_matrix(0)


@given(factored_models(events=True))
def test_a_network_waits_where_its_matrices_do(model):
    assume(model.kind == "POMDP")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        flat = model.flatten()
    assert model.waits == flat.waits
    each = model.step_by_step()
    assert not each.waits
    assert not each.flatten().waits
    assert model.flatten().waits == flat.waits


@pytest.mark.parametrize(("options", "believed"), [({}, 0.5), ({"drive": 2.0}, 0.75)])
def test_an_ensemble_at_a_fixed_rate_is_told_of_each_step(options, believed):
    """It decides at ticks, with or without an observation: none of its steps goes unseen."""
    robot = Ensemble("robot", policy=AlphaVectors([[0.0, 0.0]], [0], 1), model=seldom(), actions={0: int}, **options)
    robot.controller.start()
    assert robot.controller.observe("something") is not None
    np.testing.assert_allclose(robot.controller.belief, [believed, 1 - believed])


def test_a_controller_step_by_step_begins_anew():
    controller = Controller(AlphaVectors([[0.0, 0.0]], [0], 1), seldom(), initial_belief=[0.2, 0.8])
    controller.start()
    controller.observe(0)
    np.testing.assert_allclose(controller.belief, [0.2, 0.8])
    controller.step_by_step()
    controller.start()
    np.testing.assert_allclose(controller.belief, [0.2, 0.8])
    controller.observe(0)
    np.testing.assert_allclose(controller.belief, [0.18 / 0.42, 0.24 / 0.42])
    assert not controller.model.waits


# -- Waits that are discounted -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("sparse", [False, True])
def test_waits_are_discounted_in_beliefs_where_that_is_wanted(sparse):
    model = seldom(sparse=sparse)
    for missing, waits in ((model, [0.1, 0.7]), (model.with_discount(0.5), [0.1, 0.7])):
        tracker = BeliefTracker(missing.with_discounted_waits())
        weights = (1 - np.array(waits)) / (1 - missing.discount * np.array(waits)) / 2
        assert tracker.update(0, 0) == pytest.approx(weights.sum())
        np.testing.assert_allclose(tracker.belief, weights / weights.sum())
        tracker = BeliefTracker(missing)
        assert tracker.update(0, 0) == pytest.approx(1)
        np.testing.assert_allclose(tracker.belief, [0.5, 0.5])


@given(flat_models(kinds=("POMDP",), events=True, finer=False) | factored_models(events=True), st.data())
@settings(max_examples=25)
def test_discounted_waits_are_part_of_the_model(model, data):
    assume(model.kind == "POMDP" and len(model.observation_space) > 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        missed = data.draw(st.none() | st.integers(0, len(model.observation_space) - 1))
        model = model.with_discount(0.7).with_false_negatives(missed)
        trackers = [BeliefTracker(each) for each in (model.with_discounted_waits(), model.flatten())]
        for action in range(len(model.action_space)):
            steps = without_detection(model, action, missed)
            for seen in range(len(model.observation_space)):
                for tracker, discount in zip(trackers, (0.7, 1.0), strict=True):
                    last = dense(model.joint_matrix(action, seen))
                    before = last if seen == missed else series(discount * steps, last)
                    tracker.reset()
                    expected = model.initial_belief @ before
                    assert tracker.update(action, seen) == pytest.approx(expected.sum(), abs=1e-9)
                    if expected.sum() > 1e-6:
                        np.testing.assert_allclose(tracker.belief, expected / expected.sum(), atol=1e-8)


def test_digests_tell_how_a_model_waits():
    model = seldom()
    kinds = [model, model.step_by_step(), model.with_discounted_waits(), model.step_by_step().with_discounted_waits()]
    assert len({digest(each) for each in kinds}) == 4
    assert digest(seldom()) == digest(model)


def test_a_dropped_factor_leaves_waits_as_they_are():
    states = Space([Factor("place", 2), Factor("mood", 2)])
    told = np.full((1, 1, 4, 4), 0.5)
    moves = np.kron(np.eye(2), np.full((2, 2), 0.5))[None]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        model = POMDP(moves, told, np.zeros((4, 1)), discount=0.9, states=states, event_observations=True)
        assert model.with_discounted_waits().marginalize("mood").waiting == ["discounted waits"]
        assert model.step_by_step().marginalize("mood").waiting == ["step by step"]
        assert model.marginalize("mood").waiting == []
