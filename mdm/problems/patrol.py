"""An event-driven patrol, in which robots may fail to detect events."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ModelError
from mdm.models import Factor, FactoredPOMDP, Node, Space, Table, Tree, TwoSliceNetwork
from mdm.problems.parameters import checked

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models.matrices import Vector

    Indices = npt.NDArray[np.intp]

_MOVES = ("Move Down", "Move Right", "Move Up", "Move Left")
_ACTIONS = (*_MOVES, "Catch Goose", "Spawn Goose")
_DOWN, _RIGHT, _UP, _LEFT, _CATCH, _SPAWN = range(len(_ACTIONS))
_BACK = {_DOWN: _UP, _UP: _DOWN, _LEFT: _RIGHT, _RIGHT: _LEFT}

_ROOMS = ("Elevator Hallway", "Corridor-West", "Coffee Room", "Corridor-South", "LRM", "Soccer Field")
_DOORS = ((1, _DOWN, 0), (1, _LEFT, 3), (2, _DOWN, 3), (3, _DOWN, 4), (5, _LEFT, 4))
"""Of the office floor: from which room, by which move, to which."""

_PHASES = 3
_MISSED = 0.9


@checked
def patrol(rooms: int = 6, robots: int = 1, *, discount: float = 0.9) -> FactoredPOMDP:
    """Return the problem of robots that look for a goose in a building, and decide at events.

    A move ends at once in the next room with probability 0.5. Otherwise a phase passes in which the robot is still on
    its way and most probably detects nothing (``False Negative``), then another at whose end it arrives. In a room a
    robot sees whether the goose is there; on its way, seldom, that some room is clear. Catching the goose where it is
    pays 10 and elsewhere costs 5; spawning one pays 10 where there is none and costs 5 otherwise; after either it is
    anywhere or gone. A move costs 0.5.

    Observations are events; ``patrol().with_false_negatives("False Negative")`` is the model of robots that decide
    nothing where they detect nothing. The state has the room and the phase of each robot, and last the goose's room.
    126 states, 6 actions and 8 observations with 6 rooms and a robot.

    Source: the patrol of the MAIS+S project, ``MAISS_Patrol_Single.pgmx`` of the MADP toolbox; J. V. Messias,
    *Decision-making under uncertainty for real robot teams*, PhD thesis, Instituto Superior Técnico, 2014. That file
    rounds 1/60 to six digits.

    Args:
        rooms: With 6, the office floor of that project; otherwise rooms in a row, from left to right.
        robots: How many robots there are. They move independently, and any of them may find the goose.
        discount: In (0, 1].

    Raises:
        ModelError: If there are less than 2 rooms, or no robot.
    """
    if rooms < 2 or robots < 1:
        raise ModelError(f"a patrol needs 2 rooms and a robot at least, not {rooms} and {robots}")
    names = _ROOMS if rooms == len(_ROOMS) else [f"Room {number}" for number in range(1, rooms + 1)]
    doors = _DOORS if rooms == len(_ROOMS) else [(room, _LEFT, room - 1) for room in range(1, rooms)]
    leads = np.tile(np.arange(rooms), (len(_ACTIONS), 1))  # actions x rooms
    for start, move, end in doors:
        leads[move, start], leads[_BACK[move], end] = end, start
    of = [f" {robot}" if robots > 1 else "" for robot in range(1, robots + 1)]
    factors, initial, transitions, observation, utilities = [], [], [], [], []
    goose, goose_later = Node("state", 2 * robots), Node("next_state", 2 * robots)
    # Where a robot is next: actions x rooms x phases x rooms; what it earns: actions x rooms x places of the goose.
    stays, arrives = np.eye(rooms), np.eye(rooms)[leads]
    arrivals = np.stack([(stays + arrives) / 2, np.broadcast_to(stays, arrives.shape), arrives], axis=2)
    rewards = np.full((len(_ACTIONS), rooms, rooms + 1), -0.5)
    rewards[_CATCH] = np.where(np.eye(rooms, rooms + 1, k=1), 10, -5)
    rewards[_SPAWN] = np.where(np.eye(1, rooms + 1), 10, -5)
    for robot, number in enumerate(of):
        room, phase, action = Node("state", 2 * robot), Node("state", 2 * robot + 1), Node("action", robot)
        room_later, phase_later = Node("next_state", 2 * robot), Node("next_state", 2 * robot + 1)
        factors.append(Factor(f"Robot{number} Position", names))
        factors.append(Factor(f"Phase{number}", [f"Phase {number}" for number in range(_PHASES)]))
        initial += [Table([room], np.full(rooms, 1 / rooms)), Table([phase], np.eye(_PHASES)[0])]
        transitions.append(Table([action, room, phase, room_later], arrivals))
        transitions.append(Table([action, room, phase, room_later, phase_later], _phases(leads)))
        observation.append(Table([room_later, goose_later, phase_later, Node("observation", robot)], _seen(rooms)))
        utilities.append(Table([action, room, goose], rewards))
    factors.append(Factor("Goose Position", ["No Goose", *names]))
    anywhere = Table([goose_later], np.full(rooms + 1, 1 / (rooms + 1)))
    elsewhere: Table | Tree = Table([goose, goose_later], np.eye(rooms + 1))
    for robot in range(robots):
        elsewhere = Tree(Node("action", robot), [0] * len(_MOVES) + [1, 1], [elsewhere, anywhere])
    initial.append(Table([goose], np.full(rooms + 1, 1 / (rooms + 1))))
    symbols = ["False Negative", *(f"{name} Clear" for name in names), "Found Goose"]
    network = TwoSliceNetwork(
        Space(factors),
        Space(Factor(f"Action{number}", _ACTIONS) for number in of),
        Space(Factor(f"Observation{number}", symbols) for number in of),
        initial=initial,
        transitions=[*transitions, elsewhere],
        observation=observation,
        utilities=utilities,
        event_observations=True,
    )
    return FactoredPOMDP(network, discount=discount)


def _phases(leads: Indices) -> Vector:
    """Return a robot's next phase: actions x rooms x phases x rooms at the next step x phases."""
    actions, rooms = leads.shape
    values = np.zeros((actions, rooms, _PHASES, rooms, _PHASES))
    values[..., 0] = 1
    for action, room in zip(*np.nonzero(leads != np.arange(rooms)), strict=True):
        values[action, room, :, room] = np.roll(np.eye(_PHASES), 1, axis=1)  # still on its way
    return values


def _seen(rooms: int) -> Vector:
    """Return a robot's detections: rooms x places of the goose x phases x observations."""
    values = np.zeros((rooms, rooms + 1, _PHASES, rooms + 2))
    for room, goose in np.ndindex(rooms, rooms + 1):
        found = goose == room + 1
        values[room, goose, 0, -1 if found else room + 1] = 1
        clear = np.arange(1, rooms + 1) != goose
        values[room, goose, 1:, 0] = _MISSED
        values[room, goose, 1:, 1:-1] = (1 - _MISSED) * clear / clear.sum()
    return values
