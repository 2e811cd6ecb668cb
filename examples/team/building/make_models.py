"""Write the model of two robots that share the patrol of a floor, and the best policy.

The files are part of the example; run this again after changing a number: ``python make_models.py``.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

import mdm
from mdm.maps import Edge, Graph, load_graph
from mdm.maps.model import model as floor_model
from mdm.models import Factor, FactoredMDP, Node, Space, Table, TwoSliceNetwork

HERE = Path(__file__).parent
FLOOR = HERE.parent.parent / "patrol" / "floor.xml"
ROUNDS = {"field": ("LRM", "SoccerField"), "hallway": ("CoffeeRoom", "ElevatorHallway")}
COMES = 0.9  # of all drives to the next room; the rest end where they began
TOGETHER = -2.0  # for each step that ends with both robots in one room


def building() -> FactoredMDP:
    """Return the task of two robots that share a patrol: at both ends of a floor, to be in one room and then the other.

    Each end is a factor: whether somebody has been in the second of its rooms since somebody was in the first. Whoever
    changes that earns 1.
    """
    graph = load_graph(FLOOR)
    # An action is called by the room that it leads to: it leads there, too, when it is chosen again in mid-way.
    ways = Graph(graph.nodes, [Edge(edge.source, edge.target, edge.target) for edge in graph.edges])
    one = floor_model(ways, success=COMES, stay="Stay", idle_cost=1.0)  # drives that skip rooms are not worth it
    rooms, drives = graph.names, one.action_space.names
    moves = np.stack([one.transition_matrix(action) for action in range(len(drives))])
    drive, here, there = ([Node(what, robot) for robot in range(2)] for what in ("action", "state", "next_state"))
    initial = [Table([room], np.full(len(rooms), 1 / len(rooms))) for room in here]
    transitions = [Table([*nodes], moves) for nodes in zip(drive, here, there, strict=True)]
    utilities = [Table([*nodes], one.rewards.T) for nodes in zip(drive, here, strict=True)]
    utilities.append(Table([*drive, *here], TOGETHER * np.einsum("apx,bqx->abpq", moves, moves)))
    for factor, ends in enumerate(ROUNDS.values(), 2):
        now, later = Node("state", factor), Node("next_state", factor)
        change = np.tile(np.eye(2), (len(rooms), len(rooms), 1, 1))  # next rooms x before x after
        for pair in itertools.product(range(len(rooms)), repeat=2):
            visited = [end in {rooms[index] for index in pair} for end in ends]
            if visited[0] != visited[1]:
                change[pair] = np.eye(2)[int(visited[1])]
        earned = np.einsum("apx,bqy,xyuv->abpqu", moves, moves, change * (1 - np.eye(2)))
        initial.append(Table([now], [1, 0]))
        transitions.append(Table([*there, now, later], change))
        utilities.append(Table([*drive, *here, now], earned))
    states = Space([Factor("ada", rooms), Factor("bob", rooms), *(Factor(name, ["no", "yes"]) for name in ROUNDS)])
    actions = Space([Factor("ada", drives), Factor("bob", drives)])
    network = TwoSliceNetwork(states, actions, initial=initial, transitions=transitions, utilities=utilities)
    return FactoredMDP(network, discount=0.95)


def main() -> None:
    """Write the files."""
    model = building()
    values = mdm.solve(model, gap=0.01, time=60).policy.values
    best = mdm.policies.DeterministicPolicy(values.argmax(axis=1), len(model.action_space))  # a number for each state
    mdm.save_model(model, HERE / "building.npz")
    mdm.save_policy(best, HERE / "building.policy")
    print(f"building: {len(model.state_space)} states, {len(model.action_space)} joint actions")


if __name__ == "__main__":
    main()
