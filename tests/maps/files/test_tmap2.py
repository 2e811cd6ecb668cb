"""LCAS's topological maps."""

from __future__ import annotations

import math

import pytest

from mdm.errors import FormatError
from mdm.maps import Edge, load_graph

NODE = """- meta: {{map: m, node: {name}, pointset: p}}
  node:
    edges:
    - {{action: move_base, edge_id: {name}_{target}, node: {target}, config: {config}}}
    name: {name}
    {frame}
    pose:
      orientation: {{w: {w}, x: 0.0, y: 0.0, z: {z}}}
      position: {{x: {x}, y: 2.0, z: 0.0}}
    properties: {{xy_goal_tolerance: 0.3}}
    verts:
    - {{x: -1.0, y: -1.0}}
    - {{x: 1.0, y: -1.0}}
    - {{x: 1.0, y: 1.0}}
"""
ROTATED = """transformation:
  child: topo_map
  parent: map
  rotation: {w: 0.70710678, x: 0.0, y: 0.0, z: 0.70710678}
  translation: {x: 10.0, y: 3.0, z: 0.0}
"""


def text(frame="", w=1.0, z=0.0):
    turn = {"w": w, "z": z, "frame": frame}
    return (
        "nodes:\n"
        + NODE.format(name="A", target="B", config="&id001 []", x=0.0, **turn)
        + NODE.format(name="B", target="A", config="*id001", x=5.0, **turn)
        + "metric_map: m\n"
    )


def load(tmp_path, content):
    (tmp_path / "graph.tmap2").write_text(content)
    return load_graph(tmp_path / "graph.tmap2")


def test_zones_are_relative_to_the_position_and_labels_name_the_target(tmp_path):
    graph = load(tmp_path, text())
    assert graph.names == ("A", "B")
    assert graph.node("B").zone == ((4.0, 1.0), (6.0, 1.0), (6.0, 3.0))
    assert graph.node("B").tolerance == 0.3
    assert graph.edges == (Edge("A", "B", "to B"), Edge("B", "A", "to A"))


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2, -math.pi / 2, 3.0, -1.0])
@pytest.mark.parametrize("length", [1.0, -1.0, 0.5])
def test_the_yaw_is_the_whole_angle_with_its_sign(tmp_path, yaw, length):
    graph = load(tmp_path, text(w=length * math.cos(yaw / 2), z=length * math.sin(yaw / 2)))
    assert graph.node("A").goal.yaw == pytest.approx(yaw)
    assert graph.node("A").zone == ((-1.0, 1.0), (1.0, 1.0), (1.0, 3.0))  # not turned with the goal


@pytest.mark.parametrize("frame", ["parent_frame: topo_map", "nav_frame: '${transformation.topo_frame_id}'", ""])
def test_nodes_are_taken_to_the_frame_of_the_map(tmp_path, frame):
    node = load(tmp_path, text(frame) + ROTATED).node("B")
    assert (node.goal.x, node.goal.y, node.goal.yaw) == pytest.approx((8.0, 8.0, math.pi / 2))
    assert node.zone is not None
    assert node.zone[0] == pytest.approx((9.0, 7.0))
    node = load(tmp_path, text(frame) + ROTATED.replace("child", "topo_frame_id")).node("B")
    assert node.goal.x == pytest.approx(8.0)


def test_nodes_in_the_frame_of_the_map_stay(tmp_path):
    assert load(tmp_path, text("parent_frame: map") + ROTATED).node("B").goal.x == 5.0


def test_a_node_may_have_no_zone_no_edge_and_no_tolerance(tmp_path):
    lines = text().splitlines()
    verts = next(index for index, line in enumerate(lines) if "verts" in line)
    lines[verts : verts + 4] = ["    verts: []"]
    del lines[next(index for index, line in enumerate(lines) if "properties" in line)]
    graph = load(tmp_path, "\n".join(lines).replace("B, config: &id001 []", "A, config: &id001 []"))
    assert (graph.node("A").zone, graph.node("A").tolerance) == (None, None)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("node: B, config", "node: C, config", ":5: a way leads from 'A' to 'C', and there is no place 'C'"),
        ("name: B\n", "name: A\n", "a second place is called 'A'"),
        ("x: 5.0, y: 2.0", "x: .nan, y: 2.0", "x of B: a number was expected, not '.nan'"),
        ("x: 5.0, y: 2.0", "x: 5.0", "B: the key 'y' is missing"),
        ("w: 1.0", "w: 0.0", ":9: the orientation of A is a quaternion of zeros"),
        ("w: 1.0, x: 0.0", "w: 1.0, x: 1.0", "is not a turn about the vertical axis"),
        ("    - {x: 1.0, y: 1.0}\n", "", ":13: the verts of A are 2 points; 3 or more"),
        ("tolerance: 0.3", "tolerance: 0", ":11: xy_goal_tolerance is 0; it must be above 0"),
        ("name: A\n", "name: A\n    parent_frame: odom\n", ":7: A lies in the frame 'odom'; 'map' was expected"),
        ("nodes:", "places:", "a graph was expected"),
        ("    name: A\n", "", "a node: the key 'name' is missing"),
        ("nodes:", "nodes: []\nrest:", "no places"),
        ("verts:", "verts: 3\n    rest:", "verts of A: a list was expected, not '3'"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(tmp_path, old, new, message):
    with pytest.raises(FormatError) as caught:
        load(tmp_path, text().replace(old, new))
    assert message in str(caught.value)
