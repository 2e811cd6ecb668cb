"""Several floors as one map."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import mdm
from mdm.errors import MapError
from mdm.maps import Edge, Floors, Frame, Graph, Grid, Labels, Lift, Map, Navigation, Node, Places, Pose, check
from mdm.maps.graph import tour
from mdm.maps.map import place_of, rides
from mdm.maps.model import arrivals, model, sightings, visits
from mdm.testing import probe, run_virtual


def strip(names, edges=()):
    """Return a floor of rooms of 2 m side by side, without walls between them."""
    frame = Frame(8, 8 * len(names), 0.25)
    raster = np.repeat(np.arange(1, len(names) + 1, dtype=np.uint16), 8)[None, :].repeat(8, axis=0)
    free = np.ones(frame.shape, dtype=bool)
    nodes = tuple(Node(name, Pose(2.0 * index + 1.0, 1.0)) for index, name in enumerate(names))
    graph = Graph(nodes, tuple(Edge(one, other, f"to {other}") for one, other in edges))
    return Map(Labels(frame, raster, tuple(names)), graph, Grid(frame, free, ~free))


def both(*pairs):
    return [end for one, other in pairs for end in ((one, other), (other, one))]


GROUND, UPPER = strip(["hall", "shop"], both(("hall", "shop"))), strip(["hall"])


def test_places_have_the_name_of_their_floor_and_lifts_are_ways():
    floors = Floors({"ground": GROUND, "upper": UPPER}, (Lift("lift", ("ground.shop", "upper.hall"), 20.0),))
    graph = floors.graph
    assert graph.names == floors.names == ("ground.hall", "ground.shop", "upper.hall")
    assert graph.node("upper.hall").goal == Pose(1.0, 1.0, floor="upper")
    assert graph.target("ground.hall", "to shop") == "ground.shop"
    assert graph.way("ground.shop", "lift to upper") == Edge(
        "ground.shop", "upper.hall", "lift to upper", lift="lift", seconds=20.0
    )
    assert graph.target("upper.hall", "lift to ground") == "ground.shop"
    assert [(floor, labels.name(1.0, 1.0)) for floor, labels in floors.labels.items()] == [
        ("ground", "ground.hall"),
        ("upper", "upper.hall"),
    ]


def test_a_lift_of_many_stops_takes_longer_to_those_further_away():
    lift = Lift("a", ("x.p", "y.q", "z.r"), 5.0)
    assert {(way.source, way.label, way.target): way.seconds for way in lift.ways()} == {
        ("x.p", "a to y", "y.q"): 5.0,
        ("x.p", "a to z", "z.r"): 10.0,
        ("y.q", "a to x", "x.p"): 5.0,
        ("y.q", "a to z", "z.r"): 5.0,
        ("z.r", "a to x", "x.p"): 10.0,
        ("z.r", "a to y", "y.q"): 5.0,
    }
    assert [way.target for way in Lift("a", lift.stops, 5.0, one_way=True).ways()] == ["y.q", "z.r", "z.r"]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Lift("a", ("x.p",), 5.0), "'a' leads nowhere: name the places of two floors or more"),
        (lambda: Lift("a", ("x.p", "x.q"), 5.0), "'a' stops twice on the floor 'x'"),
        (lambda: Lift("a", ("p", "x.q"), 5.0), "'p' names no place of a floor: write the floor first"),
        (lambda: Lift("a", ("x.p", "y.q"), 0.0), "'a' takes 0.0 s: give seconds above 0"),
        (lambda: Lift("a", ("x.p", "y.q"), float("nan")), "'a' takes nan s"),
        (lambda: Floors({}), "there are no floors"),
        (lambda: Floors({"a.b": UPPER}), "a floor is called 'a.b'"),
        (lambda: Floors({"a": UPPER}, start="a.cellar"), "there is no place 'a.cellar'"),
        (lambda: Floors({"a": UPPER}, (Lift("l", ("a.hall", "b.hall"), 1.0),)), "no such floor; there are a"),
        (
            lambda: Floors({"a": UPPER, "b": UPPER}, (Lift("l", ("a.hall", "b.loft"), 1.0),)),
            "'l' stops at 'b.loft', and there is no such place; there are b.hall",
        ),
        (
            lambda: Floors({"a": UPPER, "b": UPPER}, 2 * (Lift("l", ("a.hall", "b.hall"), 1.0),)),
            "two lifts are called 'l'",
        ),
    ],
)
def test_what_makes_no_building_is_refused(make, words):
    with pytest.raises(MapError) as caught:
        make()
    assert words in str(caught.value)


def test_a_lift_stops_where_the_robot_fits_and_ways_lead():
    ground = strip(["hall", "shop", "shaft"], both(("hall", "shop")))
    floors = Floors({"ground": ground, "upper": UPPER}, (Lift("lift", ("ground.shaft", "upper.hall"), 20.0),))
    found = [(problem.kind, problem.floor, problem.text) for problem in check(floors, radius=0.2)]
    assert ("lifts", "ground", found[-2][2]) == found[-2]
    assert found[-2][2].startswith("'lift' stops at 'ground.shaft', and no way on the floor leads to that place")
    assert found[-1] == ("ways", "", "no ways join 'ground.shaft', 'upper.hall' with 'ground.hall'")
    assert found[0][:2] == ("ways", "ground")
    assert found[0][2].startswith("ground: 'shop' and 'shaft' touch by a passage")
    told = [problem.text for problem in check(floors, radius=1.2) if problem.kind == "lifts"]
    assert "'lift' stops at 'upper.hall', and a robot of 2.4 m cannot drive to its goal" in told


buildings = st.lists(
    st.integers(1, 4).flatmap(
        lambda size: st.tuples(
            st.just(size), st.lists(st.tuples(st.integers(0, size - 1), st.integers(0, size - 1)), max_size=6)
        )
    ),
    min_size=2,
    max_size=3,
)


@st.composite
def drawn(draw):
    """Return two or three floors with ways at random, and lifts, one-way or not."""
    plans = draw(buildings)
    maps = {
        f"floor{level}": strip([f"p{place}" for place in range(size)], {(f"p{a}", f"p{b}") for a, b in ways if a != b})
        for level, (size, ways) in enumerate(plans)
    }
    lifts = []
    for number in range(draw(st.integers(0, 3))):
        levels = draw(st.permutations(range(len(plans))))[: draw(st.integers(2, len(plans)))]
        stops = tuple(f"floor{level}.p{draw(st.integers(0, plans[level][0] - 1))}" for level in levels)
        lifts.append(Lift(f"l{number}", stops, draw(st.sampled_from([5.0, 20.0])), draw(st.booleans())))
    return Floors(maps, tuple(lifts))


def reachable(floors, start):
    """Return the places that a robot comes to, by a search over floors and places that knows nothing of one graph."""
    seen, left = {start}, [start]
    while left:
        floor, place = left.pop()
        there = {(floor, edge.target) for edge in floors.maps[floor].graph.edges if edge.source == place}
        for lift in floors.lifts:
            stops = [tuple(stop.split(".")) for stop in lift.stops]
            if (floor, place) in stops:
                first = stops.index((floor, place)) if lift.one_way else 0
                there |= set(stops[first:])
        left += there - seen
        seen |= there
    return seen


@settings(max_examples=40, deadline=None)
@given(drawn())
def test_what_cannot_be_reached_is_named_as_a_search_finds_it(floors):
    every = [tuple(name.split(".")) for name in floors.names]
    start = every[0]
    ahead = reachable(floors, start)
    behind = {place for place in every if start in reachable(floors, place)}
    expected = [
        [place for place in every if place not in ahead | behind],
        [place for place in every if place in behind - ahead],
        [place for place in every if place in ahead - behind],
    ]
    found = [problem for problem in check(floors, radius=0.2) if problem.kind == "ways" and not problem.floor]
    assert [[place_of(name) for name in problem.places] for problem in found] == [names for names in expected if names]


@settings(max_examples=20, deadline=None)
@given(drawn())
def test_the_model_goes_where_the_search_goes(floors):
    """The places with a positive chance after many random steps are those that a search finds."""
    if not floors.graph.labels:
        return
    made = model(floors.graph, start=floors.names[0])
    matrices = [made.transition_matrix(action) for action in range(len(made.action_space))]
    step = np.mean([each.todense() if made.is_sparse else each for each in matrices], axis=0)
    chances = np.asarray(np.linalg.matrix_power(step, len(floors.names)))[0]
    assert {tuple(floors.names[place].split(".")) for place in np.flatnonzero(chances > 0)} == reachable(
        floors, tuple(floors.names[0].split("."))
    )


def test_lifts_take_their_seconds_and_ways_those_of_their_length():
    floors = Floors({"ground": GROUND, "upper": UPPER}, (Lift("lift", ("ground.shop", "upper.hall"), 20.0),))
    taken, graph = arrivals(floors, speed=0.5, radius=0.2), floors.graph
    of = {
        (edge.source, edge.label): taken[graph.names.index(edge.source), graph.labels.index(edge.label)]
        for edge in graph.edges
    }
    assert of == pytest.approx(
        {
            ("ground.hall", "to shop"): 4.0,
            ("ground.shop", "to hall"): 4.0,
            ("ground.shop", "lift to upper"): 20.0,
            ("upper.hall", "lift to ground"): 20.0,
        }
    )


def test_a_place_of_another_floor_is_not_seen():
    floors = Floors({"ground": GROUND, "upper": UPPER})
    seen = sightings(floors, 0.5, radius=0.2)
    assert seen[:2, :2] == pytest.approx(sightings(GROUND, 0.5, radius=0.2))
    assert seen[2].tolist() == [0.0, 0.0, 1.0]
    assert seen[:2, 2].tolist() == [0.0, 0.0]


def quickest(floors, start):
    """Return the least seconds from a place to each other one, by relaxing all ways again and again."""
    far = dict.fromkeys(floors.names, np.inf) | {start: 0.0}
    ways = [
        (
            f"{floor}.{edge.source}",
            f"{floor}.{edge.target}",
            2.0 * abs(int(edge.source[1:]) - int(edge.target[1:])) / 0.5,
        )
        for floor, each in floors.maps.items()
        for edge in each.graph.edges
    ]
    for lift in floors.lifts:
        for one, source in enumerate(lift.stops):
            for other, target in enumerate(lift.stops):
                if other > one or (other < one and not lift.one_way):
                    ways.append((source, target, lift.seconds * abs(other - one)))
    for _ in floors.names:
        for source, target, seconds in ways:
            far[target] = min(far[target], far[source] + seconds)
    return far


@settings(max_examples=40, deadline=None)
@given(drawn(), st.data())
def test_the_lifts_to_take_are_those_of_the_quickest_way(floors, data):
    source, target = (data.draw(st.sampled_from(floors.names)) for _ in range(2))
    least = quickest(floors, source)[target]
    if not np.isfinite(least):
        with pytest.raises(MapError, match="no ways and lifts lead from"):
            rides(floors.graph, source, target)
        return
    taken = rides(floors.graph, source, target)
    here, driven = source, 0.0
    for ride in taken:
        on_floor = quickest(Floors(floors.maps), here)
        driven += on_floor[ride.source] + ride.seconds
        here = ride.target
    assert driven + quickest(Floors(floors.maps), here)[target] == pytest.approx(least)


class Walker:
    """A robot on several floors that is carried elsewhere now and then, and whose rides end anywhere if cancelled."""

    def __init__(self, floors, random):
        self.floors, self.random = floors, random
        self.at = floors.graph.node(str(random.choice(floors.names))).goal

    async def go(self, goal):
        assert goal.floor == self.at.floor
        while (far := goal.x - self.at.x) != 0.0:
            await asyncio.sleep(0.2)
            self.at = replace(self.at, x=self.at.x + max(-0.1, min(0.1, far)))

    async def ride(self, lift, goal):
        stops = [way for way in self.floors.graph.edges if way.lift == lift]
        here = [self.floors.graph.node(way.source).goal for way in stops]
        assert any(stop.floor == self.at.floor and abs(stop.x - self.at.x) < 0.7 for stop in here)
        try:
            await asyncio.sleep(10.0)
        finally:
            if self.random.random() < 0.5 or asyncio.current_task().cancelling() == 0:
                self.at = goal

    async def live(self, places):
        while True:
            places.see(self.at)
            await asyncio.sleep(0.1)


def chain(random):
    """Return a building whose floors are rows of rooms with ways both ways, each joined with the next by lifts."""
    sizes = random.integers(1, 4, size=int(random.integers(2, 4))).tolist()
    maps = {}
    for level, size in enumerate(sizes):
        names = [f"p{place}" for place in range(size)]
        maps[f"floor{level}"] = strip(names, both(*pairwise(names)))
    lifts = tuple(
        Lift(f"l{level}", tuple(f"floor{on}.p{random.integers(sizes[on])}" for on in (level, level + 1)), 10.0)
        for level in range(len(sizes) - 1)
    )
    return Floors(maps, lifts)


@pytest.mark.parametrize("seed", [*range(3), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3, 8))])
def test_a_patrol_goes_on_whatever_happens_on_whatever_floor(seed):
    random = np.random.default_rng(seed)
    floors = chain(random)
    graph, walker = floors.graph, Walker(floors, random)
    order = tour(graph)
    made = model(graph, factors=[visits(graph, order)])
    predicates = mdm.PredicateManager()
    places = Places(floors, predicates, tour=order)
    ensemble = mdm.Ensemble(
        "patrol",
        policy=mdm.solve(made, gap=1e-3).policy,
        model=made,
        predicates=predicates,
        states=[
            mdm.StateFactor("position", {name: f"{name}.reached" for name in graph.names}),
            mdm.StateFactor("next", {name: f"{name}.next" for name in order}),
        ],
        actions=Navigation(floors, walker, places).actions(),
        drive=None if seed % 2 else mdm.FixedRate(0.5),
        on_failed_action="decide",
    )

    async def main(runtime):
        await runtime.start(places)
        living = asyncio.create_task(walker.live(places))
        await asyncio.sleep(0.3)
        for _ in range(6):
            await runtime.start(ensemble)
            await asyncio.sleep(float(random.uniform(3.0, 40.0)))
            await runtime.stop(ensemble)
            if random.random() < 0.5:
                goal = graph.node(str(random.choice(graph.names))).goal
                walker.at = replace(goal, x=goal.x + float(random.choice([-0.6, 0.0, 0.6])))
        arrived = probe(predicates.events)
        await runtime.start(ensemble)
        await asyncio.sleep(3.0 * (40.0 * len(graph.names) + 20.0))
        living.cancel()
        return {event.removesuffix(".arrived") for update in arrived for event in update.events}

    assert set(graph.names) <= run_virtual(main)
