import math

import numpy as np
import pytest

import mdm
from mdm import problems
from mdm.errors import ConfigError, FormatError, ModelError, ModelWarning
from mdm.models import MDP
from mdm.verification import verify

MODEL = MDP(
    [[[0.5, 0.3, 0.2], [0, 1, 0], [0, 0, 1]], np.eye(3)],
    np.zeros((3, 2)),
    discount=0.9,
    states=["hall", "stairs", "dock"],
    actions=["Go", "Wait"],
)


def test_numbers_are_at_the_initial_belief_or_from_a_state():
    assert verify(MODEL, "P(reach stairs)", [0, 0, 0]).result.value == pytest.approx((0.6 + 1) / 3)
    assert verify(MODEL, "P(reach stairs)", [0, 0, 0], start="hall").result.value == pytest.approx(0.6)
    assert verify(MODEL, "P(reach stairs)", start="hall").least.value == 0
    factored = problems.rock_sample(2, 1)
    name = factored.state_space.names[0]
    assert verify(factored, f"P(reach '{name}')", start=0).least.value == 1


def test_facts_have_what_is_asked():
    assert verify(MODEL, "P(reach stairs)", [0, 0, 0]).facts().keys() == {"probability", "error"}
    assert verify(MODEL, "S(stairs)", [0, 0, 0]).facts().keys() == {"value", "error"}
    facts = verify(MODEL, "E(steps until not hall)", start="hall").facts()
    assert facts["least"]["value"] == pytest.approx(2)
    assert facts["greatest"]["value"] == "infinite"


def test_a_discount_and_rewards_count_for_nothing():
    other = MODEL.with_discount(0.1)
    assert verify(other, "E(steps until not hall)", [0, 0, 0], start="hall").result.value == pytest.approx(2)


def test_a_policy_over_states_of_a_pomdp_sees_them():
    tiger = problems.tiger()
    answer = verify(tiger, "P(reach tiger-left and action = open-left within 3)", [2, 1])
    assert answer.result.value == 0


def test_actions_that_are_not_available_are_not_chosen():
    mask = [[True, False], [True, True], [True, True]]
    its = MDP([MODEL.transition_matrix(0), np.eye(3)], np.zeros((3, 2)), discount=0.9, available=mask,
              states=["hall", "stairs", "dock"], actions=["Go", "Wait"])  # fmt: skip
    assert verify(its, "P(reach stairs)", start="hall").least.value == pytest.approx(0.6)
    assert verify(its, "P(reach hall and action = Wait)").greatest.value == 0
    with pytest.raises(ConfigError, match="not available"):
        verify(its, "P(reach stairs)", [1, 1, 1])


def test_nothing_satisfies_x():
    with pytest.warns(ModelWarning, match="nothing in the model satisfies hole-"):
        assert verify(MODEL, "P(reach hole-*)", [0, 0, 0]).result.value == 0
    with pytest.warns(ModelWarning):
        assert verify(MODEL, "E(steps until hole-*)").least.value == math.inf


def test_a_grid_on_which_the_optimal_policy_falls_and_need_not():
    """Each step costs more than a pit: who is as quick as can be jumps into it."""
    ways = np.array([[[0, 1, 0], [0, 1, 0], [0, 0, 1]], [[0.9, 0, 0.1], [0, 1, 0], [0, 0, 1]]])
    rewards = np.array([[-1, -0.4], [0, 0], [0, 0]])
    model = MDP(ways, rewards, discount=0.99, states=["start", "pit", "goal"], initial_belief=[1, 0, 0])
    policy = mdm.solve(model).policy
    assert mdm.verify(model, "P(reach pit)", policy).result.value == 1
    assert mdm.verify(model, "P(reach pit before goal)").least.value == 0
    safe = mdm.verify(model, "P(reach goal)").policies[1]
    assert mdm.verify(model, "P(reach goal)", safe).result.value == 1


def test_paths_of_models_and_bad_input(tmp_path):
    path = tmp_path / "model.npz"
    mdm.save_model(MODEL, path)
    assert verify(path, "P(reach stairs)", [1, 1, 1]).result.value == pytest.approx(1 / 3)
    with pytest.raises(FormatError):
        verify(path, "stairs")
    with pytest.raises(ModelError, match="'stairs'"):
        verify(path, "P(reach stars)")
    with pytest.raises(ModelError, match="no symbol 'dok'"):
        verify(path, "P(reach stairs)", start="dok")
    with pytest.raises(ConfigError):
        verify(path, "P(reach stairs)", [0, 0])


def test_a_policy_of_stages_that_would_be_too_large_is_left_out(monkeypatch):
    from mdm.verification import verification

    monkeypatch.setattr(verification, "_STAGED", 10)
    assert verify(MODEL, "P(reach stairs within 2)").policies == (None, None)
    assert None not in verify(MODEL, "P(reach stairs within 0)").policies
