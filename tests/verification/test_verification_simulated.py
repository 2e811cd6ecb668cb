import math

import numpy as np
import pytest
from random_processes import model_of_rows, random_rows

from mdm import evaluate, problems
from mdm.errors import ConfigError, FormatError, ModelError
from mdm.models import POMDP
from mdm.policies import BeliefPolicy, FiniteStateController
from mdm.simulation.batch import ReachingEvaluation
from mdm.verification import verify

WALK = POMDP(
    [[[0.5, 0.3, 0.2], [0, 1, 0], [0, 0, 1]], np.eye(3)],
    np.ones((2, 3, 1)),
    np.zeros((3, 2)),
    discount=0.9,
    states=["hall", "stairs", "dock"],
    actions=["Go", "Wait"],
    initial_belief=[1, 0, 0],
)


class Always(BeliefPolicy):
    """Takes one action, whatever it believes; one episode at a time, or many."""

    num_states, num_actions = 3, 2

    def __init__(self, action, *, together):
        self.its = action
        if together:
            from mdm.policies.batch import BeliefBatch

            self.batch = lambda model: BeliefBatch(self, model)

    def action(self, belief):
        return self.its


@pytest.mark.parametrize("together", [True, False])
def test_an_interval_holds_the_probability(together):
    answer = verify(WALK, "P(reach stairs)", Always(0, together=together), seed=1, episodes=500)
    assert answer.result.lower < 0.6 < answer.result.upper
    assert answer.result.upper - answer.result.lower < 0.1
    assert (answer.result.episodes, answer.result.undecided, answer.result.seed) == (500, 0, 1)
    assert answer.facts().keys() == {"lower", "upper", "confidence"}
    same = verify(WALK, "P(always not stairs)", Always(0, together=together), seed=1, episodes=500).result
    assert (same.lower, same.upper) == (1 - answer.result.upper, 1 - answer.result.lower)


@pytest.mark.parametrize("together", [True, False])
def test_steps_until_one_of_two_ends(together):
    answer = verify(WALK, "E(steps until not hall)", Always(0, together=together), seed=1, episodes=400)
    assert answer.result.lower < 2 < answer.result.upper < 2.3
    never = verify(WALK, "E(steps until stairs)", Always(0, together=together), seed=1, episodes=50)
    assert never.facts()["lower"] == never.facts()["upper"] == "infinite"


def test_steps_are_counted_and_limited():
    answer = verify(WALK, "P(reach stairs within 1)", Always(0, together=True), seed=3)
    assert answer.result.lower < 0.3 < answer.result.upper
    answer = verify(WALK, "P(reach action = Go)", Always(0, together=True), seed=3, episodes=5)
    assert answer.result.upper == 1
    answer = verify(WALK, "P(reach stairs before dock)", Always(0, together=True), seed=3, start="dock")
    assert answer.result.lower == 0


@pytest.mark.parametrize("together", [True, False])
def test_what_does_not_end_counts_for_both_ends(together, monkeypatch):
    monkeypatch.setattr("mdm.simulation.batch._LONGEST", 20)
    policy = Always(1, together=together)
    its = evaluate(WALK, policy, until="stairs", episodes=10, seed=1)
    assert its.returns.tolist() == [0] * 10
    assert (its.undecided, its.interval) == (10, (0, 1))
    timed = verify(WALK, "E(steps until not hall)", policy, episodes=10, seed=1).result
    assert (timed.lower, timed.upper, timed.undecided) == (21, math.inf, 10)
    none = evaluate(WALK, policy, until="stairs within 5", episodes=10, seed=1)
    assert (none.undecided, none.interval) == (0, (0, pytest.approx(0.3085, abs=1e-4)))


def test_the_interval_is_that_of_clopper_and_pearson():
    # Of 10 trials 2 hit: 2.52 % to 55.61 %, as in tables of the binomial distribution.
    its = ReachingEvaluation(0.2, 0, np.array([1.0] * 2 + [0.0] * 8), 1, 1, 10, 0.0, undecided=0)
    assert its.interval == pytest.approx((0.0252, 0.5561), abs=1e-4)


@pytest.mark.parametrize("together", [True, False])
def test_a_policy_is_evaluated_until_something_holds(together):
    policy = Always(0, together=together)
    its = evaluate(WALK, policy, until="stairs before dock", episodes=500, seed=1)
    answer = verify(WALK, "P(reach stairs before dock)", policy, episodes=500, seed=1).result
    assert its.interval == (answer.lower, answer.upper)
    assert its.mean == its.returns.mean()
    assert its.interval[0] < its.mean < its.interval[1]
    with pytest.raises(FormatError, match="column 8: the end was expected, not 'dock'"):
        evaluate(WALK, policy, until="stairs dock")
    with pytest.raises(ConfigError, match="until ends episodes by itself"):
        evaluate(WALK, policy, until="stairs", steps=3)


def test_where_a_plan_ends_its_state_counts():
    """It goes once: three in ten end at the stairs, which nothing is decided at."""
    once = FiniteStateController([0], [[None]], 2)
    assert verify(WALK, "P(reach stairs)", once).result.value == pytest.approx(0.3)
    its = evaluate(WALK, once, until="stairs", episodes=2_000, seed=1)
    assert its.interval[0] < 0.3 < its.interval[1]
    assert its.undecided == 0


@pytest.mark.slow
def test_intervals_hold_what_is_computed():
    """A controller is verified exactly, and as a policy over beliefs that it is played by."""
    random, held, count = np.random.default_rng(4), 0, 0
    for _ in range(15):
        rows = random_rows(random, 6, 2)
        model = model_of_rows(rows, random.integers(0, 2, 6).tolist())
        nodes = FiniteStateController([0, 1], random.integers(0, 2, (2, 2)).tolist(), 2)
        exact = verify(model, "P(reach s1 within 6)", nodes).result.value
        for seed in range(20):
            low, high = evaluate(model, nodes, until="s1 within 6", episodes=300, seed=seed).interval
            held += low <= exact <= high
            count += 1
    assert held / count >= 0.91


def test_what_simulation_cannot_say_is_refused():
    with pytest.raises(ModelError, match=r"^the long-run share of a policy over beliefs is not known by simulation"):
        verify(WALK, "S(hall)", Always(0, together=True))
    with pytest.raises(ConfigError, match="at least 1 episode"):
        verify(WALK, "P(reach stairs)", Always(0, together=True), episodes=0)
    with pytest.raises(ModelError, match="no episode has ended"):
        verify(WALK, "P(reach stairs)", Always(0, together=True), progress=lambda *_: True)
    with pytest.raises(ConfigError, match="policy is for 3 states and 2 actions"):
        verify(problems.tiger(), "P(reach tiger-left)", Always(0, together=True))
