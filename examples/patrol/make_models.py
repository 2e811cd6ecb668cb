"""Write the demo's models as two-slice networks, one of them from the floor's graph, and policies for them.

The files are part of the example; run this again after changing a number: ``python make_models.py``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import mdm
from mdm.maps import load_graph
from mdm.maps.model import latch, model

HERE = Path(__file__).parent
DISCOUNT_TOP, DISCOUNT_PATROL = 0.9, 0.95

TASKS = ("Patrol", "Assistance", "Trespassing", "Emergency")
TROUBLES = {
    # what: chance to arise, what ends it (four times out of five), what it costs
    "person": (0.08, "Assistance", 2.0),
    "intruder": (0.04, "Trespassing", 5.0),
    "fire": (0.03, "Emergency", 20.0),
}
ENDS = 0.8
PATROLLING = 1.0

ARRIVES = 0.9  # of all drives, the rest end where they began


def top(goes_out: float = 0.0) -> mdm.models.FactoredMDP:
    """Return what the robot attends to: three troubles that come by themselves and go when attended to.

    Args:
        goes_out: The chance that a fire that nobody fights goes out; 0 in the building.
    """
    tasks = mdm.models.Node("action", 0)
    initial, transitions, utilities = [], [], [mdm.models.Table([tasks], [PATROLLING, 0, 0, 0])]
    for place, (trouble, (chance, task, cost)) in enumerate(TROUBLES.items()):
        now, later = mdm.models.Node("state", place), mdm.models.Node("next_state", place)
        initial.append(mdm.models.Table([now], [0.5, 0.5]))
        goes = goes_out if trouble == "fire" else 0.0
        arises = mdm.models.Table([now, later], [[1 - chance, chance], [goes, 1 - goes]])
        attended = mdm.models.Table([now, later], [[1 - chance, chance], [ENDS, 1 - ENDS]])
        transitions.append(mdm.models.Tree(tasks, [int(name == task) for name in TASKS], [arises, attended]))
        utilities.append(mdm.models.Table([now], [0, -cost]))
    states = mdm.models.Space(mdm.models.Factor(name, ["no", "yes"]) for name in TROUBLES)
    network = mdm.models.TwoSliceNetwork(
        states,
        mdm.models.Space.single("robot", TASKS),
        initial=initial,
        transitions=transitions,
        utilities=utilities,
    )
    return mdm.models.FactoredMDP(network, discount=DISCOUNT_TOP)


def patrol() -> mdm.models.FactoredMDP:
    """Return where the robot is, and whether half of its round is done; each half earns 1."""
    graph = load_graph(HERE / "floor.xml")
    halfway = latch(graph, "halfway", on="ElevatorHallway", off="SoccerField")
    return model(graph, factors=[halfway], success=ARRIVES, discount=DISCOUNT_PATROL, start="ElevatorHallway")


def solve_mdp(model: mdm.models.MDP, sweeps: int = 500) -> list[int]:
    """Return the best action in each state, by value iteration."""
    value = np.zeros(len(model.state_space))
    transitions = np.stack([model.transition_matrix(a) for a in range(len(model.action_space))])
    for _ in range(sweeps):
        values = model.rewards + model.discount * (transitions @ value).T
        value = values.max(axis=1)
    return [int(action) for action in values.argmax(axis=1)]


if __name__ == "__main__":
    for name, made in (("top.pomdpx", top()), ("patrol.npz", patrol())):
        mdm.save_model(made, HERE / name)
        best = mdm.policies.DeterministicPolicy(solve_mdp(made), len(made.action_space))
        mdm.save_policy(best, (HERE / name).with_suffix(".policy"))
        print(f"{name}: {best.actions}")
