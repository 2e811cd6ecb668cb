"""Conditions on messages: what they hold for, against an evaluator of their own, and what is refused."""

from __future__ import annotations

import math
import operator
from array import array
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from ros2.stand_in import TYPES
from sentences import refused

from mdm.errors import ConfigError, FormatError
from mdm.ros2.conditions import Condition

FINITE = st.floats(allow_nan=False, allow_infinity=False, width=32)
PLAIN = st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(max_size=3)
NAMES = st.sampled_from(["data", "pose", "x", "ranges", "not_data", "a1"])
COMPARED = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}


@st.composite
def messages(draw, depth=3):
    """Return a message of random fields, nested, with sequences."""
    fields = {}
    for name in draw(st.sets(NAMES, max_size=3)):
        of = draw(st.integers(0, 2)) if depth else 0
        if of == 0:
            fields[name] = draw(PLAIN)
        elif of == 1:
            fields[name] = draw(st.lists(PLAIN if draw(st.booleans()) else messages(depth=depth - 1), max_size=3))
        else:
            fields[name] = draw(messages(depth=depth - 1))
    return SimpleNamespace(**fields)


ABSENT = object()


def found(message, steps):
    """Return the value at the end of steps; absent where there is none."""
    for step in steps:
        if isinstance(step, int):
            if not isinstance(message, list) or not -len(message) <= step < len(message):
                return ABSENT
            message = message[step]
        else:
            if not isinstance(message, SimpleNamespace) or step not in vars(message):
                return ABSENT
            message = vars(message)[step]
    return message


def is_number(value):
    return type(value) in {int, float} and not math.isnan(value)


@st.composite
def paths(draw):
    steps = [draw(NAMES), *draw(st.lists(NAMES | st.integers(-3, 3), max_size=3))]
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps)
    return text[1:], steps


@given(paths(), st.sampled_from(list(COMPARED)), FINITE, st.lists(messages(), max_size=5))
def test_a_number_is_compared_and_all_else_is_unknown(path, sign, bound, several):
    text, steps = path
    condition = Condition(f"{text} {sign} {bound!r}")
    assert (condition.path, str(condition)) == (text, f"{text} {sign} {bound!r}")
    for message in several:
        value = found(message, steps)
        assert condition(message) is (COMPARED[sign](value, bound) if is_number(value) else None)


@given(paths(), st.booleans(), st.booleans() | st.integers() | FINITE | st.text(), messages())
def test_a_constant_is_equal_only_to_a_value_of_its_own_kind(path, equal, constant, message):
    text, steps = path
    if isinstance(constant, str):
        if "'" in constant and '"' in constant:
            constant = constant.replace('"', "")
        written = f'"{constant}"' if "'" in constant else f"'{constant}'"
    else:
        written = str(constant).lower()
    if type(constant) is int and abs(constant) >= 10**99:
        return
    condition = Condition(f"{text}{'==' if equal else '!='}{written}")
    value = found(message, steps)
    if isinstance(constant, bool) or isinstance(value, bool):
        same = isinstance(constant, bool) and isinstance(value, bool)
    elif isinstance(constant, str):
        same = isinstance(value, str)
    else:
        same = is_number(value)
    assert condition(message) is ((value == constant) is equal if same else None)


@given(paths(), messages())
def test_a_field_alone_is_a_truth_value(path, message):
    text, steps = path
    value = found(message, steps)
    known = isinstance(value, bool)
    assert Condition(text)(message) is (value if known else None)
    assert Condition(f"not {text}")(message) is (not value if known else None)


@given(st.lists(FINITE | st.just(math.nan)), FINITE, FINITE)
def test_between_two_thresholds_the_last_one_that_was_passed_counts(numbers, one, other):
    low, high = min(one, other), max(one, other)
    condition = Condition(f"x < {low!r} until > {high!r}")
    passed = None
    for number in numbers:
        if not math.isnan(number):
            passed = True if number < low else False if number > high else passed
        assert condition(SimpleNamespace(x=number)) is (None if math.isnan(number) else passed)
    condition.begin()
    if low < (middle := low / 2 + high / 2) < high:
        assert condition(SimpleNamespace(x=middle)) is None


@pytest.mark.parametrize(
    ("text", "value", "expected"),
    [
        ("x < 1", np.float32(0.5), True),
        ("x == 2", b"\x02", True),
        ("x >= 3", b"\x02", False),
        ("x == 2", b"\x02\x02", None),
        ("x", np.bool_(True), True),
        ("x[-1] == 1", array("f", [3, 1]), True),
        ("x[0] < 1", np.array([0.5, math.nan]), True),
        ("x[1] < 1", np.array([0.5, math.nan]), None),
        ("x[1] < 1", array("d"), None),
        ("x == 9007199254740993", 9007199254740993, True),
        ("x != 9007199254740993", 9007199254740992, True),
        ("x < 1", math.inf, False),
        ("x == ''", "", True),
        ("x.upper", "text", None),
        ("x", 1, None),
        ("x == 1", True, None),
    ],
)
def test_values_as_rclpy_gives_them(text, value, expected):
    assert Condition(text)(SimpleNamespace(x=value)) is expected


@pytest.mark.parametrize(
    "text",
    [
        "",
        " 3 < x",
        "x < y",
        "x < 0.2 until < 0.1",
        "x > 1 and y < 2",
        "x y",
        "x = 3",
        "x == nan",
        "x == 'open",
        "x == true false",
        "x[a] < 3",
        "x [0] < 3",
        "_x < 3",
        "x.__class__",
        "x()",
        "not x == 3",
        "x < 1e999",
        "x == 1e999",
        "x == 3.4.5",
    ],
)
def test_other_texts_are_refused(text):
    with refused(FormatError):
        Condition(text)


@given(st.text("xdata.[]0123<>=!'\" -enotuilrfs", max_size=20))
def test_a_text_is_taken_or_refused(text):
    try:
        condition = Condition(text)
    except FormatError as error:
        assert 1 <= error.column <= len(text) + 1
    else:
        condition(SimpleNamespace(x=0.5, data=True))


BATTERY, POSE = "sensor_msgs/msg/BatteryState", "geometry_msgs/msg/PoseWithCovarianceStamped"


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("percentage < 0.2 until > 0.3", BATTERY),
        ("not present", BATTERY),
        ("header.frame_id == 'base'", BATTERY),
        ("cell_voltage[-1] > 3.2", BATTERY),
        ("pose.covariance[35] < 1", POSE),
        ("pose.pose.position.x >= 1.5", POSE),
        ("status[0].level >= 1", "diagnostic_msgs/msg/DiagnosticArray"),
        ("status[0].values[1].key != 'x'", "diagnostic_msgs/msg/DiagnosticArray"),
    ],
)
def test_fields_that_a_type_has(text, kind):
    Condition(text).check(kind, TYPES.__getitem__)


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("percentag < 0.2", BATTERY),
        ("percentage", BATTERY),
        ("present > 0", BATTERY),
        ("header.stamp < 3", BATTERY),
        ("cell_voltage < 3", BATTERY),
        ("voltage[0] < 3", BATTERY),
        ("voltage.x < 3", BATTERY),
        ("header.frame_id == 3", BATTERY),
        ("pose.covariance[36] < 1", POSE),
        ("pose.covariance[-37] < 1", POSE),
        ("pose.covariance.x < 1", POSE),
        ("pose.pose.positon.x < 1", POSE),
    ],
)
def test_fields_that_it_has_not(text, kind):
    with refused(ConfigError):
        Condition(text).check(kind, TYPES.__getitem__)
