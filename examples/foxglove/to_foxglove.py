"""Make a record of the patrol ready for Foxglove, with the floor, the robot and its way, in Foxglove's own types.

    mdm run ../patrol/patrol.toml --record run.mcap --virtual --seconds 120
    python to_foxglove.py run.mcap -o patrol.mcap

Open ``patrol.mcap`` in Foxglove and import ``patrol.layout.json``: the floor with the robot, what each level does over
time, states, faults, and decisions. All that the record has is copied; the types that are added are those that
https://docs.foxglove.dev/docs/sdk/schemas describes.
"""

from __future__ import annotations

import argparse
import base64
import json
import math
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer

from mdm.config.recorded import lay_out
from mdm.maps import load_map
from mdm.messages import Journey, PoseUpdate
from mdm.recording import Record
from mdm.stimuli import Said

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mdm.maps import Map

FRAME = "map"
UINT8 = 1
"""The number of this type, as `foxglove.PackedElementField` has it."""
WALL, FLOOR, UNKNOWN = (60, 64, 72, 255), (236, 238, 240, 255), (190, 194, 200, 255)
ROBOT, GOAL = {"r": 0.13, "g": 0.45, "b": 0.85, "a": 1.0}, {"r": 0.9, "g": 0.55, "b": 0.1, "a": 0.9}
INK = {"r": 0.2, "g": 0.2, "b": 0.2, "a": 1.0}
UPRIGHT = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
FOREVER = {"sec": 0, "nsec": 0}


def main() -> None:
    """Read a record, and write another file."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("record", help="a record of the patrol")
    parser.add_argument("-o", "--output", default="patrol.mcap", help="the file for Foxglove (patrol.mcap)")
    arguments = parser.parse_args()
    count = convert(Path(arguments.record), Path(arguments.output))
    print(f"{arguments.output}: {count:,} messages")


def convert(source: Path, target: Path) -> int:
    """Copy a record and add what Foxglove draws; return how many messages there are then."""
    record = Record(source)
    with tempfile.TemporaryDirectory() as folder:
        here = lay_out(record, folder)
        floor = load_map(here / "floor.xml", grid=here / "floor.yaml", labels=here / "labels.png")
    added = sorted(drawn(record, floor), key=lambda message: message[0])
    with target.open("wb") as stream:
        writer = Writer(stream)
        writer.start(library="mdm examples/foxglove")
        channels: dict[str, int] = {}
        count = 0
        for time, topic, kind, message in [*copied(source), *added]:
            if topic not in channels:
                schema = kind if isinstance(kind, tuple) else (kind, SCHEMAS[kind])
                number = writer.register_schema(schema[0], "jsonschema", json.dumps(schema[1]).encode())
                channels[topic] = writer.register_channel(topic, "json", number)
            data = message if isinstance(message, bytes) else json.dumps(message).encode()
            writer.add_message(channels[topic], time, data, time)
            count += 1
        writer.finish()  # type: ignore[no-untyped-call]
    return count


def copied(source: Path) -> Iterator[tuple[int, str, Any, Any]]:
    """Yield the messages of a record, with their schemas."""
    with source.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            yield message.log_time, channel.topic, (schema.name, json.loads(schema.data)), message.data


def drawn(record: Record, floor: Map) -> Iterator[tuple[int, str, str, Any]]:
    """Yield the floor, and poses and goals of the robot, in Foxglove's types."""
    begin = int(record.head["epoch"])
    yield begin, "/map", "foxglove.Grid", grid(begin, floor)
    yield begin, "/places", "foxglove.SceneUpdate", scene(begin, "places", texts=names(floor))
    way: list[dict[str, float]] = []
    for _, _, _, message in record.messages(["stimuli"]):
        if isinstance(message, Said) and isinstance(message.message, PoseUpdate):
            time, seen = message.time, message.message
            pose = pose_of(seen.x, seen.y, seen.yaw)
            way = [*way[-400:], {"x": seen.x, "y": seen.y, "z": 0.02}]
            yield (
                time,
                "/robot/pose",
                "foxglove.PoseInFrame",
                {"timestamp": stamp(time), "frame_id": FRAME, "pose": pose},
            )
            arrow = {
                "pose": pose,
                "shaft_length": 0.45,
                "shaft_diameter": 0.12,
                "head_length": 0.25,
                "head_diameter": 0.3,
            }
            yield (
                time,
                "/robot",
                "foxglove.SceneUpdate",
                scene(time, "robot", arrows=[arrow | {"color": ROBOT}], lines=[line(way)]),
            )
        elif isinstance(message, Said) and isinstance(message.message, Journey):
            time, journey = message.time, message.message
            node = None if journey.place is None else floor.graph.node(journey.place)
            marks = [] if node is None else [disc(node.goal.x, node.goal.y)]
            yield time, "/goal", "foxglove.SceneUpdate", scene(time, "goal", cylinders=marks)


