"""How much memory a model is said to take, against what is allocated; and models that take too much."""

from __future__ import annotations

import tracemalloc
from functools import cache

import numpy as np
import pytest
from belief_steps import needs_numba
from sentences import refused

import mdm
from mdm import Controller
from mdm.beliefs import choice
from mdm.beliefs.choice import check_memory, footprint
from mdm.errors import ConfigError
from mdm.models import MDP, POMDP, FactoredPOMDP
from mdm.policies import ConstantPolicy

MEGABYTE = 1e6


def dense_model(states, actions, observations, filled=1.0):
    random = np.random.default_rng(0)
    transitions = random.random((actions, states, states)) * (random.random((actions, states, states)) < filled)
    transitions[:, :, 0] += 0.01
    told = random.random((actions, states, observations))
    return POMDP(
        transitions / transitions.sum(axis=2, keepdims=True),
        told / told.sum(axis=2, keepdims=True),
        np.zeros((states, actions)),
        discount=0.9,
    )


def constant(model, **options):
    return ConstantPolicy(0, len(model.action_space), len(model.state_space), **options)


@cache
def load_kernels():
    """Load compiled kernels, which takes memory of its own, once in a process."""
    for model in (mdm.problems.tiger(), mdm.problems.rock_sample(), dense_model(300, 3, 40, 0.5)):
        mdm.BeliefTracker(model)


MODELS = {
    "fires, three": lambda: mdm.problems.fire_fighting(houses=3, team=3),
    "fires, four": lambda: mdm.problems.fire_fighting(houses=3, team=4),
    "graph": lambda: mdm.problems.fire_fighting_graph(team=5),
    "rocks": mdm.problems.rock_sample,
    "100 states": lambda: dense_model(100, 20, 50),
    "300 states": lambda: dense_model(300, 4, 40, 0.5),
    "1000 states": lambda: dense_model(1000, 8, 20, 0.02),
    "800 states": lambda: dense_model(800, 6, 5, 0.3),
}


@needs_numba  # without it other filters are chosen
@pytest.mark.parametrize("name", MODELS)
def test_what_is_told_is_within_a_factor_of_two_of_what_is_allocated(name):
    model = MODELS[name]()
    told = footprint(model, beliefs=True)
    policy = constant(model)
    load_kernels()
    tracemalloc.start()
    Controller(policy, model)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak > 4 * MEGABYTE
    assert 0.5 < told / peak < 2


def test_mdps_take_their_rewards_and_what_flattening_takes():
    flat = MDP(np.ones((2, 1, 1)), np.zeros((1, 2)), discount=0.9)
    assert footprint(flat, beliefs=False) == 16
    model = mdm.problems.fire_fighting(houses=3, team=4)
    told = footprint(model, beliefs=False)
    tracemalloc.start()
    model.flatten()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert 0.5 < told / peak < 2
    assert footprint(model, beliefs=False) == model.rewards.nbytes  # now that it is flat


def test_a_model_that_is_too_large_is_refused_with_figures_and_what_helps():
    model = mdm.problems.fire_fighting(houses=3, team=6)
    with pytest.raises(ConfigError) as refused:
        check_memory(model, 1000, beliefs=True, matrices="a search")
    text = str(refused.value)
    assert refused.value.key == "memory"
    for part in ("110592 states", "729 actions", "64 observations", "T 1.9 GB", "O 57 MB", "R 645 MB", "a search"):
        assert part in text
    assert "alpha vectors" in text
    assert not model.is_flattened


@pytest.mark.parametrize(
    ("model", "limit", "helps"),
    [
        (dense_model(300, 4, 40, 0.5), 1, "give it as factors"),
        (mdm.problems.fire_fighting(team=3).with_false_negatives(0), 1, "its false negative needs the matrices"),
        (mdm.problems.fire_fighting(team=3), None, "with the option memory"),
    ],
    ids=["flat", "false negatives", "speed"],
)
def test_what_helps_depends_on_the_model(model, limit, helps, monkeypatch):
    monkeypatch.setattr(choice, "free_memory", lambda: 1e6)
    with pytest.raises(ConfigError, match=helps) as refused:
        Controller(constant(model), model, memory=limit)
    assert refused.value.key == "memory"
    assert ("at most 1 MB are allowed" if limit else "the machine has 1 MB free") in str(refused.value)
    assert not isinstance(model, FactoredPOMDP) or not model.is_flattened


@pytest.mark.parametrize("memory", [0, -1, "1", True, float("nan")])
def test_memory_is_a_number_of_megabytes(memory):
    with refused(ConfigError):
        Controller(constant(mdm.problems.tiger()), mdm.problems.tiger(), memory=memory)


def test_a_machine_that_does_not_say_what_is_free_refuses_nothing(monkeypatch, tmp_path):
    monkeypatch.setattr(choice, "_MEMORY", str(tmp_path / "none"))
    check_memory(mdm.problems.tiger(), None, beliefs=True)
    (tmp_path / "some").write_text("MemTotal: 2 kB\nMemAvailable: 0 kB\n")
    monkeypatch.setattr(choice, "_MEMORY", str(tmp_path / "some"))
    with refused(ConfigError):
        check_memory(mdm.problems.tiger(), None, beliefs=True)
