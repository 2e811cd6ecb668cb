"""The value of a policy: claimed, exact and simulated, and contradictions between them."""

from __future__ import annotations

from argparse import Namespace

import numpy as np
import pytest

from mdm.cli.interruption import Interruption
from mdm.cli.policies.evaluate import Verdict, claimed_value, judge
from mdm.loading import revealed
from mdm.models import MDP, MixedPOMDP
from mdm.policies import (
    AlphaVectors,
    DeterministicPolicy,
    FiniteStateController,
    MixedAlphaVectors,
    QTable,
    StagedPolicy,
    StochasticPolicy,
)
from mdm.problems import rock_sample
from mdm.simulation import Evaluation

CHAIN = MDP(
    [[[0, 1, 0], [0, 0, 1], [0, 0, 1]]], [[0.0], [5], [1]], discount=0.5, initial_belief=[1, 0, 0], actions=["go"]
)
HALVES = MDP([np.eye(2)], np.zeros((2, 1)), discount=0.9, initial_belief=[0.25, 0.75])
VALUES = [3.0, 6.0, 2.0]  # 1 / (1 - 0.5) at the end, and backwards


def arguments(**given):
    return Namespace(**{"steps": None, "episodes": None, "seed": 1, "interruption": Interruption(), **given})


def simulated(mean, error):
    return Evaluation(mean, error, returns=np.array([mean, mean]), steps=10, seed=1, moves=20, seconds=1.0)


@pytest.mark.parametrize(
    ("claimed", "exact", "contradicts"),
    [
        (3.0, 3.0, 0),
        (3.0 + 1e-9, 3.0, 0),
        (3.1, 3.0, 1),
        (2.9, 3.0, -1),
        (3e9 + 1, 3e9, 0),
        (None, 3.0, 0),
    ],
)
def test_an_exact_value_contradicts_what_differs_by_more_than_rounding(claimed, exact, contradicts):
    assert Verdict("q", "", claimed, (exact, exact, exact), None, comparable=True).contradicts == contradicts
    assert Verdict("q", "", claimed, (exact, exact, exact), None, comparable=False).contradicts == 0


@pytest.mark.parametrize(("claimed", "contradicts"), [(3.0, 0), (4.9, 0), (1.1, 0), (5.1, 1), (0.9, -1)])
def test_a_simulation_contradicts_what_lies_outside_its_interval(claimed, contradicts):
    verdict = Verdict("alpha vectors", "", claimed, None, simulated(3.0, 1.0), comparable=True)
    assert verdict.contradicts == contradicts


def test_the_exact_value_and_its_extremes_are_those_of_the_model():
    verdict = judge(CHAIN, QTable([[3.0], [6], [2]]), arguments())
    assert verdict.exact == pytest.approx((3, 2, 6))
    assert (verdict.claimed, verdict.simulated, verdict.size, verdict.contradicts) == (3, None, "3 states", 0)
    facts = verdict.facts()
    assert (facts["exact"], facts["mean"], facts["claim_is"]) == (pytest.approx(3), None, "not contradicted")


@pytest.mark.parametrize(("first", "words"), [(4.0, "too high"), (2.0, "too low"), (3.0, "not contradicted")])
def test_a_claim_is_judged_and_told(first, words):
    verdict = judge(CHAIN, QTable([[first], [6], [2]]), arguments())
    assert verdict.facts()["claim_is"] == words
    lines = dict(verdict.lines())
    assert lines["claimed value"] == f"{first:g} at the start"
    assert lines["exact value"] == "3 at the start, 2 to 6 over the states"
    assert ("contradiction" in lines) == (words != "not contradicted")


def test_another_end_or_episodes_are_heeded():
    verdict = judge(CHAIN, QTable([[99.0], [6], [2]]), arguments(steps=2, episodes=7))
    assert verdict.exact[0] == pytest.approx(0 + 0.5 * 5)
    assert (verdict.simulated.episodes, verdict.simulated.steps) == (7, 2)
    assert verdict.simulated.mean == pytest.approx(2.5)
    assert verdict.contradicts == 0  # the claim is about episodes without an end
    assert judge(CHAIN, QTable([[3.0], [6], [2]]), arguments(), simulated=True).simulated is not None


@pytest.mark.parametrize(
    ("policy", "value"),
    [
        (DeterministicPolicy([0, 0]), None),
        (StochasticPolicy([[1.0, 1.0]]), None),
        (QTable([[4.0, 0], [8, 12]]), 0.25 * 4 + 0.75 * 12),
        (StagedPolicy([[[4.0, 0], [8, 12]], [[100, 100]] * 2]), 0.25 * 4 + 0.75 * 12),
        (AlphaVectors([[4, 0], [0, 8]], [0, 0]), 6),
        (FiniteStateController([0], [[0]]), None),
        (FiniteStateController([0, 0], [[0], [1]], values=[[4, 0], [0, 8]]), 6),
    ],
)
def test_a_claim_is_the_value_of_the_initial_belief(policy, value):
    assert claimed_value(HALVES, policy) == value


def test_where_some_of_the_state_is_seen_the_claim_is_an_average_over_what_is_seen_first():
    model = revealed(rock_sample(2, 1))
    assert isinstance(model, MixedPOMDP)
    seen = int(model.seen_in[model.initial_belief.argmax()])
    vectors = MixedAlphaVectors([[1.0, 3.0]], [0], [seen], len(model.action_space), states=model.layout)
    assert claimed_value(model, vectors) == pytest.approx(2.0)  # the only rock is good or bad, by half