def grid(time: int, floor: Map) -> dict[str, Any]:
    """Return the floor as a grid of colours, its lowest row first."""
    assert floor.grid is not None
    frame = floor.grid.frame
    cells = np.full((*frame.shape, 4), UNKNOWN, dtype=np.uint8)
    cells[floor.grid.free] = FLOOR
    cells[floor.grid.occupied] = WALL
    return {
        "timestamp": stamp(time),
        "frame_id": FRAME,
        "pose": pose_of(frame.x, frame.y, frame.yaw),
        "column_count": frame.columns,
        "cell_size": {"x": frame.resolution, "y": frame.resolution},
        "row_stride": 4 * frame.columns,
        "cell_stride": 4,
        "fields": [
            {"name": name, "offset": place, "type": UINT8}
            for place, name in enumerate(("red", "green", "blue", "alpha"))
        ],
        "data": base64.b64encode(cells[::-1].tobytes()).decode(),
    }


def scene(time: int, entity: str, **primitives: list[dict[str, Any]]) -> dict[str, Any]:
    """Return an update that has one entity, in place of what that was before."""
    kinds = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    facts = {"timestamp": stamp(time), "frame_id": FRAME, "id": entity, "lifetime": FOREVER, "frame_locked": False}
    shapes = {kind: primitives.get(kind, []) for kind in kinds}
    return {"deletions": [], "entities": [{**facts, "metadata": [], **shapes}]}


def names(floor: Map) -> list[dict[str, Any]]:
    """Return the names of the places, above them."""
    assert floor.graph is not None
    return [
        {
            "pose": pose_of(node.goal.x, node.goal.y, 0.0, z=0.3),
            "billboard": True,
            "font_size": 12.0,
            "scale_invariant": True,
            "color": INK,
            "text": node.name,
        }
        for node in floor.graph.nodes
    ]


def disc(x: float, y: float) -> dict[str, Any]:
    """Return a flat disc."""
    size = {"x": 0.6, "y": 0.6, "z": 0.05}
    return {"pose": pose_of(x, y, 0.0), "size": size, "bottom_scale": 1.0, "top_scale": 1.0, "color": GOAL}


def line(points: list[dict[str, float]]) -> dict[str, Any]:
    """Return a line through points."""
    return {
        "type": 0,  # a strip
        "pose": pose_of(0.0, 0.0, 0.0),
        "thickness": 0.05,
        "scale_invariant": False,
        "points": points,
        "color": ROBOT | {"a": 0.4},
        "colors": [],
        "indices": [],
    }


def pose_of(x: float, y: float, yaw: float, z: float = 0.0) -> dict[str, Any]:
    """Return a pose on the floor: the yaw as a quaternion."""
    turn = UPRIGHT | {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    return {"position": {"x": x, "y": y, "z": z}, "orientation": turn}


def stamp(time: int) -> dict[str, int]:
    """Return a time in nanoseconds as seconds and nanoseconds."""
    return {"sec": time // 1_000_000_000, "nsec": time % 1_000_000_000}


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _array(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


_NUMBER, _WHOLE, _TEXT, _TRUTH = ({"type": name} for name in ("number", "integer", "string", "boolean"))
_TIME = _object(sec=_WHOLE, nsec=_WHOLE)
_POINT = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
_POSE = _object(position=_POINT, orientation=_object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER))
_COLOUR = _object(r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_SHAPE = {"pose": _POSE, "color": _COLOUR}
SCHEMAS = {
    "foxglove.Grid": _object(
        timestamp=_TIME,
        frame_id=_TEXT,
        pose=_POSE,
        column_count=_WHOLE,
        cell_size=_object(x=_NUMBER, y=_NUMBER),
        row_stride=_WHOLE,
        cell_stride=_WHOLE,
        fields=_array(_object(name=_TEXT, offset=_WHOLE, type=_WHOLE)),
        data={"type": "string", "contentEncoding": "base64"},
    ),
    "foxglove.PoseInFrame": _object(timestamp=_TIME, frame_id=_TEXT, pose=_POSE),
    "foxglove.SceneUpdate": _object(
        deletions=_array(_object(timestamp=_TIME, type=_WHOLE, id=_TEXT)),
        entities=_array(
            _object(
                timestamp=_TIME,
                frame_id=_TEXT,
                id=_TEXT,
                lifetime=_TIME,
                frame_locked=_TRUTH,
                metadata=_array(_object(key=_TEXT, value=_TEXT)),
                arrows=_array(
                    _object(
                        **_SHAPE,
                        shaft_length=_NUMBER,
                        shaft_diameter=_NUMBER,
                        head_length=_NUMBER,
                        head_diameter=_NUMBER,
                    )
                ),
                cubes=_array(_object(**_SHAPE, size=_POINT)),
                spheres=_array(_object(**_SHAPE, size=_POINT)),
                cylinders=_array(_object(**_SHAPE, size=_POINT, bottom_scale=_NUMBER, top_scale=_NUMBER)),
                lines=_array(
                    _object(
                        **_SHAPE,
                        type=_WHOLE,
                        thickness=_NUMBER,
                        scale_invariant=_TRUTH,
                        points=_array(_POINT),
                        colors=_array(_COLOUR),
                        indices=_array(_WHOLE),
                    )
                ),
                triangles=_array(_object(**_SHAPE)),
                texts=_array(
                    _object(**_SHAPE, billboard=_TRUTH, font_size=_NUMBER, scale_invariant=_TRUTH, text=_TEXT)
                ),
                models=_array(_object(pose=_POSE)),
            )
        ),
    ),
}

if __name__ == "__main__":
    main()
