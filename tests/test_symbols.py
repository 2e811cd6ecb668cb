"""Symbols by index, name and components: of a team, of one of its agents, with a model and without."""

from __future__ import annotations

import numpy as np
import pytest
from sentences import refused

from mdm import ConfigError, ModelError
from mdm.policies import AlphaVectors, DeterministicPolicy, FiniteStateController, JointController
from mdm.problems import dec_tiger, tiger
from mdm.symbols import Symbols, agent_index

VECTORS = AlphaVectors([[0.0, 0.0]], [0], 3)
PLANS = JointController([FiniteStateController([0], [[0, 0]], 3)] * 2)


def test_states_go_by_index_or_name():
    named, bare = Symbols(VECTORS, tiger(), None), Symbols(VECTORS, None, None)
    assert [named.state_index(state) for state in (1, "tiger-right", np.int64(1))] == [1, 1, 1]
    assert bare.state_index(1) == 1
    with refused(ModelError):
        bare.state_index("left")
    for wrong in (2, -1):
        with refused(ModelError):
            bare.state_index(wrong)
    with refused(ModelError):
        named.state_index("tiger-rigt")


def test_observations_go_by_index_name_or_components_some_of_which_may_be_missing():
    symbols = Symbols(JointController([FiniteStateController([0], [[0, 0]], 3)] * 2), dec_tiger(), None)
    left, right = dec_tiger().observation_space.factors[0].names
    assert symbols.observed(2) == (2, (1, 0))
    assert symbols.observed([right, left]) == (2, (1, 0))
    assert symbols.observed([None, right]) == (None, (None, 1))
    with refused(ModelError):
        symbols.observed([None])
    assert symbols.observation_name(2) == repr(dec_tiger().observation_space.names[2])
    assert symbols.observation_name((None, 1)) == "(None, 1)"
    assert symbols.observation_name(99) == "99"


def test_without_observations_there_are_none_to_name():
    with refused(ModelError):
        Symbols(VECTORS, None, None).observed(0)


def test_a_state_s_name_is_certainty_of_it():
    symbols = Symbols(VECTORS, tiger(), None)
    assert symbols.belief_of("tiger-right").tolist() == [0, 1]
    assert symbols.belief_of(0).tolist() == [1, 0]
    assert symbols.belief_of([0.25, 0.75]).tolist() == [0.25, 0.75]
    with refused(ModelError):
        Symbols(PLANS.controllers[0], None, None).belief_of(0)


def test_an_agent_has_the_symbols_of_its_part():
    model = dec_tiger()
    names = [factor.name for factor in model.action_space.factors]
    for agent in (1, names[1]):
        own = Symbols(PLANS, model, agent)
        assert own.policy is PLANS.controllers[1]
        assert own.action_space.factors == (model.action_space.factors[1],)
        assert own.observation_space.factors == (model.observation_space.factors[1],)
        assert own.action_name(0) == model.action_space.factors[1].names[0]
    bare = Symbols(PLANS, None, 1)
    assert len(bare.observation_space) == 2
    assert bare.action_name(2) == "2"


@pytest.mark.parametrize(
    ("policy", "agent", "words"),
    [
        (PLANS, 2, "there is no agent 2; the model has 2"),
        (PLANS, "nobody", "there is no agent 'nobody'; the agents are"),
        (VECTORS, 0, "a controller for each"),
        (DeterministicPolicy([0]), 0, "a controller for each"),
    ],
)
def test_what_is_no_agent_s_part_is_refused(policy, agent, words):
    with pytest.raises(ConfigError, match=words):
        Symbols(policy, dec_tiger(), agent)


def test_agents_go_by_index_or_name():
    assert [agent_index(agent, ["a", "b"], 2) for agent in (0, 1, "b")] == [0, 1, 1]
    with refused(ConfigError):
        agent_index("a", [], 2)
    with refused(ConfigError):
        agent_index(-1, ["a", "b"], 2)
