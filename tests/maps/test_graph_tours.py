"""Tours, against all orders there are; and a robot that comes to every room by one."""

from __future__ import annotations

import asyncio
import itertools
import math
import random

import pytest
from drives import Robot
from rows_of_rooms import row_of_rooms
from sentences import refused

import mdm
from mdm.errors import MapError
from mdm.maps import Edge, Graph, Map, Navigation, Node, Pose
from mdm.maps.graph import tour
from mdm.maps.model import model, visits
from mdm.testing import probe, run_virtual


def shortest(lengths, size):
    """Return the length of the shortest closed tour, by trying all orders."""
    orders = ((0, *rest) for rest in itertools.permutations(range(1, size)))
    return min(sum(lengths[one, other] for one, other in itertools.pairwise((*order, 0))) for order in orders)


def distances(size, ways):
    """Return the length of the shortest way from each to each, by the plainest relaxation."""
    far = {(one, other): 0.0 if one == other else math.inf for one in range(size) for other in range(size)}
    for _ in range(size):
        for (one, other), length in ways.items():
            for start in range(size):
                far[start, other] = min(far[start, other], far[start, one] + length)
    return far


@pytest.mark.parametrize("directed", [False, True])
def test_tours_of_a_few_places_are_the_shortest(directed):
    drawn = random.Random(3)
    for _ in range(25):
        size = drawn.randint(2, 7)
        names = [f"p{index}" for index in range(size)]
        ring = [(index, (index + 1) % size) for index in range(size)]
        more = [(drawn.randrange(size), drawn.randrange(size)) for _ in range(size)]
        pairs = ring + [pair for pair in more if pair[0] != pair[1]]
        if not directed:
            pairs += [(other, one) for one, other in pairs]
        ways = {pair: drawn.uniform(1.0, 9.0) for pair in pairs}
        graph = Graph(
            tuple(Node(name, Pose(float(index), 0.0)) for index, name in enumerate(names)),
            tuple(Edge(names[one], names[other], f"to {names[other]}") for one, other in ways),
        )
        lengths = {(names[one], names[other]): length for (one, other), length in ways.items()}
        order = tour(graph, lengths=lengths)
        assert order[0] == "p0"
        assert sorted(order) == names
        far = distances(size, ways)
        cells = [names.index(name) for name in order]
        length = sum(far[one, other] for one, other in itertools.pairwise((*cells, cells[0])))
        assert length == pytest.approx(shortest(far, size))


def test_tours_of_many_places_go_round():
    """The shortest tour of places on a circle is known."""
    drawn = random.Random(5)
    angles = drawn.sample(range(24), 24)
    nodes = tuple(
        Node(f"p{turn}", Pose(math.cos(turn * math.pi / 12), math.sin(turn * math.pi / 12))) for turn in angles
    )
    edges = [Edge(one.name, other.name, f"to {other.name}") for one, other in itertools.permutations(nodes, 2)]
    order = [int(name[1:]) for name in tour(Graph(nodes, tuple(edges)))]
    steps = {(other - one) % 24 for one, other in itertools.pairwise((*order, order[0]))}
    assert steps in ({1}, {23})


@pytest.mark.parametrize(
    ("places", "message"),
    [
        (["A", "A"], "comes to 'A' twice"),
        (["A"], "a tour takes two places or more"),
        ([], "a tour takes two places or more"),
        (["A", "Z"], "there is no place 'Z'"),
        (["A", "C"], "no ways lead from 'C' to 'A': a tour comes to both again and again"),
    ],
)
def test_tours_that_cannot_be_are_refused(places, message):
    floor = row_of_rooms("A", "B", "C")
    edges = tuple(edge for edge in floor.graph.edges if (edge.source, edge.target) != ("C", "B"))
    with pytest.raises(MapError, match=message):
        tour(Graph(floor.graph.nodes, edges), places)


def test_a_floor_of_one_place_says_what_to_add():
    graph = Graph((Node("Hall", Pose(1.0, 1.0)),), ())
    with refused(MapError):
        tour(graph)


@pytest.mark.parametrize("drive", [None, 0.7])
@pytest.mark.parametrize("start", [2.0, 11.0, 16.0])
def test_a_robot_that_is_to_visit_all_rooms_comes_to_each_of_them_again_and_again(start, drive):
    """A policy that a solver finds, with the tour in the model, on a robot whose places tell the same."""
    floor = row_of_rooms("A", "B", "C", "D", "E")
    graph = Graph(floor.graph.nodes, (*floor.graph.edges, Edge("A", "C", "Skip"), Edge("C", "A", "Skip")))
    floor, order = Map(floor.labels, graph), tour(graph)
    made = model(graph, factors=[visits(graph, order)])
    policy = mdm.solve(made).policy

    async def main(runtime):
        predicates = mdm.PredicateManager()
        robot = Robot(floor, predicates, start, 2.0, speed=1.0, tour=order)
        ensemble = mdm.Ensemble(
            "robot",
            policy=policy,
            model=made,
            predicates=predicates,
            states=[
                mdm.StateFactor("position", {name: f"{name}.reached" for name in graph.names}),
                mdm.StateFactor("next", {name: f"{name}.next" for name in order}),
            ],
            actions=Navigation(floor, robot, robot.places).actions(),
            **({} if drive is None else {"drive": mdm.FixedRate(drive)}),
        )
        await runtime.start(robot.places)
        await runtime.start(ensemble)
        living = asyncio.create_task(robot.live())
        told = probe(predicates.events)
        await asyncio.sleep(200)
        living.cancel()
        robot.goal = None
        arrived = [event.split(".")[0] for update in told for event in update.events if event.endswith(".arrived")]
        assert all(arrived.count(name) >= 5 for name in graph.names), arrived
        assert ensemble.action.ended.get("failed", 0) == 0

    run_virtual(main)
