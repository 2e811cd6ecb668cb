"""The fewest factors of a state that decide otherwise, against all states."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies as st
from sentences import refused

import mdm
from mdm import ModelError
from mdm.explanation import changes, state_changes
from mdm.models import MDP, Factor, Space
from mdm.policies import DeterministicPolicy, QTable, StagedPolicy, StatePolicy, StochasticPolicy
from mdm.solvers.online import TreeSearch

SEEDS = st.integers(0, 2**32 - 1)


def over(factors, actions):
    """Return a model over states of some factors."""
    space = Space(Factor(f"f{place}", [f"v{value}" for value in range(size)]) for place, size in enumerate(factors))
    count = len(space)
    return MDP([np.eye(count)] * actions, np.zeros((count, actions)), discount=0.9, states=space)


@given(SEEDS)
def test_the_fewest_of_all_states(seed):
    random = np.random.default_rng(seed)
    factors = random.integers(1, 4, size=int(random.integers(1, 4))).tolist()
    model = over(factors, 2)
    space = model.state_space
    table = (random.random(len(space)) < 0.2).astype(int).tolist()
    controller = mdm.Controller(DeterministicPolicy(table, 2), model)
    state = int(random.integers(len(space)))
    step = controller.see(state)
    here = space.unravel(state)
    others = {}
    for other in range(len(space)):
        if table[other] != step.action:
            apart = sum(a != b for a, b in zip(here, space.unravel(other), strict=True))
            others.setdefault(apart, []).append(other)
    found, ways = state_changes(step.case())
    if not others:
        assert (found, ways) == ([], 0)
        return
    fewest = min(others)
    assert ways == len(others[fewest])
    for change in found:
        there = list(here)
        for each in change.factors:
            place = int(each.factor[1:])
            assert each.before == f"v{here[place]}"
            there[place] = int(each.after[1:])
        assert len(change.factors) == fewest
        assert space.ravel(there) in others[fewest]
        assert change.action == model.action_space.names[1 - step.action]


def test_a_stage_stays_as_it_is():
    policy = StagedPolicy([[[0, 1], [1, 0]], [[0, 1], [0, 1]]])
    controller = mdm.Controller(policy)
    first, second = controller.see(0), controller.see(0)
    assert state_changes(first.case())[1] == 1
    assert state_changes(second.case()) == ([], 0)


def test_a_draw_stays_as_it_is():
    policy = StochasticPolicy([[1.0, 0.0, 1.0], [0.0, 1.0, 0.0]], seed=1)
    found, ways = state_changes(mdm.Controller(policy).see(0).case())
    assert ([change.factors[0].after for change in found], ways) == (["1"], 1)


def test_without_a_model_states_are_numbers():
    (found,), _ = state_changes(mdm.Controller(QTable([[1, 0], [0, 1]])).see(1).case())
    assert (found.factors[0].factor, found.factors[0].before, found.factors[0].after) == ("state", "1", "0")
    assert found.action == "0"


def test_what_is_too_much(monkeypatch):
    model = over([3, 3], 2)
    search = TreeSearch(model, expansions=2)
    with refused(ModelError):
        state_changes(mdm.Controller(search, model).see(0).case())
    monkeypatch.setattr(changes, "_MOST_STATES", 4)
    with refused(ModelError):
        state_changes(mdm.Controller(DeterministicPolicy([0] * 9, 2), model).see(0).case())


def test_an_information_state_of_ones_own():
    class Turn:
        takes, current = "state", (0, True)

        def reset(self, belief=None):
            pass

        def update(self, action, state):
            return 1.0

    class Alternate(StatePolicy):
        num_states, num_actions = 2, 2

        def information(self, model):
            return Turn()

        def action(self, current):
            return int(current[1])

    step = mdm.Controller(Alternate()).see(0)
    assert step.explain().state is None
    with refused(ModelError):
        state_changes(step.case())
