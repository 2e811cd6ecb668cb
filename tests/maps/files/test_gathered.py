"""Places and ways that are gathered one by one."""

from __future__ import annotations

from sentences import refused

from mdm.maps import Edge, Node, Pose
from mdm.maps.files.gathered import Gathered


def fail(message):
    raise LookupError(message)


def gathered(names="ab"):
    some = Gathered()
    for name in names:
        some.add_node(Node(name, Pose(0, 0)), fail)
    return some


def test_of_two_ways_between_the_same_places_the_cheaper_one_counts():
    some = gathered()
    for cost in (3.0, 2.0, 5.0):
        some.add_edge(Edge("a", "b", "go", cost), fail)
    assert some.graph(fail).edges == (Edge("a", "b", "go", 2.0),)


def test_what_does_not_fit_is_told_where_it_stands():
    with refused(LookupError):
        gathered("abb")
    some = gathered("abc")
    some.add_edge(Edge("a", "b", "go"), fail)
    with refused(LookupError):
        some.add_edge(Edge("a", "c", "go"), fail)
    some.add_edge(Edge("a", "d", "jump"), fail)
    with refused(LookupError):
        some.graph(fail)
    with refused(LookupError):
        some.add_edge(Edge("a", "b", " "), fail)
    with refused(LookupError):
        some.add_node(Node("", Pose(0, 0)), fail)
    with refused(LookupError):
        some.add_node(Node("\x1b", Pose(0, 0)), fail)
    with refused(LookupError):
        some.add_node(Node("d", Pose(0, 0), ((0, 0), (1, 0), (0, -2e9))), fail)
    with refused(LookupError):
        Gathered().graph(fail)
