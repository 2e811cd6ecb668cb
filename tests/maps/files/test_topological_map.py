"""The original's graphs."""

from __future__ import annotations

import pytest
from floor_file import GRAPH
from sentences import refused

from mdm.errors import FormatError
from mdm.maps import Edge, Graph, Node, Pose, load_graph, save_graph


def load(tmp_path, text):
    (tmp_path / "graph.xml").write_text(text)
    return load_graph(tmp_path / "graph.xml")


def test_places_goals_and_ways(tmp_path):
    graph = load(tmp_path, GRAPH)
    assert graph.names == ("hall", "office", "store")
    assert graph.node("office").goal == Pose(0, 5, 1.5707963)  # the yaw, too
    assert graph.edges[:2] == (Edge("hall", "office", "Up"), Edge("hall", "store", "Right"))
    assert (graph.target("store", "Left"), graph.target("store", "Up")) == ("hall", None)
    assert graph.node("hall").zone is None


def test_other_nestings_and_a_goal_without_yaw(tmp_path):
    text = '<?xml version="1.0"?><TopologicalMap><!-- x --><Nodes><Node name="a"><Goal> 1 -2e0 </Goal>'
    text += '<Connection label="On"> b </Connection></Node></Nodes><Node name="b"><Goal>0 0 3</Goal></Node>'
    with refused(FormatError):
        load(tmp_path, text + "</TopologicalMap>")
    graph = load(tmp_path, text.replace("<Nodes>", "").replace("</Nodes>", "") + "</TopologicalMap>")
    assert graph.node("a").goal == Pose(1, -2, 0)
    assert graph.target("a", "On") == "b"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0.0 3.0 0", "--1.96 -1.47 0", ":3:9: x, y and yaw were expected, not '--1.96 -1.47 0'"),
        ("0.0 3.0 0", "0.0", ":3:9: x, y and yaw"),
        ("0.0 3.0 0", "0 0 0 1", ":3:9: x, y and yaw"),
        ("0.0 3.0 0", "0 nan 0", ":3:9: x, y and yaw"),
        ("<Goal>0.0 3.0 0</Goal>", "", ":2:5: <Node> needs a <Goal>"),
        ("<Goal>0.0 3.0 0</Goal>", "<Goal>0 0 0</Goal><Goal>0 0 0</Goal>", "'hall' has a second <Goal>"),
        ("<Goal>0.0 3.0 0</Goal>", "<Goal>0 0 0</Goal><Zone/>", "not <Zone>"),
        (' name="hall"', "", "needs the attribute 'name'"),
        ('name="store"', 'name="office"', ":13:5: a second place is called 'office'"),
        ("Right", "Up", ":6:13: from 'hall' two ways are called 'Up': to 'office' and 'store'"),
        (">store<", ">cellar<", ":6:13: a way leads from 'hall' to 'cellar', and there is no place 'cellar'"),
        (">store<", "><", ":6:13: the connection names no place"),
        (' label="Up"', "", "needs the attribute 'label'"),
        ("TopologicalMap", "Model", "<TopologicalMap> was expected, not <Model>"),
        ("</TopologicalMap>", "", "not well-formed XML"),
        ("<TopologicalMap>", '<!DOCTYPE x [<!ENTITY a "a">]><TopologicalMap>', "document type"),
    ],
)
def test_what_is_wrong_is_told_with_its_place(tmp_path, old, new, message):
    with pytest.raises(FormatError) as caught:
        load(tmp_path, GRAPH.replace(old, new))
    assert message in str(caught.value)


def test_a_graph_that_is_written_is_read_as_it_was(tmp_path):
    names = ("a & b", '<"quoted">', "Küche")
    nodes = tuple(Node(name, Pose(0.1 * index, -1e-7, 2 / 3)) for index, name in enumerate(names))
    graph = Graph(nodes, (Edge(names[0], names[1], "to <it>"), Edge(names[2], names[0], "Up & down")))
    save_graph(graph, tmp_path / "graph.xml")
    assert load_graph(tmp_path / "graph.xml") == graph
    with refused(FormatError):
        save_graph(graph, tmp_path / "nowhere" / "graph.xml")


def test_a_map_without_places(tmp_path):
    with refused(FormatError):
        load(tmp_path, "<TopologicalMap></TopologicalMap>")


@pytest.mark.foreign("topology/topological_map.xml")
def test_the_graph_of_the_original(corpus):
    graph = load_graph(corpus / "topology" / "topological_map.xml")
    assert (len(graph.nodes), len(graph.edges)) == (6, 10)
    assert graph.labels == ("Up", "Down", "Left", "Right")
    assert graph.node("IsInWestCorridor").goal == Pose(6.0, 3.88, -1.5708)
