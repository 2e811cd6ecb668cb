"""The words for states and observations that are decided on."""

from __future__ import annotations

import pytest

from mdm import Ensemble, PredicateManager, StateFactor
from mdm.models import MDP, POMDP, Factor, Space
from mdm.policies import AlphaVectors, DeterministicPolicy


def words(robot, *, state=None, observation=None):
    return robot.control.output.words(state, observation)


def doors(observations):
    size = len(observations)
    return POMDP(
        [[[0.5, 0.5], [0.5, 0.5]]],
        [[[1 / size] * size] * 2],
        [[0.0], [0.0]],
        discount=0.9,
        states=Space([Factor("door", ["open", "closed"])]),
        actions=Space([Factor("action", ["go"])]),
        observation_names=observations,
    )


@pytest.mark.parametrize(
    ("factors", "given", "told"),
    [
        ([("ear", ["left", "right"])], 1, "right"),
        ([("ear", ["left", "right"])], (None,), None),
        ([("ear", ["left", "right"]), ("eye", ["dark", "light"])], 2, "ear=right, eye=dark"),
        ([("ear", ["left", "right"]), ("eye", ["dark", "light"])], (None, 1), "eye=light"),
    ],
)
def test_observations_are_told_by_what_is_known_of_them(factors, given, told):
    model = doors(Space([Factor(name, symbols) for name, symbols in factors]))
    robot = Ensemble("robot", policy=AlphaVectors([[0.0, 0.0]], [0], 1), model=model, actions={"go": print})
    assert words(robot, observation=given) == ({} if told is None else {"observation": told})


def test_states_are_told_by_the_model_s_names():
    model = MDP([[[0.5, 0.5], [0.5, 0.5]]], [[0.0], [0.0]], discount=0.9, states=["open", "closed"], actions=["go"])
    robot = Ensemble("robot", policy=DeterministicPolicy([0, 0], 1), model=model, actions={"go": print})
    assert words(robot, state=1) == {"state": "closed"}


def test_states_without_a_model_are_told_by_their_predicates():
    manager = PredicateManager()
    for name in ("Hall", "Lab", "Dark"):
        manager.sensor(name, initial=False)
    robot = Ensemble(
        "robot",
        policy=DeterministicPolicy([0] * 4, 1),
        predicates=manager,
        states=[StateFactor("room", ["Hall", "Lab"]), StateFactor("dark", ["Dark"])],
        actions={0: print},
    )
    assert words(robot, state=2) == {"state": "Lab, not Dark"}
    assert words(robot, state=1) == {"state": "Hall, Dark"}


def test_an_index_stays_where_nothing_has_a_name():
    robot = Ensemble("robot", policy=DeterministicPolicy([0, 0], 1), actions={0: print})
    assert words(robot, state=1) == {"state": 1}
