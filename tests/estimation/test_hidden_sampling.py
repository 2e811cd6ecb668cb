"""Gibbs samples, against the posterior summed over all paths of states."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise, product

import numpy as np
import pytest
import scipy
from estimated import heard
from scipy.special import gammaln

from mdm import problems
from mdm.estimation import chains_of, evidence_of, fit, sample
from mdm.models import POMDP, Factor, Space


def rows(counts, size):
    """Return the logarithm of the probability of counts in rows of Dirichlet(1/2)."""
    by_row = {}
    for (row, symbol), count in counts.items():
        by_row.setdefault(row, np.zeros(size))[symbol] += count
    total = 0.0
    for each in by_row.values():
        total += gammaln(size / 2) - gammaln(size / 2 + each.sum()) + (gammaln(each + 0.5) - gammaln(0.5)).sum()
    return total


def posterior(model, symbols, masks):
    """Return the weight of each path and completion, with its counts of rows of T and O, as a mixture."""
    for path in product(range(2), repeat=len(symbols) + 1):
        for told in product(*(np.flatnonzero(masks[symbol]) for symbol in symbols)):
            moved = Counter(pairwise(path))
            seen = Counter(zip(path[1:], told, strict=True))
            chance = np.log(model.initial_belief[path[0]]) + rows(moved, 2) + rows(seen, model.num_seen)
            yield chance, moved, seen


@pytest.mark.parametrize("partly", [False, True])
def test_intervals_are_those_of_the_posterior_over_all_paths(partly):
    told = [[0.7, 0.1, 0.1, 0.1], [0.1, 0.2, 0.3, 0.4]]
    space = Space([Factor("left", 2), Factor("right", 2)])
    model = POMDP(
        [[[0.8, 0.2], [0.4, 0.6]]], [told], np.zeros((2, 1)), discount=0.9, observation_names=space,
        initial_belief=[0.9, 0.1],
    )  # fmt: skip
    model.num_seen = 4
    symbols = [(0, None), 0, 3, (1, None), 2] if partly else [0, 0, 3, 1, 2]
    masks = {symbol: [symbol == place for place in range(4)] for symbol in range(4)}
    masks |= {(0, None): [True, True, False, False], (1, None): [False, False, True, True]}
    evidence = evidence_of(model, chains_of(heard([0] * 6, symbols)).chains)
    found = sample(model, evidence, fit(model, evidence), seed=1, sweeps=600)
    parts = list(posterior(model, symbols, masks))
    weights = np.exp(np.array([each[0] for each in parts]) - max(each[0] for each in parts))
    weights /= weights.sum()
    for place, rest, counts, ends in (
        ((0, 1), (0, 0), 1, found.transitions[:, 0, 0, 1]),
        ((1, 1), (1, 0), 1, found.transitions[:, 0, 1, 1]),
        ((0, 0), None, 2, found.observations[:, 0, 0, 0]),
    ):
        shapes = []
        for part in parts:
            own = part[counts][place]
            others = sum(n for (row, _), n in part[counts].items() if row == place[0]) - own
            shapes.append((own + 0.5, others + (0.5 if rest is not None else 1.5)))
        shapes = np.array(shapes)
        for end, tail in zip(ends, (0.025, 0.975), strict=True):
            reached = float(weights @ scipy.stats.beta.cdf(end, *shapes.T))
            assert abs(reached - tail) < 0.012
        if rest is not None:  # of two entries, whose tails are the same
            below = float(weights @ scipy.stats.beta.cdf([0.2, 0.6][place[0]], *shapes.T))
            assert abs(found.p_values[0][0, place[0]] - 2 * min(below, 1 - below)) < 0.05


def test_beyond_all_draws_a_row_is_the_less_likely_the_farther_it_is():
    told = heard([0] * 41, [0] * 20 + [1] * 20)
    values = []
    for right in (0.55, 0.9, 0.99, 0.999):
        model = POMDP([np.eye(2)], [[[right, 1 - right], [0.5, 0.5]]], np.zeros((2, 1)), discount=0.9,
                      initial_belief=[1, 0])  # fmt: skip
        evidence = evidence_of(model, chains_of(told).chains)
        values.append(sample(model, evidence, fit(model, evidence), sweeps=20).p_values[1][0, 0])
    assert values[0] > 0.3
    assert 1e-3 > values[1] > values[2] > values[3] > 1e-200


def test_the_same_seed_gives_the_same_intervals_and_what_is_impossible_stays_so():
    tiger = problems.tiger()
    random = np.random.default_rng(0)
    actions = random.choice(3, 101, p=[0.9, 0.05, 0.05]).tolist()
    evidence = evidence_of(tiger, chains_of(heard(actions, random.integers(0, 2, 100).tolist())).chains)
    found = [sample(tiger, evidence, fit(tiger, evidence), seed=seed, sweeps=3) for seed in (5, 5, 6)]
    assert (found[0].observations == found[1].observations).all()
    assert (found[0].observations != found[2].observations).any()
    assert found[0].transitions[:, 0].tolist() == [np.eye(2).tolist()] * 2


def test_observations_of_events_stay():
    random = np.random.default_rng(1)
    told = random.dirichlet(np.ones(2), (1, 2, 2))
    model = POMDP(
        [[[0.8, 0.2], [0.4, 0.6]]], np.moveaxis(told, -1, 1), np.zeros((2, 1)), discount=0.9, event_observations=True
    )
    evidence = evidence_of(model, chains_of(heard([0] * 31, random.integers(0, 2, 30).tolist())).chains)
    found = sample(model, evidence, fit(model, evidence), sweeps=5)
    assert found.observations[0] == pytest.approx(found.observations[1])
    assert (found.transitions[0] < found.transitions[1]).all()
