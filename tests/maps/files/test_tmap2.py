"""LCAS's topological maps."""

from __future__ import annotations

import json
import math

import pytest

from mdm.errors import FormatError, MapWarning
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


def load(tmp_path, content, **options):
    (tmp_path / "graph.tmap2").write_text(content)
    return load_graph(tmp_path / "graph.tmap2", **options)


def told(tmp_path, content, **options):
    """Return a graph, and what is said not to be carried over."""
    with pytest.warns(MapWarning) as caught:
        graph = load(tmp_path, content, **options)
    (warning,) = caught
    return graph, str(warning.message).partition("not carried over: ")[2]


def restricted(planning="True", runtime="True", node="True"):
    """Return three places in a row of which the last is restricted, and a way between the first two."""
    third = NODE.format(
        name="C", target="A", config="[]", x=9.0, w=1.0, z=0.0, frame=f"restrictions_planning: {node!r}"
    )
    way = f"node: B, restrictions_planning: {planning!r}, restrictions_runtime: {runtime!r}, config"
    there = "    - {action: move_base, node: C}\n    name: B"
    return (
        text().replace("node: B, config", way).replace("    name: B", there).replace("metric_map", third + "metric_map")
    )


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


@pytest.mark.parametrize(
    ("condition", "holds"),
    [
        ("True", True),
        ("False", False),
        ("robot_SHORT", True),
        ("robot_tall", False),
        ("~robot_tall & (robot_short | task_mow)", True),
        ("task_mow", None),
        ("task_mow & robot_tall", False),
        ("task_mow | robot_short", True),
        ("~task_mow", None),
        ("robot_very_short", False),
        ("obstacleFree_1", None),
    ],
)
def test_what_is_known_of_the_robot_decides_where_it_can(tmp_path, condition, holds):
    content, robot = restricted(condition), {"robot": "short"}
    if holds is None:
        with pytest.raises(FormatError, match="cannot be judged"):
            load(tmp_path, content, robot=robot)
    else:
        graph = load(tmp_path, content, robot=robot) if holds else told(tmp_path, content, robot=robot)[0]
        assert (("A", "B") in {(edge.source, edge.target) for edge in graph.edges}) is holds


@pytest.mark.parametrize(("robot", "ways"), [("short", ["A B", "B A", "B C", "C A"]), ("tall", ["B A", "B C", "C A"])])
def test_ways_are_those_of_the_robot(tmp_path, robot, ways):
    content = restricted("robot_short | robot_small")
    if robot == "short":
        graph = load(tmp_path, content, robot={"robot": robot})
    else:
        graph, what = told(tmp_path, content, robot={"robot": robot})
        assert what == "what restrictions_planning 'robot_short | robot_small' forbids, of line 5"
    assert [f"{edge.source} {edge.target}" for edge in graph.edges] == ways


def test_a_place_that_is_forbidden_is_left_out_with_all_its_ways(tmp_path):
    graph, what = told(tmp_path, restricted(node="~task_mow"), robot={"task": "Mow"})
    assert graph.names == ("A", "B")
    assert {edge.target for edge in graph.edges} == {"A", "B"}
    assert what.startswith("what restrictions_planning '~task_mow' forbids")
    with pytest.raises(FormatError, match="all places are forbidden to this robot"):
        load(tmp_path, text("restrictions_planning: 'False'"))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (restricted("robot_short"), ":5: restrictions_planning of A to B, 'robot_short', cannot be judged: say what"),
        (restricted(node="robot_short"), "restrictions_planning of C, 'robot_short', cannot be judged"),
        (
            restricted("['short']"),
            ":5: restrictions_planning of A to B, \"['short']\", is no formula of conditions such",
        ),
        (
            restricted("robot_short &"),
            ":5: restrictions_planning of A to B, 'robot_short &', is no formula of conditions",
        ),
    ],
)
def test_a_restriction_that_cannot_be_judged_is_refused(tmp_path, content, message):
    with pytest.raises(FormatError) as caught:
        load(tmp_path, content)
    assert message in str(caught.value)


def test_a_restriction_of_the_drive_is_named_and_one_that_forbids_it_counts(tmp_path):
    graph, what = told(tmp_path, restricted(runtime="obstacleFree_1"))
    assert ("A", "B") in {(edge.source, edge.target) for edge in graph.edges}
    assert what == "restrictions_runtime 'obstacleFree_1', of line 5"
    graph, what = told(tmp_path, restricted(runtime="False"))
    assert ("A", "B") not in {(edge.source, edge.target) for edge in graph.edges}
    assert what == "what restrictions_runtime 'False' forbids, of line 5"


def test_keys_with_something_in_them_that_are_not_read_are_named(tmp_path):
    content = text().replace("action: move_base", "action: dock, fail_policy: fail, goal: {}")
    content = content.replace("xy_goal_tolerance: 0.3", "xy_goal_tolerance: 0.3, yaw_goal_tolerance: 0.1")
    _, what = told(tmp_path, content + "rosparams: {a: 1}\n")
    assert what == (
        "rosparams, of line 31; yaw_goal_tolerance '0.1', of line 11, line 25; action 'dock', of line 5, line 19; "
        "fail_policy 'fail', of line 5, line 19"
    )


def test_a_map_in_json_is_read_as_the_same_in_yaml(tmp_path):
    yaml = pytest.importorskip("yaml")
    content = text(frame="parent_frame: topo_map") + ROTATED
    in_json = json.dumps(yaml.safe_load(content))
    (tmp_path / "json").mkdir()
    assert load(tmp_path / "json", in_json) == load(tmp_path, content)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("node: \n\tWayPoint1\n\twaypoint:\n\t\t1.0,2.0,0.0,0.0,0.0,0.0,1.0\n\tedges:\n\t\tWayPoint2, move_base\n",
         "this is a text of nodes, waypoints and edges, as STRANDS's older .tmap files"),
        ("- meta: {map: m, node: A}\n  node: {name: A}\n", "this is a list of nodes, as STRANDS's older maps in YAML"),
    ],
)  # fmt: skip
def test_older_maps_are_named(tmp_path, content, message):
    with pytest.raises(FormatError) as caught:
        load(tmp_path, content)
    assert message in str(caught.value)


@pytest.mark.foreign("small inputs after public reports")
def test_a_way_that_a_reported_map_forbids_is_not_in_it(corpus):
    with pytest.warns(MapWarning, match="what restrictions_planning 'False' forbids, of line 22, line 104"):
        graph = load_graph(corpus / "reported" / "restr.yaml")
    assert [f"{edge.source}{edge.target}" for edge in graph.edges] == ["AB", "BC", "BA", "CB"]
