"""Drift: bets whose expectation is 1 if the model is right."""

from __future__ import annotations

import math
from itertools import groupby, pairwise, product

import msgspec
import numpy as np
import pytest
from estimated import decision, heard, visits, wandering
from hypothesis import given, strategies as st

import mdm
from mdm import ModelError
from mdm.estimation import DriftTest, drift, statistics
from mdm.estimation.drift import Capital
from mdm.estimation.rows import log_odds
from mdm.models import MDP

P = [0.6, 0.3, 0.1]


def alarms(test, decisions):
    return [alarm for each in decisions if (alarm := test.take(each)) is not None]


@pytest.mark.parametrize("fixed", [True, False])
@pytest.mark.parametrize("fresh", [3, 200])
def test_who_bets_against_a_model_that_is_right_wins_nothing(monkeypatch, fixed, fresh):
    """The expectation of the capital is 1, over all that may follow, also when new bets begin."""
    monkeypatch.setattr(drift, "_FRESH", fresh)
    total = 0.0
    for sequence in product(range(3), repeat=7):
        capital = Capital(3, fixed=fixed)
        for place in sequence:
            value = capital.take(place, P)
        total += value * math.prod(P[place] for place in sequence)
    assert total == pytest.approx(1)


def test_bets_that_are_given_up_lose_their_share(monkeypatch):
    monkeypatch.setattr(drift, "_FRESH", 1)
    total = 0.0
    for sequence in product(range(2), repeat=8):
        capital = Capital(2)
        for place in sequence:
            value = capital.take(place, [0.7, 0.3])
        total += value * math.prod([0.7, 0.3][place] for place in sequence)
    assert 0.5 < total < 1


@given(st.lists(st.integers(0, 2), min_size=1, max_size=150))
def test_the_first_bet_is_the_bayes_factor_of_the_row(sequence):
    capital = Capital(3)
    for place in sequence:
        value = capital.take(place, P)
    counts = np.array([sequence.count(place) for place in range(3)], dtype=float)
    assert value == pytest.approx(0.5 + 0.5 * math.exp(log_odds(counts, np.array(P))))


def test_a_capital_too_large_for_a_number_is_infinite():
    capital = Capital(2)
    for _ in range(199):
        capital.take(0, [1e-9, 1 - 1e-9])
    assert capital.value == math.inf


T = np.array([[0.5, 0.4, 0.1], [0.0, 0.5, 0.5], [1.0, 0.0, 0.0]])


def test_a_wrong_row_is_told_once_with_the_symbol_that_differs_most():
    wrong = np.array([[0.2, 0.4, 0.4], [0.0, 0.5, 0.5], [1.0, 0.0, 0.0]])
    test = DriftTest(MDP([T], np.zeros((3, 1)), discount=0.9), kind="steps")
    (alarm,) = alarms(test, visits(wandering(wrong, 2_000)))
    assert (alarm.action, alarm.state, alarm.symbol) == (0, 0, 2)
    assert alarm.odds >= 2_000  # 1,000 for each of two uncertain rows
    assert alarm.share > 0.3
    assert alarm.model == pytest.approx(0.1)
    assert test.odds(0, 0) > 1e6
    assert test.odds(0, 1) < 10
    assert test.odds(0, 2) == 1
    test.reset()
    assert test.odds(0, 0) == 1


def test_a_row_that_drifts_late_is_told_soon():
    right, wrong = np.array([[0.9, 0.1], [0.9, 0.1]]), np.array([[0.6, 0.4], [0.6, 0.4]])
    test = DriftTest(MDP([right], np.zeros((2, 1)), discount=0.9), kind="steps")
    assert not alarms(test, visits(wandering(right, 8_000)))
    told = visits(wandering(wrong, 600, seed=1))
    assert alarms(test, told)


def test_something_impossible_is_told_at_once_and_once():
    test = DriftTest(MDP([T], np.zeros((3, 1)), discount=0.9))
    (alarm,) = alarms(test, visits([1, 0, 1, 0, 1]))
    assert (alarm.state, alarm.symbol, alarm.odds, alarm.model, alarm.visits) == (1, 0, math.inf, 0, 1)


def test_jumps_are_held_against_the_row_without_staying():
    """In a record of changes nothing follows itself: against the whole row each would drift."""
    model = MDP([[[0.8, 0.1, 0.1], [0.1, 0.8, 0.1], [0.1, 0.1, 0.8]]], np.zeros((3, 1)), discount=0.9)
    jumps = wandering(np.array([[0, 0.5, 0.5], [0.5, 0, 0.5], [0.5, 0.5, 0]]), 3_000)
    assert not alarms(DriftTest(model, odds=20), visits(jumps))
    assert len(alarms(DriftTest(model, kind="steps"), visits(jumps))) == 3


def test_nothing_is_counted_across_a_break():
    test = DriftTest(MDP([T], np.zeros((3, 1)), discount=0.9))
    told = [*visits([0, 1]), decision(2, 0, "reset", 0), decision(3, 5, "state", 1), decision(4, 6, "episode", 2)]
    assert not alarms(test, told)
    ticks = DriftTest(MDP([T], np.zeros((3, 1)), discount=0.9), period=1_000_000_000)
    assert not alarms(ticks, visits([1, 1, 0], times=[0, 1, 3], cause="tick", first="tick"))


def test_an_action_decided_again_counts_for_its_step():
    model = MDP([np.eye(2), [[0, 1], [1, 0]]], np.zeros((2, 2)), discount=0.9)
    told = [decision(0, 0, "start", 0, 0), decision(1, 1, "again", 0, 1), decision(2, 2, "state", 1, 0)]
    assert not alarms(DriftTest(model), told)


