"""Policies and trackers of a user's own, named in a file."""

from __future__ import annotations

import io
import json
import sys

import pytest
from loading import written
from sentences import refused

import mdm
from mdm import ConfigError, load_system
from mdm.cli import main
from mdm.config import look_over
from mdm.config.functions import is_reference
from mdm.testing import capture_decisions, run_virtual

CODE = """
import mdm
from mdm.policies import BeliefPolicy, StatePolicy

class Opposite(StatePolicy):
    num_states, num_actions = 2, 2
    def action(self, state):
        return 1 - state

class Cautious(BeliefPolicy):
    num_states, num_actions = 2, 3
    def action(self, belief):
        return 0 if belief.max() < 0.9 else 1 + int(belief.argmax() == 0)

def of_model(model):
    policy = Cautious()
    policy.num_states = len(model.state_space)
    return policy

class Stubborn:
    def __init__(self, model):
        self.reset()
    def reset(self, belief=None):
        self.current = [0.95, 0.05]
    def update(self, action, observation):
        return 1.0

def broken():
    return {}["gone"]

def of_two(model, seed):
    return Cautious()

def empty():
    pass

def rest(): ...
"""
STATES = """
[predicates]
A = { initial = true }
[ensembles.robot]
policy = "own_code:Opposite"
states.a = ["A"]
actions = { no = "own_code:rest", yes = "own_code:rest" }
"""
TIGER = """
[ensembles.robot]
model = "tiger.pomdp"
policy = "own_code:of_model"
actions = { listen = "own_code:rest", open-left = "own_code:rest", open-right = "own_code:rest" }
"""


@pytest.fixture
def made(tmp_path):
    def make(text):
        (tmp_path / "own_code.py").write_text(CODE)
        mdm.save_model(mdm.problems.tiger(), tmp_path / "tiger.pomdp")
        return written(tmp_path, text, "robot.toml")

    return make


def decided(file, *observations):
    system = load_system(file)

    async def main(runtime):
        with capture_decisions(runtime) as decisions:
            await runtime.start(system)
            for observation in observations:
                system.ensembles["robot"].publish_observation(observation)
        return [decision.action_name for decision in decisions]

    return run_virtual(main)


def test_a_policy_of_one_s_own_decides(made):
    assert decided(made(STATES)) == ["no"]


def test_a_function_is_given_the_model(made):
    assert decided(made(TIGER), "hear-left", "hear-left") == ["listen", "listen", "open-right"]


def test_a_tracker_of_one_s_own_is_what_is_decided_on(made):
    file = made(TIGER.replace("policy =", 'tracker = "own_code:Stubborn"\npolicy ='))
    assert decided(file, "hear-right") == ["open-right", "open-right"]


@pytest.mark.parametrize("text", [STATES, TIGER, TIGER.replace("policy =", 'tracker = "own_code:Stubborn"\npolicy =')])
def test_a_file_is_looked_over_without_its_module(made, text):
    file = made(text)
    (file.parent / "own_code.py").write_text(CODE + "\n1 / 0\n")
    policy = look_over(file).ensembles["robot"].controller.policy
    assert policy.num_states == 2
    assert policy.input == ("belief" if "tiger" in text else "state")


@pytest.mark.parametrize(
    ("old", "new", "key", "imported"),
    [
        ("own_code:Opposite", "own_code:Oposite", "policy", False),
        ("own_code:Opposite", "nowhere_code:Opposite", "policy", False),
        ("own_code:Opposite", "own_code:broken", "policy", True),
        ("own_code:Opposite", "own_code:of_two", "policy", True),
        ("own_code:Opposite", "own_code:empty", "policy", True),
        ("own_code:Opposite", "own_code:dict", "policy", True),
        ('Opposite"', 'Opposite"\nseed = 1', "policy", True),
        ('Opposite"', 'Opposite"\npolicy_kind = "q"', "policy_kind", False),
        ('Opposite"', 'Opposite"\ntracker = "own_code:Stubborn"', "tracker", True),
        ('Opposite"', 'Opposite"\ntracker = "own_code:empty"', "tracker", True),
    ],
)
def test_what_is_wrong_is_told_with_its_key(made, old, new, key, imported):
    file = made(STATES.replace(old, new).replace("dict", "rest.__class__"))
    for load in (load_system,) if imported else (load_system, look_over):
        with refused(ConfigError) as raised:
            load(file)
        assert [problem.key for problem in raised.value.problems] == [f"ensembles.robot.{key}"]


def test_traces_and_simulations_decide_by_it(made, monkeypatch, capsys):
    file = made(TIGER)
    heard = b'{"observation": "hear-left"}\n{"observation": "hear-left"}\n'
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(heard)))
    assert main(["trace", str(file)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [json.loads(line)["action_name"] for line in lines] == ["listen", "listen", "open-right"]
    counted = ["--episodes", "5", "--seed", "1"]
    assert main(["simulate", str(file), *counted]) == 0
    own = capsys.readouterr().out
    model, vectors = str(file.parent / "tiger.pomdp"), str(file.parent / "cautious.alpha")
    mdm.save_policy(mdm.policies.AlphaVectors([[0.0, 0.0], [-90.0, 10.0], [10.0, -90.0]], [0, 1, 2]), vectors)
    assert main(["simulate", "--model", model, "--policy", vectors, *counted]) == 0
    assert capsys.readouterr().out == own


@pytest.mark.parametrize(
    ("text", "is_one"),
    [
        ("robot:Policy", True),
        ("a.b:c.d", True),
        ("C:\\robot.npz", False),
        ("C:/robot.npz", False),
        ("robot.npz", False),
    ],
)
def test_a_path_is_no_reference(text, is_one):
    assert is_reference(text) is is_one


def test_a_belief_is_given_by_the_name_of_a_state(made):
    file = made(TIGER.replace("policy =", 'initial_belief = "tiger-left"\npolicy ='))
    assert load_system(file).ensembles["robot"].controller.belief.tolist() == [1.0, 0.0]
    with refused(ConfigError) as raised:
        load_system(made(TIGER.replace("policy =", 'initial_belief = "tiger-lift"\npolicy =')))
    assert raised.value.problems[0].key == "ensembles.robot.initial_belief"


def test_the_policy_of_an_ensemble_cannot_be_set(made):
    robot = load_system(made(STATES)).ensembles["robot"]
    before = robot.policy
    with refused(ConfigError):
        robot.policy = [0, 1]
    assert robot.policy is before
