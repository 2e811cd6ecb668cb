"""Messages from plain data and back, over classes as ROS generates them."""

from __future__ import annotations

import array
import math
import sys
import types
import warnings

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm.ros2 import messages
from mdm.ros2.wire import WireError


class Meta(type):
    """The part of a generated class that knows its type support."""

    _TYPE_SUPPORT = object()

    @property
    def FULL(cls):  # noqa: N802 - as constants are named
        return 3


def declared(name, types, **extra):
    """Return a class with the methods that rosidl generates; nothing is checked, as there."""
    zeros = {"boolean": False, "float": 0.0, "double": 0.0, "string": "", "octet": b"\0"}

    def start(self):
        for field, kind in types.items():
            nested = classes.get(kind)
            empty = (
                []
                if kind.endswith((">", "]")) and not kind.startswith("string")
                else zeros.get(kind, "" if "string" in kind else 0)
            )
            setattr(self, field, nested() if nested else empty)

    body = {"__init__": start, "get_fields_and_field_types": classmethod(lambda _: dict(types)), **extra}
    return Meta(name, (), {**body, "__module__": f"robot_msgs.msg._{name.lower()}"})


classes = {}
classes["robot_msgs/Point"] = declared("Point", {"x": "double", "y": "float"})
classes["robot_msgs/All"] = declared(
    "All",
    {
        "point": "robot_msgs/Point",
        "points": "sequence<robot_msgs/Point>",
        "pair": "robot_msgs/Point[2]",
        "on": "boolean",
        "raw": "octet",
        "small": "int8",
        "large": "uint64",
        "name": "string",
        "short": "string<5>",
        "names": "sequence<string<5>, 2>",
        "ranges": "sequence<float>",
        "covariance": "double[3]",
        "codes": "sequence<octet>",
    },
)
Lamp = Meta(
    "Lamp",
    (),
    {"Request": declared("Lamp_Request", {"on": "boolean"}), "Response": declared("Lamp_Response", {"ok": "boolean"})},
)
Dock = Meta(
    "Dock",
    (),
    {
        "Goal": declared("Dock_Goal", {"at": "robot_msgs/Point"}),
        "Feedback": declared("Dock_Feedback", {"left": "float"}),
    },
)


class Broken(Meta):
    _TYPE_SUPPORT = None

    def __import_type_support__(cls):
        pass


@pytest.fixture(autouse=True)
def package(monkeypatch):
    """Give a package of messages, services and actions."""
    messages.interface.cache_clear()
    folders = {
        "robot_msgs": {},
        "robot_msgs.msg": {
            "Point": classes["robot_msgs/Point"],
            "All": classes["robot_msgs/All"],
            "Old": Broken("Old", (), {}),
        },
        "robot_msgs.srv": {"Lamp": Lamp},
        "robot_msgs.action": {"Dock": Dock},
    }
    for name, content in folders.items():
        module = types.ModuleType(name)
        module.__path__ = []
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    yield
    messages.interface.cache_clear()


ALL = "robot_msgs/msg/All"


def test_a_message_has_the_fields_that_are_given_and_defaults():
    made = messages.make(
        ALL, {"point": {"x": 1}, "points": [{"y": 2.5}, {}], "small": "FULL", "raw": 7, "names": ["a"]}
    )
    assert messages.plain(made) == {
        "point": {"x": 1.0, "y": 0.0},
        "points": [{"x": 0.0, "y": 2.5}, {"x": 0.0, "y": 0.0}],
        "pair": [],
        "on": False,
        "raw": 7,
        "small": 3,
        "large": 0,
        "name": "",
        "short": "",
        "names": ["a"],
        "ranges": [],
        "covariance": [],
        "codes": [],
    }
    assert type(made.point.x) is float
    assert made.raw == b"\x07"


def test_arrays_of_python_and_numpy_are_lists():
    ranges = array.array("f", [0.5, math.nan])
    made = messages.make(
        ALL, {"ranges": ranges, "covariance": np.arange(3), "large": np.uint64(5), "point": {"x": np.float32(0.5)}}
    )
    assert made.ranges is ranges
    assert made.covariance == [0.0, 1.0, 2.0]
    assert (type(made.large), type(made.point.x)) == (int, float)
    ready = np.ones(3)
    assert messages.make(ALL, {"covariance": ready}).covariance is ready


def test_services_and_actions_are_known_by_their_parts():
    assert type(messages.make("robot_msgs/srv/Lamp", {"on": True})) is Lamp.Request
    assert messages.fields("robot_msgs/srv/Lamp_Response") == {"ok": "boolean"}
    assert messages.make("robot_msgs/action/Dock", {"at": {"x": 2}}).at.x == 2.0
    assert messages.fields("robot_msgs/action/Dock_Feedback") == {"left": "float"}
    assert messages.interface("robot_msgs/action/Dock", "action") is Dock


