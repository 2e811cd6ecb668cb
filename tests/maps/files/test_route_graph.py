"""Nav2's route graphs."""

from __future__ import annotations

import json

import pytest
from sentences import refused

from mdm.errors import FormatError, MapWarning
from mdm.maps import Edge, Pose, load_graph


def point(number, x, y, **more):
    return {
        "type": "Feature",
        "properties": {"id": number, **more},
        "geometry": {"type": "Point", "coordinates": [x, y]},
    }


def line(number, start, end, kind="MultiLineString", **more):
    properties = {"id": number, "startid": start, "endid": end, **more}
    return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": [[[0, 0], [1, 1]]]}}


NODES = [point(1, 0.5, -1.5, frame="map"), point(2, 3, 4, metadata={"name": "kitchen", "class": {}})]


def load(tmp_path, features, **more):
    (tmp_path / "graph.geojson").write_text(json.dumps({"type": "FeatureCollection", **more, "features": features}))
    return load_graph(tmp_path / "graph.geojson")


def test_names_come_from_metadata_and_else_from_numbers(tmp_path):
    features = [
        line(9, 1, 2, cost=2.5),
        *NODES,
        line(8, 2, 1, "LineString", metadata={"name": "back"}, overridable=True),
    ]
    with pytest.warns(MapWarning) as caught:
        graph = load(tmp_path, features, crs={"name": "x"})
    (told,) = (str(each.message) for each in caught)
    assert told.endswith("not carried over: crs, of the collection; cost, of id 9; overridable, of id 8")
    assert graph.names == ("1", "kitchen")
    assert graph.node("1").goal == Pose(0.5, -1.5, 0.0)
    assert graph.edges == (Edge("1", "kitchen", "to kitchen", 2.5), Edge("kitchen", "1", "back"))
    assert graph.target("kitchen", "to 1") is None  # ways have one direction


def test_what_a_route_server_would_heed_is_named(tmp_path):
    operations = {"door": {"type": "open_door", "trigger": "ON_ENTER"}}
    nodes = [point(1, 0, 0, metadata={"name": "a", "class": {"speed": 1}}), point(2, 3, 4, level=None, extra=0)]
    with pytest.warns(MapWarning, match="not carried over") as caught:
        load(tmp_path, [*nodes, line(3, 1, 2, operations=operations), line(4, 2, 1, operations={})])
    (told,) = (str(each.message) for each in caught)
    assert told.partition("over: ")[2] == (
        "class, of id 1; extra, of id 2; operations {'door': {'type': 'open_door', 'trigger': 'ON_ENTER'}}, of id 3"
    )


@pytest.mark.foreign("small inputs after public reports")
def test_an_operation_of_a_reported_graph_is_named(corpus):
    with pytest.warns(MapWarning, match=r"operations .*open_door.*, of id 11; cost, of id 14; overridable, of id 14"):
        load_graph(corpus / "reported" / "g.geojson")


def test_an_edge_that_is_given_twice_is_one(tmp_path):
    assert len(load(tmp_path, [*NODES, line(3, 1, 2), line(4, 1, 2)]).edges) == 1


def test_nodes_on_one_point_are_one_place(tmp_path):
    """As in the graph of a depot that Nav2 ships: what leads to the second leads to the first."""
    features = [*NODES, point(7, 3, 4), line(10, 1, 7), line(11, 7, 1), line(12, 2, 7), line(13, 7, 2)]
    with pytest.warns(MapWarning, match="nodes on one point are one place: 'kitchen' and '7'"):
        graph = load(tmp_path, features)
    assert graph.names == ("1", "kitchen")
    assert graph.edges == (Edge("1", "kitchen", "to kitchen"), Edge("kitchen", "1", "to 1"))


def test_nodes_of_one_zone_are_one_place(tmp_path):
    """Its goal is the node in the middle, and ways are those from zone to zone."""
    zones = [point(number, x, 0, metadata={"zone": "aisle"}) for number, x in ((1, 0), (2, 5), (3, 11))]
    dock = point(4, 20, 0, metadata={"zone": "dock", "name": "left out"})
    ways = [line(10 + one, one, one + 1) for one in (1, 2, 3)] + [line(20 + one, one + 1, one) for one in (1, 2, 3)]
    graph = load(tmp_path, [*ways, *zones, dock, point(5, 30, 0), line(30, 4, 5), line(31, 1, 4)])
    assert graph.names == ("aisle", "dock", "5")
    assert graph.node("aisle").goal == Pose(5.0, 0.0)
    assert set(graph.edges) == {
        Edge("aisle", "dock", "to dock"),
        Edge("dock", "aisle", "to aisle"),
        Edge("dock", "5", "to 5"),
    }


@pytest.mark.parametrize(
    ("features", "message"),
    [
        ([], "no places"),
        ([*NODES, point(3, 0, 0, metadata={"zone": ["a"]})], "features[2], id 3: the zone is ['a']; a text was"),
        (
            [*NODES, point(3, 0, 0, metadata={"zone": "kitchen"})],
            "features[2], id 3: a second place is called 'kitchen",
        ),
        ([*NODES, point(2, 0, 0)], "features[2], id 2: a second node has this id"),
        (
            [*NODES, point(3, 0, 0, metadata={"name": "kitchen"})],
            "features[2], id 3: a second place is called 'kitchen'",
        ),
        ([*NODES, point(3, 0, 0, metadata={"name": 5})], "the name is 5; a text was expected"),
        ([*NODES, point(3, 0, 0, frame="odom")], "different frames: map, odom"),
        ([*NODES, point(3, "a", 0)], "features[2], id 3: the coordinates x and y were expected, not ['a', 0]"),
        ([*NODES, point(3, None, 0)], "the coordinates x and y were expected"),
        ([*NODES, point(3, float("nan"), 0)], "this is not a route graph in GeoJSON"),
        ([*NODES, point(3, 10**400, 0)], "features[2], id 3: the coordinates x and y were expected, not [1000000"),
        ([*NODES, point(3, 1e300, 0)], "features[2], id 3: '3' lies at 1e+300, 0: metres were expected"),
        ([*NODES, point(3, True, 0)], "features[2], id 3: the coordinates x and y were expected, not [True, 0]"),
        ([*NODES, point(3, 0, 0, metadata={"name": "a\nb"})], "features[2], id 3: a place is called 'a\\nb'"),
        ([*NODES, point(3, 0, 0, metadata={"name": "  "})], "features[2], id 3: a place has no name"),
        ([*NODES, line(3, 1, 7)], "features[2], id 3: the edge leads from 1 to 7, and there is no node 7"),
        ([*NODES, line(3, None, 1)], "features[2], id 3: an edge needs startid and endid"),
        ([*NODES, line(3, 1, 1, "Polygon")], "a Point, a LineString or a MultiLineString was expected, not a Polygon"),
        ([*NODES, {"geometry": NODES[0]["geometry"]}], "missing required field `properties` - at `$.features[2]`"),
        ([*NODES, point("x", 0, 0)], "got `str` - at `$.features[2].properties.id`"),
    ],
)
def test_what_is_wrong_is_told_with_its_feature(tmp_path, features, message):
    with pytest.raises(FormatError) as caught:
        load(tmp_path, features)
    assert message in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "graph.geojson"))


@pytest.mark.parametrize("content", ['{"features": [', "{" * 10_000, '{"features":' + "[" * 100_000])
def test_damaged_texts(tmp_path, content):
    (tmp_path / "graph.geojson").write_text(content)
    with refused(FormatError):
        load_graph(tmp_path / "graph.geojson")
