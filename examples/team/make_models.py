"""Write the models of the examples, and policies for them.

The files are part of the examples; run this again after changing a number: ``python make_models.py``.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

import mdm
from mdm.models import MDP, POMDP, Factor, Space

HERE = Path(__file__).parent

ROOMS = ("West", "Hall", "East")
MOVES = {"GoWest": -1, "Stay": 0, "GoEast": 1}
MOVED = 0.9  # of all moves; the rest end where they began
RECOGNISED = 0.8  # how often a robot takes a room for the one that it is
NEWS = 0.05  # chance at each step that Ada finds what Bob has to know
PATROLLING, WAITING = 1.0, -2.0  # while the robots are in both wings; while the news waits

CARRIERS = ("a", "b", "c", "d")
ARRIVES = (0.2, 0.2, 0.1, 0.1)  # chance that an empty carrier is loaded
COSTS = (1.0, 2.0, 3.0, 4.0)  # of a load that waits


def moved(room: int, move: int) -> dict[int, float]:
    """Return where a robot may be after a move, with probabilities."""
    to = min(max(room + move, 0), len(ROOMS) - 1)
    return {room: 1.0} if to == room else {to: MOVED, room: 1 - MOVED}


def meeting() -> POMDP:
    """Return the task of two robots: to patrol both wings, and to meet in the hall when there is news."""
    states = Space([Factor("ada", ROOMS), Factor("bob", ROOMS), Factor("news", ["no", "yes"])])
    actions = Space([Factor("ada", list(MOVES)), Factor("bob", list(MOVES))])
    seen = Space([Factor("ada", [*ROOMS, "News"]), Factor("bob", ROOMS)])
    transitions = np.zeros((len(actions), len(states), len(states)))
    observations = np.zeros((len(actions), len(states), len(seen)))
    rewards = np.zeros((len(states), len(actions)))
    for state, (ada, bob, news) in enumerate(itertools.product(range(3), range(3), range(2))):
        for action, (first, second) in enumerate(itertools.product(MOVES.values(), MOVES.values())):
            for (a, p), (b, q) in itertools.product(moved(ada, first).items(), moved(bob, second).items()):
                together = a == b == ROOMS.index("Hall")
                waits = 0.0 if together else 1.0 if news else NEWS
                for after, chance in ((0, 1 - waits), (1, waits)):
                    transitions[action, state, states.ravel((a, b, after))] += p * q * chance
            for symbol, (x, y) in enumerate(itertools.product(range(4), range(3))):
                observations[action, state, symbol] = recognised(ada, x, news=bool(news)) * recognised(bob, y)
        rewards[state] = PATROLLING * (abs(ada - bob) == 2) + WAITING * news
    return POMDP(
        transitions,
        observations,
        rewards,
        discount=0.9,
        states=states,
        actions=actions,
        observation_names=seen,
        initial_belief=np.eye(len(states))[states.ravel((0, 2, 0))],
    )


def recognised(room: int, symbol: int, *, news: bool = False) -> float:
    """Return the probability that a robot in a room sees this; Ada's news hides where she is every other time."""
    if symbol == len(ROOMS):
        return 0.5 if news else 0.0
    chance = RECOGNISED if symbol == room else (1 - RECOGNISED) / 2
    return 0.5 * chance if news else chance


def unloading() -> MDP:
    """Return the task of four carriers at one dock: who unloads, where each load that waits costs something else."""
    states = Space(Factor(name, ["empty", "loaded"]) for name in CARRIERS)
    actions = Space(Factor(name, ["Wait", "Unload"]) for name in CARRIERS)
    transitions = np.ones((len(actions), len(states), len(states)))
    rewards = np.zeros((len(states), len(actions)))
    for action, state in itertools.product(range(len(actions)), range(len(states))):
        unloads, loaded = actions.unravel(action), states.unravel(state)
        blocked = sum(unloads) > 1
        for after in range(len(states)):
            for place, later in enumerate(states.unravel(after)):
                empty = 1.0 - ARRIVES[place] if not loaded[place] else float(bool(unloads[place]) and not blocked)
                transitions[action, state, after] *= empty if later == 0 else 1 - empty
        rewards[state, action] = -np.dot(loaded, COSTS) - 0.5 * sum(unloads)
    return MDP(transitions, rewards, discount=0.9, states=states, actions=actions)


def main() -> None:
    """Write the files."""
    for name, model, suffix in (("meeting", meeting(), "vf"), ("unloading", unloading(), "policy")):
        mdm.save_model(model, HERE / f"{name}.npz")
        solution = mdm.solve(model, gap=0.3, time=120)
        mdm.save_policy(solution.policy, HERE / f"{name}.{suffix}")
        print(f"{name}: {len(model.state_space)} states, value between {solution.lower:.2f} and {solution.upper:.2f}")


if __name__ == "__main__":
    main()
