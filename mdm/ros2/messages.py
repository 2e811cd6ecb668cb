"""Messages of ROS 2 and plain data: made from it with every field checked, and told as it.

The generated classes check nothing: there ``linear.x = 1`` is sent as 5e-324, and 300 in an ``int8`` as 44.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from numbers import Integral, Real
from typing import Any

from mdm.ros2.wire import WireError, near, parts_of

__all__ = ["fields", "filled", "interface", "make", "plain"]

_ARRAY = cache(re.compile(r"sequence<(?P<inner>.+?)(?:, (?P<most>\d+))?>|(?P<element>.+)\[(?P<length>\d+)\]").fullmatch)
_TEXT = cache(re.compile(r"w?string(?:<(?P<most>\d+)>)?").fullmatch)
_FIELDS: Any = cache(lambda kind: kind.get_fields_and_field_types())  # which copies them each time
_CODES = {"float": "f", "double": "d", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i"}
_CODES |= {"uint32": "I", "int64": "lq", "uint64": "LQ"}  # of elements, in arrays of Python and numpy
_RANGES = {f"int{bits}": range(-(2 ** (bits - 1)), 2 ** (bits - 1)) for bits in (8, 16, 32, 64)}
_RANGES |= {f"uint{bits}": range(2**bits) for bits in (8, 16, 32, 64)} | {"octet": range(256)}
_LARGEST = (2 - 2**-23) * 2.0**127  # of the numbers of 32 bits


@cache
def interface(kind: str, whole: str = "") -> Any:
    """Return the class of a message, of a service's request, or of an action's goal.

    Args:
        kind: The type, such as ``geometry_msgs/msg/Twist``; ``std_srvs/srv/SetBool_Response`` names the other part, and
            so do ``_Result`` and ``_Feedback`` of an action.
        whole: ``msg``, ``srv`` or ``action``, where the type has to be one of these, and is returned as a whole.

    Raises:
        WireError: If its name has another form, there is no such package or type, or its code cannot be loaded.
    """
    package, folder, name, part = parts_of(kind, whole)
    try:
        module = import_module(f"{package}.{folder}")
        loaded = getattr(module, name, None)
        if loaded is not None and getattr(loaded, "_TYPE_SUPPORT", None) is None:
            with warnings.catch_warnings(action="ignore"):  # about what ROS' own generators need
                loaded.__import_type_support__()
            if getattr(loaded, "_TYPE_SUPPORT", None) is None:
                raise ImportError("its library is not there")
    except Exception as error:
        if isinstance(error, ModuleNotFoundError) and error.name in {package, f"{package}.{folder}"}:
            way = "install it, or source the workspace that has it (source install/setup.bash)"
            raise WireError(f"{kind}: there is no package {error.name!r} here: {way}") from None
        way = f"build {package!r} for this Python and this distribution of ROS 2, and source it"
        raise WireError(f"{kind} cannot be loaded: {error}: {way}") from error
    part = part or ("" if whole else {"msg": "", "srv": "Request", "action": "Goal"}[folder])
    made = getattr(loaded, part, None) if part else loaded
    if made is None:
        raise WireError(f"{kind}: {package}.{folder} has no {kind.rpartition('/')[2]!r}{near(name, dir(module))}")
    return made


def fields(kind: str) -> Mapping[str, str]:
    """Return the type of each field of an `interface`, by name: ``{"header": "std_msgs/Header", …}``."""
    known: Mapping[str, str] = interface(kind).get_fields_and_field_types()
    return known


def make(kind: str, values: Mapping[str, Any]) -> Any:
    """Return a message, a request or a goal with these fields: see `filled`."""
    return filled(interface(kind), values)


def filled(kind: Any, values: Any) -> Any:
    """Return a message of a class with all fields checked, from a table of some, or from one that somebody has made.

    Other fields have their default. The name of a constant of a message stands for its number. A table has no NaN.

    Raises:
        WireError: If a field is none of the type's, or its value does not fit: names both.
    """
    try:
        return _filled(kind, values, "")
    except ValueError as error:
        raise WireError(f"{kind.__module__.partition('.')[0]}/{kind.__name__}: {error}") from None


def plain(value: Any, most: int | None = None) -> Any:
    """Return a message, or a value in one, as tables, lists, texts and numbers.

    With ``most``, so many elements of each list are told, and ten times as many characters of each text.
    """
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name), most) for name in value.get_fields_and_field_types()}
    if isinstance(value, str):
        return value if most is None or len(value) <= 10 * most else f"{value[: 10 * most]}…"
    if isinstance(value, bytes) or not hasattr(value, "__len__"):
        return value[0] if isinstance(value, bytes) else value.item() if hasattr(value, "item") else value
    told = [plain(each, most) for each in value[:most]]
    return told if len(told) == len(value) else [*told, f"… of {len(value):,}"]


def _filled(kind: Any, values: Any, place: str) -> Any:
    known, made = _FIELDS(kind), isinstance(values, kind)
    message = values if made else kind()
    if made:  # by somebody; NaN stays
        given = {name: getattr(message, name) for name in known}
        values = {name: each for name, each in given.items() if not (isinstance(each, float) and known[name] in _CODES)}
    if not isinstance(values, Mapping):
        raise _misfit(place or "it", kind.__name__, values)
    for name, value in values.items():
        there = f"{place}.{name}" if place else str(name)
        if name not in known:
            raise ValueError(f"there is no field {there!r}{near(str(name), known)}")
        fitting = _value(known[name], value, there, kind)
        if not made or fitting is not value:
            setattr(message, name, fitting)
    return message


def _value(kind: str, value: Any, place: str, owner: Any) -> Any:
    """Return a value as a field of a type needs it; ``owner`` is the message's class, whose constants have names."""
    if (array := _ARRAY(kind)) is not None:
        return _elements(array, value, place, owner)
    if "/" in kind:
        return _filled(interface(kind.replace("/", "/msg/")), value, place)
    fitting = None
    if (text := _TEXT(kind)) is not None:
        coded = value.encode(errors="replace") if isinstance(value, str) else b""
        whole = coded.decode() == value and b"\0" not in coded
        fitting = value if whole and len(coded) <= int(text["most"] or len(coded)) else None
    elif kind == "boolean" or isinstance(value, bool):
        fitting = value if kind == "boolean" and isinstance(value, bool) else None
    elif kind in _RANGES:
        number = getattr(owner, value, value) if isinstance(value, str) and value.isupper() else value
        octet, number = kind == "octet", number[0] if isinstance(number, bytes) and len(number) == 1 else number
        if isinstance(number, Integral) and int(number) in _RANGES[kind] and (octet or not isinstance(value, bytes)):
            fitting = bytes([int(number)]) if octet else int(number)
    elif isinstance(value, Real):
        number = float(value) if not isinstance(value, Integral) or abs(int(value)) < 2**1023 else math.nan
        fits = kind == "double" or math.isinf(number) or abs(number) <= _LARGEST
        fitting = number if fits and not math.isnan(number) else None
    if fitting is None:
        raise _misfit(place, kind, value)
    return fitting


def _elements(array: re.Match[str], value: Any, place: str, owner: Any) -> Any:
    if isinstance(value, str | Mapping) or not (isinstance(value, Sequence) or getattr(value, "ndim", 0) == 1):
        raise _misfit(place, array[0], value)
    least, most = int(array["length"] or 0), int(array["length"] or array["most"] or len(value))
    if not least <= len(value) <= most:
        raise ValueError(f"{place} is of the type {array[0]}, and cannot have {len(value):,} elements")
    kind = array["inner"] or array["element"]
    code: str = getattr(value, "typecode", "") or getattr(getattr(value, "dtype", None), "char", " ")
    if code in _CODES.get(kind, ""):
        return value
    return [_value(kind, each, f"{place}[{index}]", owner) for index, each in enumerate(value)]


def _misfit(place: str, kind: str, value: Any) -> ValueError:
    return ValueError(f"{place} is of the type {kind}, and cannot be {value!r:.80}")
