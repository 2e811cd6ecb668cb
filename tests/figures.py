"""What other programs computed for the standard problems: figures in ``tests/data/madp``, each with its origin.

In steps, ``a`` and ``o`` are indices of joint actions and observations, ``eta`` is P(o | b, a), and ``b`` the belief
after it, by the states that are not 0.
"""

from __future__ import annotations

import json
from functools import cache

import numpy as np
from places import DATA

from mdm import problems
from mdm.policies import AlphaVectors, FiniteStateController

COMPUTED = (
    "dec_tiger",
    "broadcast_channel",
    "grid_small",
    "recycling_robots",
    "relay",
    "fire_fighting_graph",
    "patrol",
)
"""The problems there are figures for."""


@cache
def of(problem):
    return json.loads((DATA / "madp" / f"{problem}.json").read_text())


@cache
def model(problem, discount=None):
    found = getattr(problems, problem)()
    return found if discount is None else found.with_discount(discount)


def exactness(problem):
    """Return how near its figures are: those of the patrol are of probabilities with six digits."""
    return 2e-6 if problem == "patrol" else 1e-9


def belief(entries, size):
    """Return a belief as an array."""
    array = np.zeros(size)
    for state, probability in entries.items():
        array[int(state)] = probability
    return array


def vectors(problem, discount):
    """Return the value function that MADP's Perseus found, without the vectors that decide nowhere."""
    rows = of(problem)["values"][str(discount)]["vectors"]
    actions, values = zip(*rows, strict=True)
    return AlphaVectors(values, actions, len(model(problem).action_space))


def recorded(problem):
    """Return a run of the original's controller: its first decision, the observations, and the decisions after each.

    A decision is an action, its epoch, the expected reward, and the belief, which the first does not tell.
    """
    run, size = of(problem)["recorded"], len(model(problem).state_space)
    steps = [
        (step["o"], [(d["a"], d["epoch"], d["r"], belief(d["b"], size)) for d in step["decisions"]])
        for step in run["steps"]
    ]
    return tuple(run["start"]), steps, run.get("horizon")


def tiger_plan():
    """Return the optimal plan for the tiger problem, as pomdp-solve found it; node n's values are its n-th vector."""
    nodes = json.loads((DATA / "tiger_plan.json").read_text())["nodes"]
    actions, successors = ([node[key] for node in nodes] for key in ("action", "next"))
    return FiniteStateController(actions, successors, 3, values=[node["values"] for node in nodes])
