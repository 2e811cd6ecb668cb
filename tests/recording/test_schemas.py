from __future__ import annotations

import json
import types
import typing
from typing import Any, Literal, get_args, get_origin

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from records import encoded

from mdm import messages, stimuli
from mdm.recording import schemas
from mdm.recording.reader import Decoding
from mdm.team import Committed

STRUCTS = [
    *(
        kind
        for name in messages.__all__
        if isinstance(kind := getattr(messages, name), type) and issubclass(kind, msgspec.Struct)
    ),
    *get_args(stimuli.Stimulus),
    Committed,
]

SCALARS = {"boolean": bool, "string": str, "integer": int, "number": float}


def columns(schema, at="$"):
    """Return the fields that a strict reader sees, by path; raise for what it does not take.

    The rules are those that are known of Foxglove's reader: objects with properties, one plain type a field, arrays of
    plain types or of objects, and nothing else.
    """
    assert schema["type"] == "object", at
    found = {}
    for name, field in schema["properties"].items():
        place, kind = f"{at}.{name}", field["type"]
        assert isinstance(kind, str), place
        assert set(field) <= {"type", "items", "properties"}, place
        if kind == "array":
            items = field["items"]
            assert items["type"] in {*SCALARS, "object"}, place
            found |= columns(items, f"{place}[]") if items["type"] == "object" else {f"{place}[]": items["type"]}
        elif kind == "object":
            found |= columns(field, place)
        else:
            assert kind in SCALARS, place
            found[place] = kind
    return found


def fits(value, schema):
    """Whether a value has the types of a schema; a missing one, null, has any."""
    if value is None:
        return True
    kind = schema["type"]
    if kind == "object":
        return isinstance(value, dict) and all(
            fits(value.get(name), field) for name, field in schema["properties"].items()
        )
    if kind == "array":
        return isinstance(value, list) and all(fits(each, schema["items"]) for each in value)
    if kind == "number":
        return isinstance(value, int | float) and not isinstance(value, bool)
    return type(value) is SCALARS[kind]


def values(kind):
    """Return a strategy for the values of a type."""
    origin, parts = get_origin(kind), get_args(kind)
    if kind is Any:
        return st.one_of(st.integers(0, 9), st.lists(st.floats(0, 1), max_size=3))
    if origin is Literal:
        return st.sampled_from(parts)
    if origin in {typing.Union, types.UnionType}:
        return st.one_of(*map(values, parts))
    if origin is np.ndarray:
        return st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=4).map(np.array)
    if origin is tuple:
        return (
            st.lists(values(parts[0]), max_size=3).map(tuple)
            if parts[-1] is Ellipsis
            else st.tuples(*map(values, parts))
        )
    if origin is dict:
        return st.dictionaries(*map(values, parts), max_size=3)
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return st.builds(kind, **{name: values(hint) for name, hint in typing.get_type_hints(kind).items()})
    return {
        int: st.integers(0, 2**53),
        float: st.floats(allow_nan=False, allow_infinity=False),
        bool: st.booleans(),
        bytes: st.binary(max_size=5),
        str: st.text(max_size=5),
        type(None): st.none(),
    }[kind]


def plain(message):
    return json.loads(encoded(message))


@pytest.mark.parametrize("kind", STRUCTS, ids=lambda kind: kind.__name__)
@settings(max_examples=10)
@given(data=st.data())
def test_each_struct_has_a_plain_schema_which_its_messages_fit(kind, data):
    schema = json.loads(json.dumps(schemas.schema(kind)))
    assert columns(schema)["$.time" if "time" in kind.__struct_fields__ else "$.kind"]
    assert fits(plain(data.draw(values(kind))), schema)


@pytest.mark.parametrize(
    "kind", [each for each in STRUCTS if each is not messages.Cause], ids=lambda each: each.__name__
)
@settings(max_examples=10)
@given(data=st.data())
def test_each_message_comes_back(kind, data):
    message = data.draw(values(kind))
    decoding = Decoding({schemas.name(Committed): Committed})
    name = schemas.name(stimuli.Stimulus if kind in get_args(stimuli.Stimulus) else kind)
    restored = decoding.decode(name, encoded(message))
    assert type(restored) is kind
    assert plain(restored) == plain(message)


@given(message=values(stimuli.Stimulus))
def test_all_stimuli_fit_one_schema(message):
    schema = schemas.schema(stimuli.Stimulus)
    assert columns(schema)["$.kind"] == "string"
    assert fits(plain(message), schema)
    assert schemas.name(stimuli.Stimulus) == schema["title"] == "mdm.Stimulus"


def test_what_can_be_plotted_is_in_the_schemas():
    assert columns(schemas.schema(messages.Belief)) == {"$.time": "integer", "$.probabilities[]": "number"}
    assert columns(schemas.schema(messages.Mode)) == {
        "$.time": "integer",
        "$.ensemble": "string",
        "$.mode": "string",
        "$.since": "integer",
        "$.causes[].kind": "string",
        "$.causes[].detail": "string",
        "$.causes[].since": "integer",
    }
    decision = columns(schemas.schema(messages.Decision))
    assert decision["$.belief[]"] == decision["$.reward"] == "number"
    assert decision["$.state"] == "integer"
    assert "$.observation" not in decision  # a number or several


class Odd(messages.Message, frozen=True, gc=False):
    many: list[list[int]]
    either: int | str
    table: dict[str, int]
    number: Literal[1, 2]
    pair: tuple[int, str]
    words: list[Literal["a", "b"]]
    other: object


def test_what_has_no_plain_type_is_left_out():
    assert columns(schemas.schema(Odd)) == {"$.time": "integer", "$.words[]": "string"}


class First(msgspec.Struct, tag="first"):
    value: int
    same: str


class Second(msgspec.Struct, tag="second"):
    value: str
    same: str | None = None


def test_fields_that_differ_between_structs_of_a_union_are_left_out():
    assert schemas.schema(First | Second)["properties"] == {"type": {"type": "string"}, "same": {"type": "string"}}
