"""How many steps a second policies over beliefs are simulated with: many episodes at once, against one at a time.

Against the loop that a user would write with numpy, and against mdm's own decision loop (`simulate`). All ways simulate
the same policy in the same model, so their means agree within their errors. Each takes its turn in each of some rounds;
the median counts.
"""

from __future__ import annotations

import statistics
import time
from typing import Any

import numpy as np
from measurement import arguments, report, table

import mdm

SIZES = ((2, 3, 2, 5), (20, 4, 5, 20), (100, 4, 5, 100), (400, 4, 5, 100))
"""States, actions, observations, vectors."""
STEPS = 50


def problem(
    states: int, actions: int, observations: int, vectors: int
) -> tuple[mdm.models.POMDP, mdm.policies.AlphaVectors]:
    """Return a random model and a policy for it."""
    random = np.random.default_rng(states)
    model = mdm.models.POMDP(
        random.dirichlet(np.full(states, 0.2), size=(actions, states)),
        random.dirichlet(np.ones(observations), size=(actions, states)),
        random.normal(size=(states, actions)),
        discount=0.95,
    )
    return model, mdm.policies.AlphaVectors(
        random.normal(size=(vectors, states)), random.integers(actions, size=vectors), actions
    )


def by_hand(model: mdm.models.POMDP, policy: mdm.policies.AlphaVectors, episodes: int) -> list[float]:
    """Return the returns of episodes, one after the other, as a user would write it."""
    random = np.random.default_rng(1)
    actions = range(len(model.action_space))
    moves = [model.transition_matrix(a) for a in actions]
    sights = [model.observation_matrix(a) for a in actions]
    vectors, of_vector = policy.vectors, policy.actions
    size, width = sights[0].shape
    returns = []
    for _ in range(episodes):
        state, belief, total, weight = random.choice(size, p=model.initial_belief), model.initial_belief, 0.0, 1.0
        for _ in range(STEPS):
            action = of_vector[int(np.argmax(vectors @ belief))]
            total += weight * model.rewards[state, action]
            weight *= model.discount
            state = random.choice(size, p=moves[action][state])
            seen = random.choice(width, p=sights[action][state])
            belief = (belief @ moves[action]) * sights[action][:, seen]
            belief = belief / belief.sum()
        returns.append(total)
    return returns


def measure(sizes: tuple[int, int, int, int], *, quick: bool) -> list[dict[str, Any]]:
    """Return a row for each way."""
    model, policy = problem(*sizes)
    many, few = (200, 5) if quick else (10_000, 100)
    ways = {
        "mdm.evaluate": (many, lambda: mdm.evaluate(model, policy, episodes=many, steps=STEPS, seed=1).returns),
        "mdm.simulate": (few, lambda: mdm.simulate(model, policy, episodes=few, steps=STEPS, seed=1).returns),
        "numpy, by hand": (few, lambda: by_hand(model, policy, few)),
    }
    speeds: dict[str, list[float]] = {way: [] for way in ways}
    means = {}
    for _ in range(1 if quick else 3):
        for way, (episodes, run) in ways.items():
            began = time.perf_counter()
            returns = run()
            speeds[way].append(episodes * STEPS / (time.perf_counter() - began))
            means[way] = float(np.mean(returns))
    first = statistics.median(speeds["numpy, by hand"])
    return [
        {
            "states": sizes[0],
            "vectors": sizes[3],
            "way": way,
            "steps a second": round(statistics.median(speeds[way])),
            "times by hand": statistics.median(speeds[way]) / first,
            "mean return": means[way],
        }
        for way in ways
    ]


def main() -> None:
    """Measure, show and write."""
    given = arguments(str(__doc__).splitlines()[0])
    rows = [row for sizes in (SIZES[:2] if given.quick else SIZES) for row in measure(sizes, quick=given.quick)]
    table("Steps a second of simulated episodes", rows)
    report("simulation", {"simulation": rows}, given.output)


if __name__ == "__main__":
    main()
