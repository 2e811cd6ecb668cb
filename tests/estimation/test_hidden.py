"""Hidden states, against the sum over all paths of states."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest
from estimated import decision, heard
from hypothesis import given, strategies as st

from mdm import ModelError, ModelWarning, problems
from mdm.estimation import chains_of, evidence_of, fit
from mdm.estimation.hidden import Matrices, alike, expected, joint_odds, moves, passes
from mdm.models import POMDP, Factor, Space


def random_model(seed, *, events=False, factors=None):
    random = np.random.default_rng(seed)
    transitions = random.dirichlet(np.ones(3), (2, 3))
    told = random.dirichlet(np.ones(4), (2, 3, 3) if events else (2, 3))
    return POMDP(
        transitions,
        np.moveaxis(told, -1, 1) if events else told,
        np.zeros((3, 2)),
        discount=0.9,
        initial_belief=random.dirichlet(np.ones(3)),
        event_observations=events,
        observation_names=factors,
    )


def paths(model, actions, symbols):
    """Yield every path of states with its probability, together with the observations."""
    for path in product(range(3), repeat=len(symbols) + 1):
        chance = model.initial_belief[path[0]]
        for step, symbol in enumerate(symbols):
            action, before, after = actions[step], path[step], path[step + 1]
            chance *= model.transition(action, before, after)
            if symbol is not None:
                chance *= model.observation(action, after, symbol, state=before)
        yield path, chance


@given(st.integers(0, 10_000), st.booleans(), st.lists(st.sampled_from([0, 1, 2, 3, None]), min_size=1, max_size=5))
def test_counts_and_likelihoods_are_those_of_all_paths(seed, events, symbols):
    model = random_model(seed, events=events)
    actions = np.random.default_rng(seed).integers(0, 2, len(symbols) + 1).tolist()
    evidence = evidence_of(model, chains_of(heard(actions, symbols)).chains)
    counts, likelihood = expected(evidence, moves(Matrices.of(model), evidence.masks))
    total, wanted = 0.0, np.zeros((2, 3, 3))
    for path, chance in paths(model, actions, symbols):
        total += chance
        for step in range(len(symbols)):
            wanted[actions[step], path[step], path[step + 1]] += chance
    assert likelihood == pytest.approx(np.log(total))
    assert counts.sum(axis=1) == pytest.approx(wanted / total)


def test_several_chains_of_several_lengths_count_as_each_alone():
    model = random_model(3)
    told = [([0, 1, 0], [2, 1]), ([1, 1, 0, 0, 1], [0, 0, 3, None]), ([0], []), ([1, 0], [3])]
    alone = [evidence_of(model, chains_of(heard(*each)).chains) for each in told]
    together = evidence_of(model, chains_of([each for one in told for each in heard(*one)]).chains)
    assert (together.steps, np.diff(together.starts).tolist()) == (7, [3, 2, 1, 1])
    matrices = Matrices.of(model)
    results = [expected(each, moves(matrices, each.masks)) for each in alone if each.steps]
    counts, likelihood = expected(together, moves(matrices, together.masks))
    assert likelihood == pytest.approx(sum(each for _, each in results))
    assert counts.sum(axis=1) == pytest.approx(sum(each.sum(axis=1) for each, _ in results))


def test_a_missing_component_is_summed_over():
    space = Space([Factor("left", 2), Factor("right", 2)])
    model = random_model(4, factors=space)
    evidence = evidence_of(model, chains_of(heard([0, 1], [(1, None)])).chains)
    _, likelihood = passes(evidence, moves(Matrices.of(model), evidence.masks))
    chance = sum(chance for symbol in (2, 3) for _, chance in paths(model, [0, 1], [symbol]))
    assert likelihood == pytest.approx(np.log(chance))


@given(st.integers(0, 1000), st.booleans())
def test_no_round_makes_the_estimate_less_likely(seed, events):
    """Of the likelihood together with the old model's visit to each row."""
    model = random_model(seed, events=events)
    random = np.random.default_rng(seed)
    told = heard(random.integers(0, 2, 31).tolist(), random.integers(0, 4, 30).tolist())
    evidence = evidence_of(model, chains_of(told).chains)
    old, last = Matrices.of(model), -np.inf
    for rounds in range(5):
        found = fit(model, evidence, rounds=rounds)
        penalty = sum(
            float((before[before > 0] * np.log(after[before > 0])).sum())
            for before, after in zip(old, (found.transitions, found.observations), strict=True)
        )
        assert found.log_likelihood + penalty >= last - 1e-9
        last = found.log_likelihood + penalty
        assert found.transitions.sum(axis=-1) == pytest.approx(np.ones((2, 3)))
    if events:
        assert (found.observations == old.observations).all()


