"""Places and ways that are gathered one by one."""

from __future__ import annotations

import pytest

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
    with pytest.raises(LookupError, match="a second place is called 'b'"):
        gathered("abb")
    some = gathered("abc")
    some.add_edge(Edge("a", "b", "go"), fail)
    with pytest.raises(LookupError, match="from 'a' two ways are called 'go': to 'b' and 'c'"):
        some.add_edge(Edge("a", "c", "go"), fail)
    some.add_edge(Edge("a", "d", "jump"), fail)
    with pytest.raises(LookupError, match="no place 'd'; there are a, b, c"):
        some.graph(fail)
    with pytest.raises(LookupError, match="a way from 'a' has no name"):
        some.add_edge(Edge("a", "b", " "), fail)
    with pytest.raises(LookupError, match="a place has no name"):
        some.add_node(Node("", Pose(0, 0)), fail)
    with pytest.raises(LookupError, match="a place is called '.x1b': names have no line breaks"):
        some.add_node(Node("\x1b", Pose(0, 0)), fail)
    with pytest.raises(LookupError, match="'d' lies at 0, -2e.09: metres were expected"):
        some.add_node(Node("d", Pose(0, 0), ((0, 0), (1, 0), (0, -2e9))), fail)
    with pytest.raises(LookupError, match="no places"):
        Gathered().graph(fail)
