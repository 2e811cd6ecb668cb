"""Which colour is which place's."""

from __future__ import annotations

import numpy as np

from mdm.maps import Frame, Graph, Grid, Node, Pose
from mdm.maps.files.load import colours_by_name, colours_under_goals

COLOURS = np.array([[5, 5, 9, 9, 0xFF000007]], dtype=np.uint32)
GRID = Grid(Frame(1, 5, 1.0), np.array([[True, True, True, False, True]]), np.zeros((1, 5), dtype=bool))


def graph(**goals):
    return Graph(tuple(Node(name, Pose(x, 0.5)) for name, x in goals.items()), ())


def texts(problems):
    return [problem.text for problem in problems]


def test_all_that_is_wrong_with_names_is_told():
    places = graph(a=0.5, b=1.5, c=2.5, d=3.5)
    chosen, problems = colours_by_name(places, COLOURS, {"a": 5, "b": 5, "c": 7, "e": 9})
    assert chosen == {"a": 5, "c": 7}
    assert texts(problems) == [
        "'a' and 'b' have the same colour, 5: give each its own",
        "'e' has a colour, and is no place of the graph, which has a, b, c, d",
        f"no pixel has the colour of 'c', 7; with opacity, as in this image, it is {0xFF000007}",
        "the names give no colour to 'd', a place of the graph",
    ]
    assert problems[0].places == ("a", "b")


def test_all_that_is_wrong_under_goals_is_told():
    chosen, problems = colours_under_goals(graph(a=0.5, b=1.5, c=3.5, d=8.5, e=2.5), COLOURS, GRID)
    assert chosen == {"a": 5, "e": 9}
    assert texts(problems) == [
        "the goal of 'b', (1.5, 0.5), and that of 'a' lie on the same colour, 5: give each place its own",
        (
            "the goal of 'c', (3.5, 0.5), is not free in the map, so that the colour under it says nothing: "
            "move it, or give names"
        ),
        "the goal of 'd', (8.5, 0.5), lies outside the map",
    ]
    assert problems[1].cells == [(0, 3)]