def test_a_round_is_the_expectation_over_all_paths():
    model = random_model(9)
    actions, symbols = [0, 1, 0, 0], [1, 3, 2]
    found = fit(model, evidence_of(model, chains_of(heard(actions, symbols)).chains), rounds=1)
    seen, total = np.zeros((2, 3, 4)), 0.0
    for path, chance in paths(model, actions, symbols):
        total += chance
        for step, symbol in enumerate(symbols):
            seen[actions[step], path[step + 1], symbol] += chance
    seen /= total
    old = np.array([model.observation_matrix(action) for action in (0, 1)])
    assert found.observations == pytest.approx((seen + old) / (seen.sum(axis=2, keepdims=True) + 1))


def test_what_is_possible_and_what_was_never_done_stays():
    tiger = problems.tiger()
    found = fit(tiger, evidence_of(tiger, chains_of(heard([0] * 6, [0, 0, 1, 0, 0])).chains))
    assert found.transitions[0].tolist() == np.eye(2).tolist()
    assert found.observations[1:].tolist() == [tiger.observation_matrix(action).tolist() for action in (1, 2)]


def test_an_impossible_observation_is_told_and_cuts_the_chain():
    model = POMDP(
        [np.eye(2)], [[[0.9, 0.1, 0.0], [0.1, 0.9, 0.0]]], np.zeros((2, 1)), discount=0.9, observation_names=3
    )
    told = heard([0] * 5, [0, 0, 2, 1])
    told[3] = decision(3, 3, "observation", None, 0, observation=2, belief=np.array([0.0, 1.0]))
    evidence = evidence_of(model, chains_of(told).chains)
    assert evidence.impossible == ((0, 2, 1),)
    assert (np.diff(evidence.starts).tolist(), evidence.first.tolist()) == ([2, 1], [[0.5, 0.5], [0.0, 1.0]])


def test_a_model_that_waits_is_refused_and_at_a_fixed_rate_is_not():
    waiting = problems.tiger().with_false_negatives(0)
    with pytest.raises(ModelError, match="steps without a detection are not in a record"):
        evidence_of(waiting, [])
    rest = np.full((1, 2, 2, 2), 0.3)
    with pytest.warns(ModelWarning, match="the rest counts as no observation"):
        model = POMDP([np.full((2, 2), 0.5)], rest, np.zeros((2, 1)), discount=0.9, event_observations=True)
    with pytest.raises(ModelError, match="steps without a detection"):
        evidence_of(model, [])
    assert evidence_of(model.step_by_step(), chains_of(heard([0, 0], [1])).chains).steps == 1


def test_a_model_that_is_too_large_is_refused():
    with pytest.raises(ModelError, match="is too large to estimate where states are hidden"):
        Matrices.of(problems.rock_sample())


def rooms(right, *, initial=(0.5, 0.5)):
    """A robot's door sensor, which is right with a probability, whatever it does."""
    moved, seen = np.eye(2) * 0.9 + 0.05, np.array([[right, 1 - right], [1 - right, right]])
    names = {"states": ["open", "shut"], "actions": ["look", "drive"], "observation_names": ["gap", "wall"]}
    return POMDP([moved] * 2, [seen] * 2, np.zeros((2, 2)), discount=0.9, initial_belief=initial, **names)


@pytest.mark.parametrize(("right", "tilted"), [(0.8, False), (0.5, True)])
def test_who_bets_against_a_model_that_is_right_wins_nothing(right, tilted):
    """The expectation of the odds is 1, over all that may be observed."""
    model, actions, total = rooms(right), [0, 1, 0, 0, 1, 0], 0.0
    for symbols in product((0, 1), repeat=5):
        chains = chains_of(heard(actions, symbols)).chains
        chance = sum(chance for _, chance in two_states(model, actions, symbols))
        total += chance * np.exp(joint_odds(model, chains, tilted=tilted))
    assert total == pytest.approx(1)


def two_states(model, actions, symbols):
    for path in product(range(2), repeat=len(symbols) + 1):
        chance = model.initial_belief[path[0]]
        for action, (before, after), symbol in zip(actions, pairwise(path), symbols, strict=False):
            chance *= model.transition(action, before, after) * model.observation(action, after, symbol)
        yield path, chance


@pytest.mark.parametrize(
    ("model", "groups"),
    [
        (rooms(0.85), ()),
        (rooms(0.505), ((0, 1),)),
        (rooms(0.5), ((0, 1),)),
        (rooms(0.5, initial=(1.0, 0.0)), ()),  # in the first steps it is known which it is
        (problems.tiger(), ()),
    ],
)
def test_states_that_nothing_tells_apart_are_named(model, groups):
    symbols = np.random.default_rng(1).integers(0, 2, 40).tolist()
    evidence = evidence_of(model, chains_of(heard([0, 0, 1, 0] * 10 + [0], symbols)).chains)
    assert alike(model, evidence) == groups