@pytest.mark.parametrize(
    "values",
    [
        {"pont": {}},
        {"point": {"z": 1.0}},
        {"point": 3},
        {"point": {"x": "fast"}},
        {"point": {"x": True}},
        {"point": {"x": math.nan}},
        {"point": {"x": 10**400}},
        {"point": {"y": 1e39}},
        {"points": {"x": 1}},
        {"points": [{}, {"x": None}]},
        {"points": "abc"},
        {"on": 1},
        {"raw": 256},
        {"raw": b"ab"},
        {"small": 128},
        {"small": 1.0},
        {"small": "EMPTY"},
        {"large": -1},
        {"name": 5},
        {"name": "a\0b"},
        {"name": "\ud800"},
        {"short": "größe"},
        {"names": ["a", "b", "c"]},
        {"names": ["abcdef"]},
        {"covariance": [1.0, 2.0]},
        {"covariance": np.ones((3, 1))},
        {1: 2},
    ],
    ids=lambda values: repr(values)[:30],
)
def test_a_wrong_field_or_value_is_named(values):
    with refused(WireError):
        messages.make(ALL, values)


@pytest.mark.parametrize(
    ("kind", "whole"),
    [
        ("Twist", ""),
        ("robot_msgs/Point", ""),
        ("robot_msgs/msg/point", ""),
        ("", "msg"),
        ("robot_msgs/srv/Lamp", "msg"),
        ("robot_msgs/msg/Point", "action"),
        ("robot_msgs/srv/Lamp_Request", "srv"),
        ("rowbot_msgs/msg/Point", ""),
        ("robot_msgs/msg/Pont", ""),
        ("robot_msgs/srv/Lamp_Goal", ""),
        ("robot_msgs/msg/Old", ""),
    ],
)
def test_a_type_that_cannot_be_had_is_named(kind, whole):
    with refused(WireError):
        messages.interface(kind, whole)


def test_a_package_that_cannot_be_imported_says_why(tmp_path, monkeypatch):
    folder = tmp_path / "hurt_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text("raise RuntimeError('another Python')\n")
    monkeypatch.syspath_prepend(tmp_path)
    with refused(WireError):
        messages.interface("hurt_msgs/msg/Point")
    with refused(WireError):
        messages.interface("hurt_msgs/srv/Point")


def test_a_message_of_somebody_else_is_checked_and_keeps_nan():
    point = classes["robot_msgs/Point"]()
    point.x, point.y = 1, math.nan
    made = messages.filled(type(point), point)
    assert made is point
    assert (type(point.x), point.x) == (float, 1.0)
    assert math.isnan(point.y)
    whole = classes["robot_msgs/All"]()
    whole.pair, whole.covariance = [point, point], [0.0] * 3
    assert messages.filled(type(whole), whole).pair == [point, point]
    point.x = "fast"
    with refused(WireError):
        messages.filled(type(whole), whole)
    with refused(WireError):
        messages.filled(type(point), whole)


def test_a_long_message_is_told_shortly():
    made = messages.make(ALL, {"ranges": [0.5] * 1000, "name": "x" * 100, "codes": b"abc"})
    told = messages.plain(made, 2)
    assert told["ranges"] == [0.5, 0.5, "… of 1,000"]
    assert told["name"] == "x" * 20 + "…"
    assert told["codes"] == [97, 98, "… of 3"]
    assert messages.plain(made)["codes"] == [97, 98, 99]


numbers = st.floats(width=32, allow_nan=False)
points = st.fixed_dictionaries({"x": st.floats(allow_nan=False), "y": numbers})
texts = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"))


@given(
    st.fixed_dictionaries(
        {
            "point": points,
            "points": st.lists(points, max_size=3),
            "pair": st.lists(points, min_size=2, max_size=2),
            "on": st.booleans(),
            "raw": st.integers(0, 255),
            "small": st.integers(-128, 127),
            "large": st.integers(0, 2**64 - 1),
            "name": texts,
            "short": texts.filter(lambda text: len(text.encode()) <= 5),
            "names": st.lists(st.text("abc", max_size=5), max_size=2),
            "ranges": st.lists(numbers, max_size=5),
            "covariance": st.lists(st.floats(allow_nan=False), min_size=3, max_size=3),
            "codes": st.lists(st.integers(0, 255), max_size=5),
        }
    )
)
def test_what_is_made_is_told_again(values):
    made = messages.make(ALL, values)
    assert messages.plain(made) == values
    assert messages.plain(messages.filled(type(made), made)) == values


def test_what_a_type_needs_by_itself_warns_nobody(monkeypatch, recwarn):
    class Odd:
        _TYPE_SUPPORT = None

        @classmethod
        def __import_type_support__(cls):
            warnings.warn("module 'sre_parse' is deprecated", DeprecationWarning, stacklevel=2)
            cls._TYPE_SUPPORT = object()

    module = types.ModuleType("odd_msgs.msg")
    module.Odd = Odd
    for name in ("odd_msgs", "odd_msgs.msg"):
        monkeypatch.setitem(sys.modules, name, module)
    assert messages.interface("odd_msgs/msg/Odd") is Odd
    assert not recwarn
