"""Graphs of places."""

from __future__ import annotations

import math

import pytest
from sentences import refused

from mdm.errors import MapError
from mdm.maps import Edge, Graph, Node, Pose

HALL, KITCHEN = Node("hall", Pose(0, 0)), Node("kitchen", Pose(3, 0, math.pi))


def test_a_label_leads_from_a_place_to_another():
    graph = Graph((HALL, KITCHEN), (Edge("hall", "kitchen", "Up"), Edge("kitchen", "hall", "Down")))
    assert graph.names == ("hall", "kitchen")
    assert graph.labels == ("Up", "Down")
    assert graph.target("hall", "Up") == "kitchen"
    assert graph.target("hall", "Down") is None
    assert graph.node("kitchen") is KITCHEN


@pytest.mark.parametrize(
    ("nodes", "edges", "message"),
    [
        ((), (), "no places"),
        ((HALL, HALL), (), "two places are called 'hall'"),
        ((Node("a", Pose(math.nan, 0)),), (), "the goal of 'a'.*not finite"),
        ((Node("", Pose(0, 0)),), (), "a place is called ''"),
        ((Node(3, Pose(0, 0)),), (), "a place is called 3"),
        ((Node("a", Pose(0, 0), zone=((0, 0), (1, 1))),), (), "the zone of 'a' has 2 corners"),
        (
            (Node("a", Pose(0, 0), zone=((0, 0), (1, math.nan), (1, 1))),),
            (),
            "the zone of 'a' has a corner that is not",
        ),
        ((Node("a", Pose(0, 0), tolerance=math.nan),), (), "the tolerance of 'a' is nan: give metres above 0"),
        ((Node("a", Pose(0, 0), tolerance=-1.0),), (), "the tolerance of 'a' is -1.0"),
        ((HALL,), (Edge("hall", "hall", ""),), "the way from 'hall' to 'hall' is called ''"),
        ((HALL,), (Edge("hall", "kitchn", "Up"),), "no place 'kitchn'; there are hall"),
        (
            (HALL, KITCHEN),
            (Edge("hall", "kitchen", "Up"), Edge("hall", "hall", "Up")),
            "from 'hall' two ways are called 'Up': to 'kitchen' and to 'hall'",
        ),
    ],
)
def test_a_graph_that_is_none_is_refused(nodes, edges, message):
    with pytest.raises(MapError, match=message):
        Graph(nodes, edges)


def test_an_unknown_place_is_told_with_those_that_there_are():
    with refused(MapError):
        Graph((HALL, KITCHEN), ()).node("attic")
