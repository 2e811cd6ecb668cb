"""Cooperative box pushing: two agents, two small boxes, and a large one that takes both."""

from __future__ import annotations

from itertools import product

import numpy as np

from mdm.models import POMDP
from mdm.problems.parameters import agents, checked

_HEADINGS = "NESW"
_STEPS = {"N": 0, "E": 1, "S": 0, "W": -1}
_TURN_LEFT, _TURN_RIGHT, _FORWARD, _STAY = range(4)
_SEEN = ["emptyField", "wall", "otherAgent", "smallBox", "largeBox"]
_DONE = ["leftBoxAtGoal", "rightBoxAtGoal", "bothSmallAtGoal", "largeBoxAtGoal"]
_PLACES = range(1, 5)
_SMALL = (1, 4)

_Pose = tuple[int, str]
_Poses = tuple[_Pose, _Pose]


@checked
def box_pushing(success: float = 0.9, *, discount: float = 1.0) -> POMDP:
    """Return the problem of two agents below three boxes, which they are to push upwards.

    The agents stand at two of four places in a row, each with a heading. Above the outer places stand small boxes,
    above the two in the middle a large one, which moves only if both push at once. A step costs each agent 0.1, and 5
    where it pushes against a wall, the other agent or, alone, the large box; a small box pays 10, the large one 100. As
    soon as a box has been pushed, everything starts again. An agent sees what is in front of it.

    100 states (``s2N3W``: the left agent at place 2 looks north, the right one at place 3 west), 4 x 4 actions, 5 x 5
    observations. Optimal values of decentralised plans: 17.6 for 2 decisions, 66.081 for 3, 98.59361 for 4.

    Source: S. Seuken and S. Zilberstein, *Improved memory-bounded dynamic programming for decentralized POMDPs*, UAI
    2007, section 5. Values: F. A. Oliehoek, M. T. J. Spaan, C. Amato and S. Whiteson, *Incremental clustering and
    expansion for faster optimal planning in Dec-POMDPs*, JAIR 46, 2013. In the MADP toolbox' file one entry differs:
    there the right agent ends up looking south where it steps from ``s2E4W`` to the west.

    Args:
        success: The probability that a turn or a step does what it is meant to.
        discount: In (0, 1].
    """
    poses = [
        ((left, first), (right, second))
        for left, first, right, second in product(_PLACES, _HEADINGS, _PLACES, _HEADINGS)
        if left < right
    ]
    names = [*_DONE, *map(_name, poses)]
    index = {name: number for number, name in enumerate(names)}
    start = index["s1E4W"]
    transitions, rewards = [], np.zeros((len(names), 16))
    for joint, actions in enumerate(product(range(4), repeat=2)):
        transition = np.zeros((len(names), len(names)))
        transition[: len(_DONE), start] = 1
        for state, pair in enumerate(poses, len(_DONE)):
            rewards[state, joint] = _reward(pair, actions)
            for succeeded in product((True, False), repeat=2):
                probability = np.prod([success if each else 1 - success for each in succeeded])
                transition[state, index[_after(pair, actions, succeeded)]] += probability
        transitions.append(transition)
    observations = np.zeros((len(names), 5, 5))
    observations[: len(_DONE), 0, 0] = 1
    for state, pair in enumerate(poses, len(_DONE)):
        seen = (_SEEN.index(_in_front(pair, agent)) for agent in range(2))
        observations[(state, *seen)] = 1
    return POMDP(
        transitions,
        [observations.reshape(-1, 25)] * 16,
        rewards,
        discount=discount,
        states=names,
        actions=agents(["turnLeft", "turnRight", "moveForward", "stay"]),
        observation_names=agents(_SEEN),
        initial_belief=np.eye(len(names))[start],
    )


def _name(pair: _Poses) -> str:
    return "s" + "".join(f"{place}{heading}" for place, heading in pair)


def _in_front(pair: _Poses, agent: int) -> str:
    """Return the sight in front of an agent."""
    place, heading = pair[agent]
    if heading == "N":
        return "smallBox" if place in _SMALL else "largeBox"
    ahead = place + _STEPS[heading]
    if ahead == pair[1 - agent][0]:
        return "otherAgent"
    return "emptyField" if heading != "S" and ahead in _PLACES else "wall"


def _intended(pair: _Poses, agent: int, action: int) -> _Pose:
    """Return where an agent is after an action that succeeds, boxes and the other agent's actions apart."""
    place, heading = pair[agent]
    if action == _FORWARD:
        return (place + _STEPS[heading], heading) if _in_front(pair, agent) == "emptyField" else (place, heading)
    turn = {_TURN_LEFT: -1, _TURN_RIGHT: 1, _STAY: 0}[action]
    return place, _HEADINGS[(_HEADINGS.index(heading) + turn) % 4]


def _after(pair: _Poses, actions: tuple[int, ...], succeeded: tuple[bool, ...]) -> str:
    """Return the state that two actions lead to, each of which succeeds or does nothing."""
    if all(succeeded) and _push_the_large_box(pair, actions):
        return "largeBoxAtGoal"
    pushed = [
        pair[agent][0]
        for agent in range(2)
        if succeeded[agent] and actions[agent] == _FORWARD and _in_front(pair, agent) == "smallBox"
    ]
    if pushed:
        return "bothSmallAtGoal" if len(pushed) == 2 else "leftBoxAtGoal" if pushed == [1] else "rightBoxAtGoal"
    left, right = (_intended(pair, agent, actions[agent]) if succeeded[agent] else pair[agent] for agent in range(2))
    return _name(pair if left[0] == right[0] else (left, right))


def _reward(pair: _Poses, actions: tuple[int, ...]) -> float:
    """Return the reward of two actions, whether they succeed or not."""
    if _push_the_large_box(pair, actions):
        return 100 - 0.2
    worth = {"smallBox": 10.0, "emptyField": 0.0}
    left, right = (_intended(pair, agent, actions[agent]) for agent in range(2))
    if left[0] == right[0]:  # they run into each other
        return -10 - 0.2
    return -0.2 + sum(worth.get(_in_front(pair, agent), -5.0) for agent in range(2) if actions[agent] == _FORWARD)


def _push_the_large_box(pair: _Poses, actions: tuple[int, ...]) -> bool:
    return actions == (_FORWARD, _FORWARD) and pair == ((2, "N"), (3, "N"))
