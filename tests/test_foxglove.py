"""The example for Foxglove: its messages are of Foxglove's published types, and its layout names what the file has."""

from __future__ import annotations

import base64
import json
import math
import re
from datetime import UTC, datetime

import in_process
import numpy as np
import pytest
from mcap.reader import make_reader
from places import EXAMPLES

from mdm.maps import load_map

HERE, PATROL = EXAMPLES / "foxglove", EXAMPLES / "patrol"
json_format = pytest.importorskip("google.protobuf.json_format")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The file for Foxglove of twenty seconds of the patrol: its messages by topic, and the schema of each."""
    pytest.importorskip("navground")
    folder = tmp_path_factory.mktemp("foxglove")
    record, target = folder / "run.mcap", folder / "patrol.mcap"
    for done in (
        in_process.mdm("run", PATROL / "patrol.toml", "--record", record, "--virtual", "--seconds", "20"),
        in_process.script(HERE / "to_foxglove.py", record, "-o", target),
    ):
        assert done.status == 0, done.errors
    messages, schemas = {}, {}
    with target.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            messages.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
            schemas[channel.topic] = schema.name, json.loads(schema.data)
    return messages, schemas


def published(kind):
    module = pytest.importorskip(f"foxglove_schemas_protobuf.{kind}_pb2")
    return getattr(module, kind)


def as_protobuf(value):
    """The same with times as protobuf's JSON has them."""
    if isinstance(value, dict):
        if value.keys() == {"sec", "nsec"}:
            moment = datetime.fromtimestamp(value["sec"], UTC)
            return f"{moment:%Y-%m-%dT%H:%M:%S}.{value['nsec']:09d}Z"
        return {key: "0s" if key == "lifetime" else as_protobuf(each) for key, each in value.items()}
    return [as_protobuf(each) for each in value] if isinstance(value, list) else value


def test_what_is_drawn_is_of_the_published_types(made):
    messages, schemas = made
    drawn = {topic: name.removeprefix("foxglove.") for topic, (name, _) in schemas.items() if "foxglove." in name}
    assert drawn == {
        "/map": "Grid",
        "/places": "SceneUpdate",
        "/robot": "SceneUpdate",
        "/robot/pose": "PoseInFrame",
        "/goal": "SceneUpdate",
    }
    for topic, kind in drawn.items():
        declared = published(kind).DESCRIPTOR.fields_by_name
        assert schemas[topic][1]["properties"].keys() == set(declared)
        for _, message in messages[topic]:
            json_format.ParseDict(as_protobuf(message), published(kind)())  # which takes no unknown field or kind
            assert message.keys() == set(declared)


def test_the_grid_is_the_floor_and_the_robot_is_on_it(made):
    messages, _ = made
    floor = load_map(PATROL / "floor.xml", grid=PATROL / "floor.yaml", labels=PATROL / "labels.png")
    ((_, grid),) = messages["/map"]
    cells = np.frombuffer(base64.b64decode(grid["data"]), np.uint8).reshape(-1, grid["column_count"], 4)
    assert cells.shape[:2] == floor.grid.frame.shape
    colours = set()
    for _, seen in messages["/robot/pose"]:
        position, turn = seen["pose"]["position"], seen["pose"]["orientation"]
        assert math.hypot(turn["z"], turn["w"]) == pytest.approx(1.0)
        row = math.floor((position["y"] - grid["pose"]["position"]["y"]) / grid["cell_size"]["y"])
        column = math.floor((position["x"] - grid["pose"]["position"]["x"]) / grid["cell_size"]["x"])
        assert floor.grid.free[floor.grid.frame.cell(position["x"], position["y"])]
        colours.add(tuple(cells[row, column]))
    assert len(colours) == 1  # that of the floor
    wall = np.argwhere(floor.grid.occupied)[0]
    assert tuple(cells[len(cells) - 1 - wall[0], wall[1]]) not in colours


def test_the_layout_names_topics_and_fields_that_there_are(made):
    messages, schemas = made
    layout = json.loads((HERE / "patrol.layout.json").read_text())
    panels = layout["configById"]
    text = json.dumps(layout["layout"])
    assert all(f'"{name}"' in text for name in panels)
    assert panels["3D!floor"]["topics"].keys() == {topic for topic in messages if topic.startswith("/")}
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    assert paths
    for path in paths:
        topic, ensemble, field = re.fullmatch(r'(\w+)\{ensemble=="([\w/]+)"\}\.(\w+)', path).groups()
        assert field in schemas[topic][1]["properties"]
        assert any(message["ensemble"] == ensemble for _, message in messages[topic]), path
    for panel in panels.values():
        if "topicPath" in panel:
            assert panel["topicPath"] in {"decisions", "faults"}
