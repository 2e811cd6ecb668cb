"""Frequencies of observations, against a belief tracker's predictions."""

from __future__ import annotations

import numpy as np
import pytest
from estimated import heard

import mdm
from mdm.estimation import chains_of, evidence_of, frequencies
from mdm.models import POMDP, Factor, Space


def test_expected_frequencies_are_the_predictions_of_a_belief_tracker():
    tiger = mdm.problems.tiger()
    random = np.random.default_rng(2)
    actions = random.choice(3, 41, p=[0.8, 0.1, 0.1]).tolist()
    symbols = random.integers(0, 2, 40).tolist()
    evidence = evidence_of(tiger, chains_of(heard(actions, symbols)).chains)
    found = {each.action: each for each in frequencies(tiger, evidence)}
    tracker, counts, wanted = mdm.BeliefTracker(tiger), np.zeros((3, 2)), np.zeros((3, 2))
    for action, symbol in zip(actions, symbols, strict=False):
        counts[action, symbol] += 1
        for other in (0, 1):
            before = np.array(tracker.belief)
            wanted[action, other] += tracker.update(action, other)
            tracker.reset(before)
        tracker.update(action, symbol)
    for action, each in found.items():
        assert each.counts.tolist() == counts[action].tolist()
        assert each.expected == pytest.approx(wanted[action])
        assert each.missing == 0


def test_what_is_missing_is_counted_apart():
    space = Space([Factor("left", 2), Factor("right", 2)])
    model = POMDP([np.eye(2)], [np.full((2, 4), 0.25)], np.zeros((2, 1)), discount=0.9, observation_names=space)
    (found,) = frequencies(model, evidence_of(model, chains_of(heard([0] * 5, [1, None, (0, None), 3])).chains))
    assert (found.counts.tolist(), found.missing) == ([0, 1, 0, 1], 2)
    assert found.expected == pytest.approx([0.5] * 4)
