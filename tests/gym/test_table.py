"""Models of Gymnasium's tables, against value iteration on the tables themselves."""

from __future__ import annotations

from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

import mdm
from mdm import ModelError


def values(table, discount):
    """Return the value of each state by value iteration on a table, terminated outcomes worth their reward alone."""
    size, actions = len(table), len(table[0])
    cells = [(s, a, *outcome) for s in range(size) for a in range(actions) for outcome in table[s][a]]
    states, chosen, chances, after, rewards, ends = map(np.array, zip(*cells, strict=True))
    found = np.zeros(size)
    while True:
        worth = chances * (rewards + discount * found[after] * ~ends)
        better = np.bincount(states * actions + chosen, worth).reshape(size, actions).max(axis=1)
        if np.abs(better - found).max() < 1e-10:
            return better
        found = better


TOYS = [
    ("FrozenLake-v1", {}),
    ("FrozenLake-v1", {"map_name": "8x8", "is_slippery": True}),
    ("Taxi-v4" if "Taxi-v4" in gymnasium.registry else "Taxi-v3", {}),
    ("CliffWalking-v1" if "CliffWalking-v1" in gymnasium.registry else "CliffWalking-v0", {}),
]


@pytest.mark.parametrize(("name", "options"), TOYS, ids=[f"{name}{options or ''}" for name, options in TOYS])
@pytest.mark.parametrize("discount", [0.9, 0.99])
def test_toys_have_the_values_of_value_iteration_on_their_tables(name, options, discount):
    env = gymnasium.make(name, **options)
    table, start = env.unwrapped.P, env.unwrapped.initial_state_distrib
    model = mdm.gym.model(env, discount=discount)
    solution = mdm.solve(model, gap=1e-9)
    expected = values(table, discount)
    size = env.observation_space.n
    assert (len(model.state_space), len(model.action_space)) == (size + 1, env.action_space.n)
    assert model.state_space.names[size] == "terminated"
    assert np.array_equal(model.initial_belief, [*start, 0])
    for state in range(size):
        assert solution.policy.value(state) == pytest.approx(expected[state], abs=1e-6)
    assert solution.lower == pytest.approx(start @ expected, abs=1e-6)


def test_a_model_s_environment_goes_the_way_of_the_original():
    """Without chance, the same actions bring the same states, rewards and end."""
    cliff = gymnasium.make(TOYS[3][0])
    model = mdm.gym.model(cliff, discount=0.9, actions=["up", "right", "down", "left"])
    env = mdm.gym.environment(model)
    assert cliff.reset()[0] == env.reset()[0] == 36
    for action in ["up", *["right"] * 11]:
        assert cliff.step(model.action_space.index(action))[:4] == env.step(action)[:4]
    theirs, ours = cliff.step(2), env.step("down")
    assert theirs[1:4] == ours[1:4] == (-1, True, False)
    assert (theirs[0], model.state_space.names[ours[0]]) == (47, "terminated")


def made(table, **more):
    return SimpleNamespace(P=table, **more)


@st.composite
def tables(draw):
    """Return a table whose outcomes may come several times, with different rewards, terminated and not."""
    size, actions, random = draw(st.integers(1, 5)), draw(st.integers(1, 3)), draw(st.randoms(use_true_random=False))
    table = {}
    for state in range(size):
        table[state] = {}
        for action in range(actions):
            parts = [random.randint(1, 9) for _ in range(random.randint(1, 4))]
            table[state][action] = [
                (part / sum(parts), random.randrange(size), random.randint(-5, 5), random.random() < 0.2)
                for part in parts
            ]
    return table


@given(tables())
def test_random_tables_have_the_values_of_value_iteration(table):
    model = mdm.gym.model(made(table, isd=np.eye(len(table))[0]), discount=0.8)
    policy = mdm.solve(model, gap=1e-9).policy
    assert [policy.value(state) for state in table] == pytest.approx(list(values(table, 0.8)), abs=1e-6)
    ended = any(outcome[3] for row in table.values() for found in row.values() for outcome in found)
    assert len(model.state_space) == len(table) + ended


LOOP = {0: {0: [(0.0, 0, 9.0, False), (1.0, 1, 0.0, False)]}, 1: {0: [(0.5, 0, 2.0, False), (0.5, 0, 4.0, False)]}}


class Resets:
    """Begins in the states of a list, one after the other."""

    def __init__(self, *first):
        self.P, self._first, self._count = LOOP, first, -1

    def reset(self):
        self._count += 1
        return self._first[self._count % len(self._first)], {}


def test_the_first_state_is_said_or_found():
    for env, initial, expected in (
        (made(LOOP, initial_state_distrib=np.array([0.25, 0.75])), None, [0.25, 0.75]),
        (made(LOOP, isd=[0.25, 0.75]), None, [0.25, 0.75]),
        (made(LOOP, isd=[0.25, 0.75]), 1, [0, 1]),
        (made(LOOP), {0: 0.5, 1: 0.5}, [0.5, 0.5]),
        (made(LOOP), np.array([0.5, 0.5]), [0.5, 0.5]),
        (Resets(1), None, [0, 1]),
        (Resets(0, 1), 0, [1, 0]),
    ):
        assert mdm.gym.model(env, discount=0.5, initial=initial).initial_belief.tolist() == expected
    named = mdm.gym.model(made(LOOP), discount=0.5, initial="here", states=["here", "there"], actions=["go"])
    assert (named.reward("go", "there"), named.transition("go", "here", "there")) == (3.0, 1.0)
    assert named.initial_belief.tolist() == [1, 0]


def test_tables_of_lists_and_of_tuples_are_read_and_missing_actions_are_not_available():
    cells = {
        (0, 0): {"on": [(1, (0, 1), 1, False)]},
        (0, 1): {"on": [(1, (0, 0), 0, False)], "end": [(1, (0, 1), 5, True)]},
    }
    model = mdm.gym.model(made(cells), discount=0.5, initial=(0, 0))
    assert [*model.state_space.names] == ["0,0", "0,1", "terminated"]
    assert model.available.tolist() == [[True, False], [True, True], [True, True]]
    assert mdm.solve(model, gap=1e-9).policy.value(0) == pytest.approx(1 + 0.5 * 5)
    rows = [list(row.values()) for row in LOOP.values()]
    assert mdm.gym.model(made(rows), discount=0.5, initial=1).initial_belief.tolist() == [0, 1]


def test_what_is_wrong_in_a_table_is_said():
    class CartPole:
        pass

    for env, options in (
        (CartPole(), {}),
        (made({}), {}),
        (made("P"), {}),
        (made({0: {0: [(1.0, 0, 0.0)]}}), {}),
        (made({0: {0: [(1.0, 7, 0.0, False)]}}), {}),
        (made({0: {0: 5}}), {}),
        (made({0: {0: [(0.5, 0, 0.0, False)]}}), {"initial": 0}),
        (made(LOOP), {"initial": 9}),
        (made(LOOP), {"initial": {0: 0.5}}),
        (made(LOOP), {"initial": 0, "states": ["here"]}),
        (made(LOOP), {"initial": 0, "actions": ["go", "stay"]}),
        (made(LOOP), {"initial": 0, "actions": mdm.models.Space([mdm.models.Factor("ada", ["x"])])}),
        (Resets(0, 1), {}),
        (made(LOOP), {"initial": 0, "discount": 2}),
    ):
        with refused(ModelError):
            mdm.gym.model(env, **{"discount": 0.5, **options})


def test_the_discount_has_to_be_said():
    with pytest.raises(TypeError, match="discount"):
        mdm.gym.model(made(LOOP))
