"""Sets of files of teams whose members move and see on their own."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from random_models import dense
from sentences import refused

from mdm import FormatError, load_model

AGENT = """agents: 1
discount: 0.9
values: reward
states: here there
start: {start}
actions:
stay go
observations:
2
T: stay : here : here : 1
T: stay : there : there : 1
T: go : here : there : {chance}
T: go : here : here : {rest}
T: go : there : here : 1
O: * : here : o0 : {seen}
O: * : here : o1 : {unseen}
O: * : there : o1 : 1
R: go : * : * : * : {cost}
"""


@pytest.fixture
def team(tmp_path):
    (tmp_path / "pair.toi-dpomdp.base").write_text("2\n0.95\n\n")
    first = AGENT.format(start="here", chance=0.75, rest=0.25, seen=0.9, unseen=0.1, cost=-1)
    second = AGENT.format(start="uniform", chance=0.5, rest=0.5, seen=1, unseen=0, cost=-2).replace("stay", "rest")
    (tmp_path / "pair.toi-dpomdp.agent0").write_text(first)
    (tmp_path / "pair.toi-dpomdp.agent1").write_text(second)
    (tmp_path / "pair.toi-dpomdp.rewards").write_text("0 1 1 0 10\n1 1 0 0 5\n1 1 0 0 -5.5\n")
    return tmp_path / "pair.toi-dpomdp.base"


@pytest.mark.parametrize("sparse", [None, True])
def test_products_of_the_agents(team, sparse):
    model = load_model(team, sparse=sparse)
    agents = [np.array([[[1, 0], [0, 1]], [[1 - p, p], [1, 0]]]) for p in (0.75, 0.5)]
    seen = [np.array([[p, 1 - p], [0, 1]]) for p in (0.9, 1)]
    assert (model.num_agents, model.discount, model.kind) == (2, 0.95, "POMDP")
    assert model.action_space.shape == model.state_space.shape == model.observation_space.shape == (2, 2)
    assert [factor.names for factor in model.action_space.factors] == [("stay", "go"), ("rest", "go")]
    np.testing.assert_array_equal(model.initial_belief, [0.5, 0.5, 0, 0])
    for a, b in np.ndindex(2, 2):
        for s, t, x, y in np.ndindex(2, 2, 2, 2):
            transition = dense(model.transition_matrix(2 * a + b))[2 * s + t, 2 * x + y]
            assert transition == agents[0][a, s, x] * agents[1][b, t, y]
            observation = dense(model.observation_matrix(2 * a + b))[2 * x + y, 2 * s + t]
            assert observation == pytest.approx(seen[0][x, s] * seen[1][y, t])
    expected = np.array([[-1 * a - 2 * b for a, b in np.ndindex(2, 2)]] * 4, dtype=float)
    expected[1, 2] += 10
    expected[3, 0] += -5.5
    np.testing.assert_array_equal(model.rewards, expected)


@pytest.mark.parametrize(
    ("suffix", "text", "message"),
    [
        ("base", "two\n0.9", "base:1: a number of agents"),
        ("base", "2", "base:1: a second line, with the discount"),
        ("base", "2\n1.5", "base:2: a discount"),
        ("base", "3\n0.9", "agent2: there is no such file"),
        ("agent1", "agents: 2\n", "agent1"),
        ("rewards", "0 1 1 10", "rewards:1: 2 states, 2 actions and a reward were expected, not 4 words"),
        ("rewards", "\n0 1 1 2 10", "rewards:2: '2' is not one of agent 1's actions, 0 to 1"),
        ("rewards", "0 -1 1 0 10", "'-1' is not one of agent 1's states"),
        ("rewards", "0 1 1 0 nan", "'nan' is not a finite number"),
    ],
)
def test_wrong_sets_are_refused_with_the_file(team, suffix, text, message):
    team.with_suffix(f".{suffix}").write_text(text)
    with pytest.raises(FormatError, match=message):
        load_model(team)


def test_a_file_for_a_team_is_none_of_one_agent(team):
    text = AGENT.format(start="here", chance=1, rest=0, seen=1, unseen=0, cost=0)
    text = text.replace("agents: 1", "agents: 2").replace("stay go\n", "stay go\nstay\n").replace("\n2\n", "\n2\n1\n")
    for action in ("stay", "go"):
        text = text.replace(f" {action} :", f" {action} stay :")
    text = text.replace(": o0", ": o0 o0").replace(": o1", ": o1 o0")
    team.with_suffix(".agent0").write_text(text)
    with refused(FormatError):
        load_model(team)


def test_a_set_is_read_by_its_base_alone(team):
    assert load_model(team.with_suffix("")).num_agents == 2
    with refused(FormatError):
        load_model(team.with_suffix(".rewards"))
    assert load_model(team.with_suffix(".agent0")).num_agents == 1


@pytest.mark.slow
@pytest.mark.foreign("twoCorridors_2.toi-dpomdp of MADPToolbox/MADP")
def test_a_real_set(corpus):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = load_model(corpus / "models" / "madp" / "twoCorridors_2.toi-dpomdp.base")
    assert (len(model.state_space), len(model.action_space), len(model.observation_space)) == (81**2, 9, 28**2)
    assert model.discount == 0.95
    assert model.initial_belief[model.state_space.index(["s1n", "s9n"])] == 1
    # Two agents in one corridor cell pay for it, whatever they do, beside what each does on its own.
    together = model.state_space.index([3, 3])
    alone = model.rewards[model.state_space.index([3, 0])].reshape(3, 3)
    assert (model.rewards[together] <= -100 + alone.max()).all()
    for action in range(9):
        np.testing.assert_allclose(model.transition_matrix(action).sum(axis=1), 1)
