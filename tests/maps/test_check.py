"""Checks of a map: each finds what was put into a floor without problems, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from floor_file import GRAPH, rooms, write_floor
from hypothesis import given, settings, strategies as st
from maps.floors import Floor
from sentences import refused

import mdm
from mdm import PredicateManager
from mdm.errors import ConfigError, MapError
from mdm.maps import Edge, Frame, Graph, Grid, Labels, Map, Node, Places, Pose, check, draft, load_map
from mdm.simulation.building import Building, DriveError


def floor(tmp_path, raster=None, graph=GRAPH):
    grid, labels, path = write_floor(tmp_path, raster=raster, graph=graph)
    return load_map(path, grid=grid, labels=labels)


def told(some, *, radius=0.1, **options):
    return [(problem.kind, problem.text) for problem in check(some, radius=radius, **options)]


def with_graph(some, *, nodes=None, edges=None):
    return Map(some.labels, Graph(nodes or some.graph.nodes, edges or some.graph.edges), some.grid)


def moved(some, name, x, y):
    nodes = tuple(Node(node.name, Pose(x, y)) if node.name == name else node for node in some.graph.nodes)
    return with_graph(some, nodes=nodes)


def test_a_floor_without_problems(tmp_path):
    assert told(floor(tmp_path)) == []


def test_a_goal_in_another_place_in_none_in_a_wall_and_outside(tmp_path):
    some = floor(tmp_path)
    assert told(moved(some, "hall", 0.0, 5.0)) == [("goals", "the goal of 'hall', (0, 5), lies in 'office'")]
    assert told(moved(some, "hall", -0.95, 3.0)) == [
        ("goals", "the goal of 'hall', (-0.95, 3), lies in no place"),
        ("goals", "the goal of 'hall', (-0.95, 3), is not free in the map"),
    ]
    assert told(moved(some, "hall", 70, 0)) == [("goals", "the goal of 'hall', (70, 0), lies outside the map")]


def test_a_goal_where_the_robot_does_not_fit(tmp_path):
    some = moved(floor(tmp_path), "hall", -0.75, 3.0)
    assert told(some, radius=0.1) == []
    (problem,) = (problem for problem in check(some, radius=0.2) if problem.kind == "goals")
    assert (
        problem.text
        == "the goal of 'hall', (-0.75, 3), is 0.20 m from what is not free, and the robot needs 0.26 m to drive"
    )
    assert (problem.places, problem.cells) == (("hall",), [(29, 2)])


def test_a_way_between_places_that_do_not_touch(tmp_path):
    some = floor(tmp_path)
    edges = (*some.graph.edges, Edge("office", "store", "Right"))
    assert told(with_graph(some, edges=edges)) == [
        ("ways", "a way leads from 'office' to 'store', and these places do not touch")
    ]


def test_a_passage_that_is_too_narrow(tmp_path):
    assert told(floor(tmp_path), radius=0.18) == [
        (
            "ways",
            (
                "a way leads from 'hall' to 'office', and the widest passage is 0.40 m, too narrow for a robot of "
                "0.36 m, which needs 0.48 m to drive"
            ),
        )
    ]


def test_what_stands_between_two_goals():
    """The door is wide enough, and a shelf behind it leaves 0.5 m beside it."""
    drawn = Floor(
        8.0, 4.0, {"west": (0.0, 0.0, 4.0, 4.0), "east": (4.0, 0.0, 8.0, 4.0)},
        {("east", "west"): (3.8, 1.0, 4.2, 3.0)},
        furniture=[(5.0, 0.6, 5.4, 4.0)],
    ).map()  # fmt: skip
    goals = {"west": (0.0, 1.0), "east": (5.0, 1.0)}
    some = with_graph(drawn, nodes=tuple(Node(name, Pose(*at)) for name, at in goals.items()))
    assert told(some, radius=0.2) == []
    assert told(some, radius=0.25) == [
        (
            "ways",
            (
                "a way leads from 'east' to 'west', and what stands about leaves no path between their goals that is "
                "wide enough for a robot of 0.5 m"
            ),
        )
    ]


@settings(max_examples=15)
@given(
    door=st.integers(8, 20), depth=st.integers(2, 40), beside=st.integers(8, 24), at=st.integers(12, 60),
    radius=st.sampled_from([0.2, 0.25, 0.3]), resolution=st.sampled_from([0.05, 0.1]),
)  # fmt: skip
def test_a_robot_drives_wherever_the_check_lets_it(door, depth, beside, at, radius, resolution):
    """There and back through a passage of some width and depth, and past furniture; only if the check finds nothing."""
    low, wide, side = at / 20, door / 20, beside / 20
    long = 4.0 + depth / 20
    rooms = {
        "west": (0.0, 0.0, 4.0, 4.5),
        "passage": (4.0, low, long, low + wide),
        "east": (long, 0.0, long + 4.0, 4.5),
    }
    drawn = Floor(
        long + 4.0, 4.5, rooms, {("east", "west"): (3.8, low, long + 0.2, low + wide)},
        furniture=[(long + 1.2, 0.075 + side, long + 1.6, 4.5)], side=resolution,
    )  # fmt: skip
    labels = np.where(drawn.grid.free, drawn.labels.raster, 0)
    labels[labels == 2] = 1
    labels[labels == 3] = 2
    labels[(labels == 0) & drawn.grid.free] = 1
    goals = {"west": (-0.5, 1.0), "east": (long + 0.6, 1.0)}
    graph = Graph(
        tuple(Node(name, Pose(*to)) for name, to in goals.items()),
        (Edge("west", "east", "Right"), Edge("east", "west", "Left")),
    )
    some = Map(Labels(drawn.frame, labels.astype(np.uint16), ("west", "east")), graph, drawn.grid)
    problems = [problem for problem in check(some, radius=radius, margin=0.1) if problem.kind in {"ways", "goals"}]
    building = Building(some, seed=1)
    try:
        robot = building.robot("ada", at="west", radius=radius, speed=1.0)
    except MapError:
        assert problems
        return

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(building)
            for name in ("east", "west"):
                await robot.go(graph.node(name).goal)

    if not problems:
        mdm.run(main, virtual=True)
        assert robot.collisions == 0
    else:
        with pytest.raises((DriveError, MapError)):
            mdm.run(main, virtual=True)


def test_places_that_touch_without_a_way(tmp_path):
    raster = rooms()
    raster[5:10, 19] = "store"  # a third door
    some = floor(tmp_path, raster)
    ((kind, text),) = told(some)
    assert kind == "ways"
    assert text.startswith("'office' and 'store' touch by a passage of 0.")
    assert text.endswith("and no way leads through it")
    assert told(some, radius=0.4)[-1][1].startswith("a way leads")  # too narrow to be used


def test_places_that_cannot_be_reached_or_left(tmp_path):
    some = floor(tmp_path)
    up, right, down, left = some.graph.edges
    assert told(with_graph(some, edges=(up, right, left))) == [("ways", "from 'office' there is no way back to 'hall'")]
    assert told(with_graph(some, edges=(right, down, left))) == [("ways", "'office' cannot be reached from 'hall'")]
    assert told(with_graph(some, edges=(up, down)))[-1] == ("ways", "no ways join 'store' with 'hall'")


def test_a_place_in_two_pieces(tmp_path):
    """A label that is on both sides of a wall; of a piece in which no robot fits nothing is said."""
    raster = rooms()
    raster[1:8, 20:39] = "hall"
    raster[35, 25] = "hall"
    some = floor(tmp_path, raster)
    (text,) = (text for kind, text in told(some) if kind == "rooms")
    assert text == (
        "'hall' is in 2 pieces, around (1.35, 5.55), (0.05, 3.05): no path leads from one to another within it"
    )
    assert not [text for _, text in told(some, radius=0.65) if "pieces" in text]  # no such robot fits in the second


def test_a_way_to_where_it_comes_from(tmp_path):
    some = floor(tmp_path)
    edges = (*some.graph.edges, Edge("store", "store", "Up"))
    assert told(with_graph(some, edges=edges)) == [("ways", "the way 'Up' from 'store' leads to where it comes from")]


def test_stray_colours(tmp_path):
    some = floor(tmp_path)
    labels = Labels(some.labels.frame, some.labels.raster, some.labels.names, {200: 420, 7: 3, 9: 1})
    assert told(Map(labels, some.graph, some.grid)) == [
        ("colours", "the colour 7 is no place's, and has 3 cells: a slip of the brush?"),
        ("colours", "the colour 9 is no place's, and has 1 cell: a slip of the brush?"),
    ]


@pytest.mark.parametrize("margin", [0.3, 0.45])
def test_a_place_that_is_nowhere_deep_enough(tmp_path, margin):
    """A strip of four cells between two places: in the middle it is one and a half cells of 0.1 m from both."""
    raster = rooms()
    raster[1:20, 1:19] = "hall"
    raster[20, 1:19] = "hall"
    raster[19:23, 1:19] = "office"
    raster[28:33, 19] = ""
    raster[1:39, 20:39] = ""
    raster[30:38, 20:39] = "store"
    raster[32:35, 19] = "store"
    some = floor(tmp_path, raster, GRAPH.replace("0.0 5.0", "0.0 3.9").replace("2.0 3.5", "2.0 2.5"))
    shallow = [text for kind, text in told(some, margin=margin) if kind == "rooms" and "pieces" not in text]
    (text,) = shallow
    assert text.startswith("'office' is nowhere further than 0.15 m from its border, and a robot counts as having come")
    assert text.endswith(f"only at {margin} m")
    assert [text for _, text in told(some, margin=0.15) if "pieces" not in text] == []  # the strip divides the hall


def test_a_goal_that_is_so_near_to_the_border_that_a_robot_there_does_not_count(tmp_path):
    some = moved(floor(tmp_path), "hall", 0.0, 3.83)  # the door's upper edge is 0.15 m away
    assert told(some, radius=0.1, margin=0.1) == []
    ((kind, text),) = told(some, radius=0.1)
    assert kind == "goals"
    assert text.startswith(
        "the goal of 'hall', (0, 3.83), is 0.15 m behind the border of its place, and a robot counts"
    )


def test_a_place_without_a_free_cell(tmp_path):
    some = floor(tmp_path)
    raster = some.labels.raster.copy()
    raster[raster == 3] = 0
    raster[0, :] = 3
    labels = Labels(some.labels.frame, raster, some.labels.names)
    problems = told(Map(labels, some.graph, some.grid))
    assert ("rooms", "'store' has no free cell") in problems


def test_the_points_of_a_route_are_told_in_one_sentence():
    """Not in one for each two that touch without a way."""
    frame = Frame(40, 300, 0.1)
    open_cells = np.ones(frame.shape, dtype=bool)
    names = tuple(map(str, range(30)))
    graph = Graph(tuple(Node(name, Pose(0.5 + int(name), 2.0)) for name in names), ())
    grid = Grid(frame, open_cells, ~open_cells)
    problems = told(Map(draft(grid, graph), graph, grid))
    ((_, text),) = [problem for problem in problems if problem[0] == "rooms"]
    assert text.startswith(
        "30 of 30 places have a neighbour from which nothing divides them: are these the points of a"
    )
    assert len(problems) == 2  # the other one is that no ways join them


def test_without_a_grid_what_takes_one_is_left_out(tmp_path):
    some = floor(tmp_path)
    assert told(Map(some.labels, some.graph), radius=5.0) == []
    assert told(Map(moved(some, "hall", 0.0, 5.0).labels, moved(some, "hall", 0.0, 5.0).graph)) == [
        ("goals", "the goal of 'hall', (0, 5), lies in 'office'")
    ]


def test_a_single_place_is_deep_everywhere():
    frame = Frame(5, 5, 0.1)
    labels = Labels(frame, np.ones((5, 5), dtype=np.uint16), ("a",))
    grid = Grid(frame, np.ones((5, 5), dtype=bool), np.zeros((5, 5), dtype=bool))
    assert told(Map(labels, Graph((Node("a", Pose(0.25, 0.25)),), ()), grid)) == []


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("b/hall", "reads as another agent's predicate: give the place another name"),
        ("hall.failed", "reads as the end of an action: give the place another name"),
        ("office.left", "is what 'office' has for a predicate or an event: give one another name"),
    ],
)
def test_a_name_that_predicates_could_not_have(tmp_path, name, why):
    some = floor(tmp_path, graph=GRAPH.replace("hall", name))
    assert told(some) == [("rooms", f"the name {name!r} {why}")]
    with pytest.raises(ConfigError):
        Places(some, PredicateManager(), margin=0.1)


@pytest.mark.parametrize("wrong", [{"radius": np.nan}, {"radius": -1.0}, {"margin": np.nan}, {"margin": "wide"}])
def test_lengths_that_are_none_are_refused(tmp_path, wrong):
    with refused(MapError):
        check(floor(tmp_path), **wrong)
