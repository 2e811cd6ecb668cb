"""Policies that are of another model than the one beside them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import mdm
from mdm.cli.files.check import stale
from mdm.models import MDP
from mdm.policies import DeterministicPolicy, QTable

MODEL = """discount: 0.9
values: reward
states: {states}
actions: stay go
T: stay identity
T: go
0.0 1.0 0.0
0.0 0.0 1.0
1.0 0.0 0.0
R: stay : b : * : * {reward}
R: go : * : * : * -1
"""


def optimal(model):
    """The fixed point of Bellman's equation, by iteration here."""
    transitions = np.stack([model.transition_matrix(action) for action in range(len(model.action_space))])
    values = np.zeros(len(model.state_space))
    for _ in range(2_000):
        q = model.rewards + model.discount * (transitions @ values).T
        values = q.max(axis=1)
    return q


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_what_solves_a_model_is_that_of_the_model_and_not_of_one_with_other_rewards(data):
    states, actions = data.draw(st.integers(2, 5)), data.draw(st.integers(1, 3))
    generator = np.random.default_rng(data.draw(st.integers(0, 1000)))
    transitions = generator.dirichlet(np.ones(states), size=(actions, states))
    rewards = generator.uniform(-1, 1, (states, actions))
    model = MDP(transitions, rewards, discount=0.9)
    q = optimal(model)
    best = DeterministicPolicy(q.argmax(axis=1).tolist(), actions)
    assert stale(model, QTable(q), "m.mdp", "p.policy") is None
    assert stale(model, best, "m.mdp", "p.policy") is None
    state, action = data.draw(st.integers(0, states - 1)), data.draw(st.integers(0, actions - 1))
    rewards[state, action] += 100
    other = MDP(transitions, rewards, discount=0.9)
    assert "p.policy is not that of m.mdp" in stale(other, QTable(q), "m.mdp", "p.policy")
    if action != best.actions[state]:  # whose advantage by the old values is below 20
        assert "p.policy is not that of m.mdp" in stale(other, best, "m.mdp", "p.policy")


def test_a_model_that_is_large_or_of_other_sizes_is_not_looked_at():
    small = MDP([np.eye(2)], [[0.0], [1.0]], discount=0.9)
    assert stale(small, QTable([[0.0]] * 3), "m", "p") is None
    large = MDP([np.eye(2_001)], np.zeros((2_001, 1)), discount=0.9)
    assert stale(large, QTable(np.ones((2_001, 1))), "m", "p") is None


@pytest.mark.parametrize(
    ("states", "reward", "told"),
    [("a b c", 1, False), ("b a c", 1, True), ("a b c", 3, True)],
)
def test_check_tells_of_a_policy_that_was_solved_before_the_model_changed(mdm_file, states, reward, told):
    mdm_command, folder = mdm_file
    (folder / "robot.mdp").write_text(MODEL.format(states="a b c", reward=1))
    assert mdm_command("solve", folder / "robot.mdp", "-o", folder / "robot.policy")[0] == 0
    (folder / "robot.mdp").write_text(MODEL.format(states=states, reward=reward))
    (folder / "robot.toml").write_text(
        '[ensembles.robot]\nmodel = "robot.mdp"\npolicy = "robot.policy"\n'
        'actions = { stay = "robot:stay", go = "robot:stay" }\n'
    )
    (folder / "robot.py").write_text("def stay(): ...\n")
    for words in (("robot.toml",), ("robot.policy", "--model", folder / "robot.mdp")):
        status, lines, errors = mdm_command("check", folder / words[0], *words[1:])
        assert (status, errors) == (0, "")
        assert any("robot.policy is not that of robot.mdp" in line for line in lines) is told


def test_a_list_of_actions_in_the_file_itself_is_its_writer_s(mdm_file):
    mdm_command, folder = mdm_file
    (folder / "robot.mdp").write_text(MODEL.format(states="a b c", reward=1))
    (folder / "robot.toml").write_text(
        '[ensembles.robot]\nmodel = "robot.mdp"\npolicy = [0, 0, 0]\n'
        'actions = { stay = "robot:stay", go = "robot:stay" }\n'
    )
    (folder / "robot.py").write_text("def stay(): ...\n")
    assert not any("is not that" in line for line in mdm_command("check", folder / "robot.toml")[1])


@pytest.fixture
def mdm_file(request, tmp_path):
    return request.getfixturevalue("mdm"), tmp_path


def test_an_archive_keeps_the_names_and_is_refused_where_they_have_changed(tmp_path):
    (tmp_path / "robot.mdp").write_text(MODEL.format(states="a b c", reward=1))
    model = mdm.load_model(tmp_path / "robot.mdp")
    mdm.save_policy(mdm.solve(model).policy, tmp_path / "robot.npz", model)
    (tmp_path / "robot.mdp").write_text(MODEL.format(states="b a c", reward=1))
    with pytest.raises(mdm.FormatError, match="state"):
        mdm.load_policy(tmp_path / "robot.npz", mdm.load_model(tmp_path / "robot.mdp"))
