"""Position: which place a decision was made on; and robots that go on, whatever disturbs them."""

from __future__ import annotations

import numpy as np
import patrols
import pytest
from rows_of_rooms import row_of_rooms

import mdm
from mdm.maps import Navigation, Places
from mdm.maps.navigation import Position
from mdm.messages import Action
from mdm.models import Factor, Space

FLOOR = row_of_rooms("A", "B", "C")


def ensemble(states=(), model=None, prefix="", policy=(0, 0, 0)):
    predicates = mdm.PredicateManager()
    Places(FLOOR, predicates, prefix=prefix)
    predicates.sensor("Door", initial=False)
    return mdm.Ensemble(
        "robot", policy=list(policy), model=model, predicates=predicates, states=states, actions={"Right": print}
    )


@pytest.mark.parametrize("end", ["", ".reached", ".at_goal"])
def test_the_place_of_a_state_is_the_value_of_the_factor_over_places(end):
    states = [
        mdm.StateFactor("door", ["Door"]),
        mdm.StateFactor("place", [f"In{name}{end}" for name in "CAB"]),
        mdm.StateFactor("shut", {"yes": "Door"}),
    ]
    position = Position(ensemble(states, prefix="In", policy=[0] * 12), FLOOR.graph, "In")
    found = [position.of(Action(0, 0, 0, state)) for state in range(12)]
    assert found == ["C", "C", "A", "A", "B", "B"] * 2
    assert position.of(Action(0, 0, 0)) is None
    assert position.likely() == ()


def test_states_that_tell_no_place_have_none():
    """Two places of three and a door are no factor over places: neither is a factor of one value's predicate."""
    states = [mdm.StateFactor("what", ["A", "B", "Door"])]
    position = Position(ensemble(states), FLOOR.graph, "")
    assert position.of(Action(0, 0, 0, 1)) is None


def observed(belief):
    """Return a robot whose states are a door and a place, and what it believes of them."""
    states = Space([Factor("door", ["open", "shut"]), Factor("position", list("BAC"))])
    model = mdm.models.POMDP(
        [np.eye(6)] * 2,
        [np.full((6, 2), 0.5)] * 2,
        np.zeros((6, 2)),
        discount=0.9,
        states=states,
        actions=["Right", "Left"],
        initial_belief=belief,
    )
    floor, predicates = row_of_rooms("A", "B", "C"), mdm.PredicateManager()
    places = Places(floor, predicates)
    policy = mdm.policies.AlphaVectors(np.zeros((2, 6)), [0, 1])
    navigation = Navigation(floor, Nowhere(), places)
    return mdm.Ensemble("robot", policy=policy, model=model, predicates=predicates, actions=navigation.actions())


class Nowhere:
    async def go(self, goal): ...


def test_a_belief_tells_the_likeliest_places():
    robot = observed([0.1, 0.2, 0.0, 0.3, 0.4, 0.0])
    assert Position(robot, FLOOR.graph, "").likely() == ("A", "B")


def test_a_way_of_a_belief_begins_at_the_likeliest_place_that_has_one():
    """`Left` leads nowhere from A, which is a little likelier than B."""
    robot = observed([0.1, 0.2, 0.0, 0.3, 0.4, 0.0])
    navigation = Navigation(FLOOR, Nowhere(), robot.predicates)
    position = Position(robot, FLOOR.graph, "")
    for label, source, target in (("Right", "A", "B"), ("Left", "B", "A")):
        node, heading = navigation.resolve(label, Action(0, 0, 0), position)
        assert (heading.source, heading.target, node.name) == (source, target, target)
        assert heading.why == f"{label} from {source}, believed in"


@pytest.mark.parametrize("seed", [*range(8), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(8, 24))])
def test_a_robot_goes_on_whatever_disturbs_it(seed):
    """Random floors, rates and noise; it is pushed, stopped, loses its poses, and finds goals blocked."""
    outcome = patrols.run(seed)
    assert outcome.goes_on, f"{outcome} of {patrols.Case(seed)}"


@pytest.mark.parametrize("seed", [103, 111])
def test_a_robot_that_decides_nothing_after_a_failure_is_found(seed):
    assert not patrols.run(seed, then="wait").goes_on
    assert patrols.run(seed).goes_on


def as_it_was(monkeypatch):
    """Resolve ways from where the predicates have the robot, whatever was decided on."""
    monkeypatch.setattr(Position, "of", lambda position, action: None)


def without_nearest(monkeypatch):
    """Let no place count as reached before the robot was at a goal."""
    reached_at = Places._reached_at

    def none_yet(self, at, room, pose):
        return reached_at(self, at, room, pose) if at or self._reached is not None else None

    monkeypatch.setattr(Places, "_reached_at", none_yet)


def without_an_end(monkeypatch):
    """Never finish the way to a place from which none has the label."""
    monkeypatch.setattr(Navigation, "_is_at", lambda navigation, place: None)


@pytest.mark.parametrize(
    ("plant", "seeds"), [(as_it_was, (14, 21)), (without_nearest, (1, 10)), (without_an_end, (1, 10))]
)
def test_planted_faults_are_found(monkeypatch, plant, seeds):
    plant(monkeypatch)
    assert not any(patrols.run(seed).goes_on for seed in seeds)
