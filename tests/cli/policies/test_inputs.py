"""The model and policy that a sub-command works with."""

from __future__ import annotations

from argparse import Namespace

from places import TIGER, TIGER_VECTORS
from sentences import refused

from mdm import FormatError, load_model, load_policy, save_policy
from mdm.cli.policies.inputs import load, load_for, visibility
from mdm.loading import revealed
from mdm.policies import (
    AlphaVectors,
    DeterministicPolicy,
    FiniteStateController,
)
from mdm.problems import grid_world, rock_sample

ARGUMENTS = Namespace(seed=1, false_negative=None)


def test_a_model_says_what_of_its_state_is_visible():
    model = load_model(TIGER)
    assert revealed(model) is model
    assert visibility(model) is None
    sentence = visibility(revealed(rock_sample(2, 1)))
    assert sentence == "the agent sees rover at the start and at every step, as the model declares"
    seeing = DeterministicPolicy([0] * 9, 6)
    assert "takes rock-0 as seen" in visibility(revealed(rock_sample(2, 1)), seeing)
    assert "takes rover, rock-0 as seen" in visibility(rock_sample(2, 1), seeing)
    assert visibility(grid_world(), seeing) is None


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
    with refused(FormatError):
        save_policy(load_policy(TIGER_VECTORS), tmp_path / "x.npz")
        load_for(whole, str(tmp_path / "x.npz"), ARGUMENTS)
