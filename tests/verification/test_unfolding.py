import numpy as np
import pytest
from random_processes import model_of_rows, random_rows

from mdm import problems
from mdm.errors import ConfigError, ModelError
from mdm.policies import BeliefPolicy, FiniteStateController
from mdm.verification import verify

WRONG = "tiger-left and action = open-left"


class Sure(BeliefPolicy):
    """Listens until it is sure by .9 of where the tiger is."""

    num_states, num_actions = 2, 3

    def action(self, belief):
        return 0 if belief.max() < 0.9 else 1 + int(belief.argmax() == 0)


class One(BeliefPolicy):
    """Takes one action."""

    num_states, num_actions = 6, 2

    def action(self, belief):
        return 1


def test_a_door_is_opened_after_two_sounds_more_from_the_other():
    # A walk of differences from 0 to 2 or -2, by .85 and .15: it ends at the wrong one by .15^2 / (.15^2 + .85^2).
    asked = f"P(reach {WRONG} before action = open-left or action = open-right)"
    answer = verify(problems.tiger(), asked, Sure(), episodes=300, seed=1, bounds=60)
    wanted = 0.5 * 0.15**2 / (0.15**2 + 0.85**2)
    assert answer.bounds.lower - 1e-12 <= wanted <= answer.bounds.upper + 1e-12
    assert answer.bounds.upper - answer.bounds.lower < 1e-8
    assert answer.result.lower < wanted < answer.result.upper
    assert answer.facts()["bounds"].keys() == {"lower", "upper", "beliefs", "seconds"}
    never = verify(problems.tiger(), f"P(always not ({WRONG}))", Sure(), episodes=100, seed=1, bounds=0)
    assert (never.bounds.lower, never.bounds.upper, never.bounds.beliefs) == (0, 1, 0)


@pytest.mark.parametrize("text", ["P(reach s1 within 5)", "P(reach s1 before s2)", "P(always not s1)"])
def test_bounds_hold_the_number_of_a_controller_that_does_the_same(text):
    random = np.random.default_rng(3)
    for _ in range(5):
        model = model_of_rows(random_rows(random, 6, 2), random.integers(0, 2, 6).tolist())
        exact = verify(model, text, FiniteStateController([1], [[0, 0]], 2)).result.value
        found = verify(model, text, One(), episodes=1, seed=1, bounds=0.2).bounds
        assert found.lower - 1e-12 <= exact <= found.upper + 1e-12


def test_what_has_no_belief_graph_is_refused():
    tiger = problems.tiger()
    with pytest.raises(ModelError, match="bounds probabilities"):
        verify(tiger, "E(steps until action = open-left)", Sure(), episodes=1, bounds=1)
    with pytest.raises(ModelError, match="an observation at each step"):
        verify(tiger.with_false_negatives("hear-left"), f"P(reach {WRONG})", Sure(), episodes=1, bounds=1)
    with pytest.raises(ConfigError, match="bounds are for policies over beliefs"):
        verify(tiger, f"P(reach {WRONG})", bounds=1)
