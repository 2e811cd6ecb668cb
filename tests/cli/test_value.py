"""What policies claim to be worth at the start, and the world they are judged in."""

from __future__ import annotations

from argparse import Namespace

import numpy as np
import pytest
from places import TIGER, TIGER_VECTORS

from mdm import FormatError, load_model, load_policy, save_policy
from mdm.cli.value import claim, load, load_for, revealed, shown
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

CHAIN = MDP([np.eye(2)], np.zeros((2, 1)), discount=0.9, initial_belief=[0.25, 0.75])
ARGUMENTS = Namespace(seed=1, false_negative=None)


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
    assert claim(CHAIN, policy) == value


def test_where_some_of_the_state_is_seen_the_claim_is_an_average_over_what_is_seen_first():
    model = revealed(rock_sample(2, 1))
    assert isinstance(model, MixedPOMDP)
    seen = int(model.seen_in[model.initial_belief.argmax()])
    vectors = MixedAlphaVectors([[1.0, 3.0]], [0], [seen], len(model.action_space), states=model.layout)
    assert claim(model, vectors) == pytest.approx(2.0)  # the only rock is good or bad, by half


def test_a_model_is_shown_as_it_says():
    model = load_model(TIGER)
    assert revealed(model) is model
    assert shown(model) is None
    sentence = shown(revealed(rock_sample(2, 1)))
    assert sentence == "the agent sees rover at every step, and at the start: as the model says"


def test_a_discount_may_be_another():
    assert load(str(TIGER), None).discount == 0.95
    assert load(str(TIGER), 0.5).discount == 0.5


def test_a_policy_is_loaded_for_what_it_was_made_for(tmp_path):
    model = load_model(TIGER)
    policy, world = load_for(model, str(TIGER_VECTORS), ARGUMENTS)
    assert (type(policy), world) == (AlphaVectors, model)
    _, world = load_for(model, str(TIGER_VECTORS), Namespace(seed=1, false_negative="hear-left"))
    assert world.false_negative == 0
    whole = rock_sample(2, 1)
    seen = revealed(whole)
    for width, expected in ((len(whole.observation_space), whole), (len(seen.observation_space), seen)):
        actions = len(whole.action_space)
        save_policy(FiniteStateController([0], [[0] * width], actions), tmp_path / "x.npz")
        _, world = load_for(whole, str(tmp_path / "x.npz"), ARGUMENTS)
        assert type(world) is type(expected)
    with pytest.raises(FormatError, match="but the model has"):
        save_policy(load_policy(TIGER_VECTORS), tmp_path / "x.npz")
        load_for(whole, str(tmp_path / "x.npz"), ARGUMENTS)
