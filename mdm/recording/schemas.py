"""JSON schemas of messages, as plain as Foxglove's reader takes them.

It wants an object at the root and one plain type a field: no references, unions, null, tuples or arrays of arrays. A
schema is therefore a projection: an optional field has its type, a choice of words is a string, an array of numbers is
one, and a field without a plain type is left out: it is in the messages all the same.
"""

from __future__ import annotations

import functools
import types
import typing
from typing import Any, Literal, Union, get_args, get_origin

import msgspec
import numpy as np

_PLAIN = {bool: "boolean", int: "integer", float: "number", str: "string"}


def name(kind: Any) -> str:
    """Return the name of a type's schema, such as ``mdm.Decision``; of a union that of its classes' base."""
    if isinstance(kind, type):
        return f"mdm.{kind.__name__}"
    return f"mdm.{get_args(kind)[0].__base__.__name__.lstrip('_')}"


@functools.cache
def schema(kind: Any) -> dict[str, Any]:
    """Return the schema of a struct, or of a union of structs with a tag: one object with the fields of all.

    A field of which two structs of a union have different types is left out. All records have the same one.
    """
    properties: dict[str, Any] = {}
    unlike = set()
    for struct in (kind,) if isinstance(kind, type) else get_args(kind):
        for field, own in _object(struct)["properties"].items():
            if properties.setdefault(field, own) != own:
                unlike.add(field)
    return {
        "title": name(kind),
        "type": "object",
        "properties": {field: own for field, own in properties.items() if field not in unlike},
    }


def _object(struct: type[msgspec.Struct]) -> dict[str, Any]:
    config = struct.__struct_config__
    properties: dict[str, Any] = {}
    if config.tag is not None and config.tag_field is not None:
        properties[config.tag_field] = {"type": "string"}
    hints = typing.get_type_hints(struct)
    for field in msgspec.structs.fields(struct):
        own = _field(hints[field.name])
        if own is not None:
            properties[field.encode_name] = own
    return {"type": "object", "properties": properties}


def _field(kind: Any) -> dict[str, Any] | None:
    """Return the schema of a field, None where it has no plain one."""
    if get_origin(kind) in {Union, types.UnionType}:
        others = [each for each in get_args(kind) if each is not type(None)]
        kind = others[0] if len(others) == 1 else None
    origin, parts = get_origin(kind) or kind, get_args(kind)
    if origin is np.ndarray:
        return {"type": "array", "items": {"type": "number"}}
    if origin in {tuple, list}:
        alike = get_origin(kind) is list or (len(parts) == 2 and parts[1] is Ellipsis)
        own = _field(parts[0]) if alike else None
        return None if own is None or own["type"] == "array" else {"type": "array", "items": own}
    if kind in _PLAIN:
        return {"type": _PLAIN[kind]}
    if origin is Literal and all(isinstance(value, str) for value in parts):
        return {"type": "string"}
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return _object(kind)
    return None
