"""Models from functions: the same numbers as from arrays, and errors that name state and action."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from sentences import refused

import mdm
from mdm.errors import ModelError
from mdm.models import MDP, POMDP, Factor, Space
from mdm.models.digest import digest


def rows(model, action, state):
    """Return the row of T as a dict from the names of states to probabilities."""
    return dict(zip(model.state_space.names, model.transition(action, state), strict=True))


@pytest.mark.parametrize(
    "problem",
    [
        mdm.problems.tiger(),
        mdm.problems.machine_maintenance(),
        mdm.problems.grid_world("..+/.#-"),
        mdm.problems.dec_tiger(),
        mdm.problems.rock_sample(3, 2),
    ],
    ids=str,
)
def test_a_problem_described_by_functions_has_its_own_digest(problem):
    problem = problem.flatten()
    states = values(problem.state_space)
    described = {
        "transition": lambda s, a: list(zip(states, problem.transition(a, s), strict=True)),
        "reward": lambda s, a: problem.reward(a, s),
        "discount": problem.discount,
        "initial": list(zip(states, problem.initial_belief, strict=True)),
    }
    spaces = [problem.state_space, problem.action_space]
    if problem.pomdp is None:
        model = MDP.from_functions(*spaces, **described)
    else:
        symbols = values(problem.observation_space)
        described["observation"] = lambda a, s2: list(zip(symbols, problem.observation(a, s2), strict=True))
        model = POMDP.from_functions(*spaces, problem.observation_space, **described)
    assert digest(model) == digest(problem)


def values(space):
    """Return the values of a space: names, or tuples of names."""
    return list(space.names) if len(space.factors) == 1 else list(product(*(each.names for each in space.factors)))


@settings(max_examples=50)
@given(st.integers(1, 5), st.integers(1, 3), st.integers(0, 2**32 - 1))
def test_random_numbers_come_through_whatever_form_a_distribution_has(states, actions, seed):
    random = np.random.default_rng(seed)
    numbers = random.dirichlet(np.ones(states), size=(actions, states))
    outcomes = random.normal(size=(actions, states, states))

    def transition(s, a):
        row = numbers[a, s]
        if (s + a) % 2:
            return {int(after): float(row[after]) for after in range(states)}
        return ((after, row[after] / 2) for after in [*range(states), *range(states)])  # a generator, each twice

    model = MDP.from_functions(
        range(states),
        range(actions),
        transition=transition,
        reward=lambda s, a, s2: outcomes[a, s, s2],
        discount=0.9,
    )
    expected = MDP(numbers, outcomes, discount=0.9)
    for action in range(actions):
        np.testing.assert_allclose(model.transition_matrix(action), expected.transition_matrix(action), atol=1e-15)
        for state in range(states):
            for after in range(states):
                assert model.reward(action, state, after) == outcomes[action, state, after]
    np.testing.assert_allclose(model.rewards, expected.rewards, atol=1e-12)
    np.testing.assert_array_equal(model.outcome_rewards.array(1000), outcomes)
    assert model.outcome_rewards.array(0) is None


@dataclass(frozen=True)
class Cell:
    row: int

    def __str__(self):
        return f"cell {self.row}"


class Turn(Enum):
    LEFT = -1
    RIGHT = 1


def walk(cell, turn):
    return Cell(min(max(cell.row + turn.value, 0), 2))


def test_states_are_found_from_the_first_one():
    model = MDP.from_functions(
        None, Turn, transition=walk, reward=lambda cell, _: cell.row, discount=0.9, initial={Cell(1): 1.0}
    )
    assert list(model.state_space.names) == ["cell 1", "cell 0", "cell 2"]
    assert list(model.action_space.names) == ["LEFT", "RIGHT"]
    assert rows(model, "RIGHT", "cell 1") == {"cell 1": 0, "cell 0": 0, "cell 2": 1}
    assert model.initial_belief.tolist() == [1, 0, 0]
    assert model.rewards[:, 0].tolist() == [1, 0, 2]


def test_a_state_without_a_chance_is_not_reached():
    model = MDP.from_functions(
        None, ["go"], transition=lambda s, a: {s: 1.0, "nowhere": 0.0} if s else 0, reward=abs2, discount=1.0, initial=0
    )
    assert list(model.state_space.names) == ["0"]


def abs2(state, action):
    return 0.0


def test_factors_stay_factors_and_tuples_of_their_values_are_states():
    def move(state, action):
        assert state._fields == ("room", "full")
        return {(action.robot, True): 0.5, (state.room, False): 0.5}

    model = MDP.from_functions(
        {"room": ["hall", "lab"], "full": [False, True]},
        {"robot": ["hall", "lab"], "lamp": ["on"]},
        transition=move,
        reward=lambda state, action: state.full,
        discount=0.9,
        initial=("lab", True),
    )
    assert model.state_space == Space([Factor("room", ["hall", "lab"]), Factor("full", ["False", "True"])])
    assert model.num_agents == 2
    assert model.transition("lab on", "hall False", "lab True") == 0.5
    assert model.initial_belief.tolist() == [0, 0, 0, 1]


def test_observations_may_be_of_events():
    model = POMDP.from_functions(
        ["shut", "open"],
        ["push"],
        ["click", "silence"],
        transition=lambda s, a: {"shut": 0.5, "open": 0.5},
        observation=lambda s, a, s2: "silence" if s == s2 else {"click": 0.75, "silence": 0.25},
        reward=lambda s, a: 0.0,
        discount=0.9,
    )
    assert model.event_observations
    assert model.observation("push", "open", "click", state="shut") == 0.75
    assert model.observation("push", "open", "click", state="open") == 0


def test_functions_are_not_called_where_an_action_is_not_available():
    def refuse(state, action):
        assert (state, action) != ("edge", "fall")
        return state

    model = MDP.from_functions(
        ["edge", "floor"],
        ["stay", "fall"],
        transition=refuse,
        reward=lambda s, a: len(refuse(s, a)),
        discount=0.9,
        available=lambda s, a: (s, a) != ("edge", "fall"),
    )
    assert model.available.tolist() == [[True, False], [True, True]]
    found = MDP.from_functions(
        None,
        ["fall", "stay"],
        transition=refuse,
        reward=lambda s, a: 0,
        discount=0.9,
        initial="edge",
        available=lambda s, a: (s, a) != ("edge", "fall"),
    )
    assert list(found.state_space.names) == ["edge"]


@pytest.mark.parametrize(
    "wrong",
    [
        {"transition": lambda s, a: "hom"},
        {"transition": lambda s, a: {"home": 0.4}},
        {"transition": lambda s, a: {"home": "often"}},
        {"transition": lambda s, a: {"home": -1, "work": 2}},
        {"transition": lambda s, a: [0.5, 0.5]},
        {"transition": lambda s: s},
        {"transition": [[1, 0], [0, 1]]},
        {"reward": lambda s, a: None},
        {"reward": lambda s, a: float("inf")},
        {"reward": lambda s: 1},
        {"initial": "hme"},
        {"initial": {"home": 0.5}},
        {"states": ["home", "home"]},
        {"states": [1, "1"]},
        {"states": 2},
        {"states": "home"},
        {"states": None},
        {"states": {"room": ["hall"], "door": []}},
        {"available": lambda s, a: s == "home"},
        {"discount": 0},
    ],
    ids=range(20),
)
def test_an_error_names_state_and_action(wrong):
    given = {"states": ["home", "work"], "actions": ["go"], "transition": lambda s, a: s, "reward": lambda s, a: 1}
    with refused(ModelError):
        MDP.from_functions(**given | {"discount": 0.9} | wrong)
