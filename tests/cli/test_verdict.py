"""What is found out about a policy: its exact value, its simulated one, and whether they contradict its claim."""

from __future__ import annotations

from argparse import Namespace

import numpy as np
import pytest

from mdm.cli.verdict import Verdict, judge
from mdm.models import MDP
from mdm.policies import QTable
from mdm.simulation import Evaluation

CHAIN = MDP(
    [[[0, 1, 0], [0, 0, 1], [0, 0, 1]]], [[0.0], [5], [1]], discount=0.5, initial_belief=[1, 0, 0], actions=["go"]
)
VALUES = [3.0, 6.0, 2.0]  # 1 / (1 - 0.5) at the end, and backwards


def arguments(**given):
    return Namespace(**{"steps": None, "episodes": None, "seed": 1, **given})


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
    assert lines["claims"] == f"{first:g} at the start"
    assert lines["is worth"] == "3 at the start, 2 to 6 over the states"
    assert ("contradiction" in lines) == (words != "not contradicted")


def test_another_end_or_episodes_are_heeded():
    verdict = judge(CHAIN, QTable([[99.0], [6], [2]]), arguments(steps=2, episodes=7))
    assert verdict.exact[0] == pytest.approx(0 + 0.5 * 5)
    assert (verdict.simulated.episodes, verdict.simulated.steps) == (7, 2)
    assert verdict.simulated.mean == pytest.approx(2.5)
    assert verdict.contradicts == 0  # the claim is about episodes without an end
    assert judge(CHAIN, QTable([[3.0], [6], [2]]), arguments(), simulated=True).simulated is not None