def tiger(count, right, seed):
    """Return what a robot hears that listens, and opens a door now and then; with its beliefs."""
    model, random = mdm.problems.tiger(), np.random.default_rng(seed)
    tracker, door = mdm.BeliefTracker(model), 0
    actions, symbols, beliefs = [0], [], [np.array(tracker.belief)]
    for step in range(count):
        if actions[-1]:
            door, chance = int(random.integers(2)), 0.5
        else:
            chance = right
        symbols.append(door if random.random() < chance else 1 - door)
        tracker.update(actions[-1], symbols[-1])
        beliefs.append(np.array(tracker.belief))
        actions.append(1 if step % 5 == 4 else 0)
    told = heard(actions, symbols)
    return [msgspec.structs.replace(each, belief=belief) for each, belief in zip(told, beliefs, strict=True)]


def test_observations_are_held_against_the_predictions_under_the_belief():
    """What is heard is even in any case: that it contradicts itself is known under the belief alone."""
    model = mdm.problems.tiger()
    assert not alarms(DriftTest(model, odds=20), tiger(1_500, 0.85, 1))
    biased = [
        msgspec.structs.replace(each, observation=0) if place % 3 == 0 and each.observation is not None else each
        for place, each in enumerate(tiger(1_500, 0.85, 2))
    ]
    found = alarms(DriftTest(model), biased)
    assert found
    assert found[0].state is None


@pytest.mark.parametrize("odds", [1, 0, -5, math.inf, math.nan, "high"])
def test_odds_are_more_than_even(odds):
    with pytest.raises(ModelError, match="the odds of an alarm are more than 1, as 1000, not"):
        DriftTest(mdm.problems.forest(), odds=odds)


def test_observations_need_a_model_that_has_them_and_tells_its_steps():
    told = tiger(3, 0.85, 1)
    with pytest.raises(ModelError, match="an MDP, which has none"):
        alarms(DriftTest(MDP([np.eye(2)] * 3, np.zeros((2, 3)), discount=0.9)), told)
    with pytest.raises(ModelError, match="steps without a detection are not known"):
        alarms(DriftTest(mdm.problems.tiger().with_false_negatives(0)), told)


RIGHT = np.array([[0.6, 0.3, 0.1], [0.1, 0.7, 0.2], [0.3, 0.3, 0.4]])


def of_states(seed):
    """Return a model estimated from 50 decisions, and what follows by the same truth."""
    used = MDP([np.full((3, 3), 1 / 3)], np.zeros((3, 1)), discount=0.9)
    told = visits(wandering(RIGHT, 51, seed=2 * seed))
    return statistics(told, used, kind="steps").model, visits(wandering(RIGHT, 400, seed=2 * seed + 1))


def of_jumps(seed):
    """The same of changes of the state alone, half of which do not stay."""
    used = MDP([np.full((3, 3), 1 / 3)], np.zeros((3, 1)), discount=0.9)
    told = visits([state for state, _ in groupby(wandering(RIGHT, 102, seed=2 * seed))])
    return statistics(told, used).model, visits(
        [state for state, _ in groupby(wandering(RIGHT, 800, seed=2 * seed + 1))]
    )


def of_observations(seed):
    model = statistics(tiger(50, 0.85, 2 * seed), mdm.problems.tiger()).model
    tracker, told = mdm.BeliefTracker(model), []
    for previous, each in pairwise([None, *tiger(400, 0.85, 2 * seed + 1)]):
        if previous is not None:
            tracker.update(previous.action, each.observation)
        told.append(msgspec.structs.replace(each, belief=np.array(tracker.belief)))
    return model, told


@pytest.mark.parametrize(
    ("made", "runs", "most"),
    [
        (of_jumps, 20, 5),
        (of_states, 20, 5),  # more in one of a thousand suites, by the binomial distribution, if one of 20 is told
        pytest.param(of_states, 1_000, 72, marks=pytest.mark.slow),
        pytest.param(of_jumps, 1_000, 72, marks=pytest.mark.slow),
        pytest.param(of_observations, 200, 20, marks=pytest.mark.slow),
        (of_observations, 4, 2),
    ],
)
def test_an_estimate_is_held_against_its_posterior(made, runs, most):
    """At odds of 20 at most one robot of 20 hears of drift; against its mean alone nearly each did."""
    kind = "steps" if made is of_states else None
    told = [bool(alarms(DriftTest(model, odds=20, kind=kind), after)) for model, after in map(made, range(runs))]
    assert sum(told) <= most


def test_an_estimate_from_many_decisions_is_still_told_to_be_wrong():
    model, _ = of_states(0)
    assert model.visits.sum() == 50
    model.visits = model.visits * 10
    test = DriftTest(model, odds=20, kind="steps")
    (alarm, *_) = alarms(test, visits(wandering(RIGHT[::-1], 2_000, seed=3)))
    assert alarm.odds >= 60
    unvisited = MDP([RIGHT], np.zeros((3, 1)), discount=0.9)
    unvisited.visits = np.zeros((3, 1))
    assert not alarms(DriftTest(unvisited, odds=20, kind="steps"), visits(wandering(RIGHT[::-1], 30, seed=3)))


@given(st.floats(1, 100), st.booleans())
def test_who_bets_against_a_posterior_wins_nothing_on_its_average(weight, fixed):
    """Of the predictions, one after another, whose product is the probability of all that follows."""
    total = 0.0
    for sequence in product(range(2), repeat=6):
        capital, chance = Capital(2, fixed=fixed, weight=weight), 1.0
        for place in sequence:
            chance *= capital._predicted(place, [0.7, 0.3])
            value = capital.take(place, [0.7, 0.3])
        total += value * chance
    assert total == pytest.approx(1)
