"""Small POMDPs with a danger, a goal, and a policy that is drawn into the danger: solved as if there were none."""

from __future__ import annotations

import mdm

STEPS = {"north": (0, -1), "east": (1, 0), "south": (0, 1), "west": (-1, 0)}


def moved(cell, action, width, height):
    return tuple(
        min(max(place + by, 0), size - 1) for place, by, size in zip(cell, STEPS[action], (width, height), strict=True)
    )


def _on_grid(traps, goal, starts, sees, *, size=4, slip=0.1, trapped=0.0):
    """Return a grid with traps that stop a robot which does not see where it is, but what ``sees`` tells."""

    def transition(cell, action):
        if cell in traps or cell == goal:
            return {cell: 1.0}
        then, odds = moved(cell, action, size, size), {}
        odds[then] = 1 - slip
        odds[cell] = odds.get(cell, 0) + slip
        return odds

    def reward(cell, action):
        if cell in traps:
            return trapped
        return 0.0 if cell == goal else -1.0

    return mdm.POMDP.from_functions(
        [(x, y) for y in range(size) for x in range(size)],
        list(STEPS),
        sorted({sees(x, y) for x in range(size) for y in range(size)}),
        transition=transition,
        observation=lambda _, cell: {sees(*cell): 1.0},
        reward=reward,
        discount=0.95,
        initial={cell: 1 / len(starts) for cell in starts},
    )


def obstacles():
    """Traps beside the way; the south wall, traps and goal are felt. From S. Junges and others, CAV 2021, smaller."""
    traps, goal = {(1, 1), (3, 1)}, (3, 3)

    def sees(x, y):
        return "goal" if (x, y) == goal else "trap" if (x, y) in traps else "south" if y == 3 else "open"

    return _on_grid(traps, goal, [(0, 0), (0, 1), (0, 2)], sees)


def maze():
    """A corridor that looks the same at many places, with pits on the shortest way."""
    traps, goal = {(2, 0), (2, 1)}, (3, 0)

    def sees(x, y):
        return "goal" if (x, y) == goal else "open" if 0 < y < 3 and x < 3 else f"{x == 3} {y == 0} {y == 3}"

    return _on_grid(traps, goal, [(0, 0), (1, 0), (0, 1)], sees)


def refuel():
    """A line of cells with a station in the middle; moving takes fuel, and which cell it is shows at the station alone.

    Running empty away from the station is the danger. From S. Junges and others, CAV 2021, smaller.
    """
    length, station, tank = 6, 2, 4

    def transition(state, action):
        cell, fuel = state
        if cell == length - 1 or fuel == 0:
            return {state: 1.0}
        if action == "refuel":
            return {(cell, tank) if cell == station else (cell, fuel - 1): 1.0}
        return {(max(cell + (1 if action == "east" else -1), 0), fuel - 1): 1.0}

    def sees(state):
        cell, fuel = state
        where = "goal" if cell == length - 1 else "station" if cell == station else "road"
        return f"{where} {fuel}"

    states = [(cell, fuel) for cell in range(length) for fuel in range(tank + 1)]
    return mdm.POMDP.from_functions(
        states,
        ["west", "east", "refuel"],
        sorted({sees(each) for each in states}),
        transition=transition,
        observation=lambda _, state: {sees(state): 1.0},
        reward=lambda state, action: 0.0 if state[0] == length - 1 or not state[1] else -1.0 - (action == "refuel"),
        discount=0.95,
        initial={(0, tank): 0.5, (1, tank): 0.5},
    )


def tiger():
    """A tiger behind one of two doors; listening tells the truth or nothing, and opening a door ends the episode."""

    def transition(state, action):
        if state in {"free", "eaten"} or action == "listen":
            return {state: 1.0}
        return {"eaten" if state == f"tiger {action}" else "free": 1.0}

    def observation(action, state):
        return {state: 0.3, "nothing": 0.7} if action == "listen" else {"nothing": 1.0}

    return mdm.POMDP.from_functions(
        ["tiger left", "tiger right", "free", "eaten"],
        ["listen", "left", "right"],
        ["tiger left", "tiger right", "free", "eaten", "nothing"],
        transition=transition,
        observation=observation,
        reward=lambda state, action: 0.0 if state in {"free", "eaten"} else -1.0 if action == "listen" else -0.5,
        discount=0.95,
        initial={"tiger left": 0.6, "tiger right": 0.4},
    )


HIDDEN = {
    "obstacles": (obstacles, "1,1 or 3,1", "reach 3,3"),
    "maze": (maze, "2,0 or 2,1", "reach 3,0"),
    "refuel": (refuel, "*,0 and not 5,*", "reach 5,*"),
    "tiger": (tiger, "eaten", "reach free"),
}
"""Models with the danger and the goal of each."""
