"""Options are declared once: a struct checks them, and its typed dictionary for type checkers is equal to it."""

from __future__ import annotations

from fractions import Fraction
from typing import Annotated, Any, Literal, get_type_hints

import msgspec
import numpy as np
import numpy.typing as npt
import pytest
import values
from sentences import refused

import mdm
from mdm import ConfigError
from mdm.actors.options import DriveOptions, DriveSettings
from mdm.options import Options, Seconds

DECLARED = [*[pair for _, *pair in values.takers()], (DriveOptions, DriveSettings)]

OBJECTS = {
    "ceilings": "structs of their own",
    "channels": "any iterable but a text",
    "communication": "of a protocol",
    "drive": "a struct, or what stands for it: drive_of",
    "false_negative": "a symbol, which the model knows",
    "group": "any object",
    "initial_belief": "an array, or a symbol, which the model knows",
    "rewards": "an array",
    "state": "a path",
    "tracker": "of a protocol",
}
"""Options that who takes them checks."""


class Two(Options, frozen=True, kw_only=True):
    colour: Literal["red", "blue"] = "red"
    size: Annotated[int, msgspec.Meta(ge=1, extra={"unit": "metres"})] = 1
    lasts: Seconds | None = None
    thing: Any = None


@pytest.mark.parametrize(
    ("option", "words"),
    [("color", "did you mean 'colour'?"), ("weight", "there are colour, size"), ("Size", "did you mean 'size'?")],
)
def test_an_unknown_option_is_told_with_those_that_are_near(option, words):
    with refused(ConfigError) as caught:
        Two.from_keywords({"size": 2, option: 3})
    assert words in str(caught.value)
    assert caught.value.key == option


@pytest.mark.parametrize(
    ("given", "key"),
    [
        *(({"lasts": value}, "lasts") for value in (0, -1.0, float("nan"), float("inf"), "long", True)),
        *(({"size": value}, "size") for value in (0, 1.5, None)),
        *(({"colour": value}, "colour") for value in ("green", 3)),
    ],
)
def test_a_value_that_does_not_fit_is_refused_with_its_unit_however_it_is_given(given, key):
    with refused(ConfigError) as caught:
        Two.from_keywords(given, below="team.")
    assert caught.value.key == f"team.{key}"
    with pytest.raises(ConfigError) as direct:
        Two(**given)
    assert direct.value.message == caught.value.message
    assert all(word in caught.value.message for word in {"lasts": ["seconds"], "size": ["metres"]}.get(key, ["red"]))


def test_numbers_of_other_types_become_python_s_and_objects_stay():
    thing = np.ones(2)
    options = Two.from_keywords({"size": np.int64(3), "lasts": Fraction(1, 2), "thing": thing})
    assert (options.size, options.lasts) == (3, 0.5)
    assert [type(options.size), type(options.lasts)] == [int, float]
    assert options.thing is thing
    assert type(Two(lasts=2).lasts) is float  # type: ignore[call-arg] # of a class in a test
    assert options.as_arguments(Two) == {"colour": "red", "size": 3, "lasts": 0.5, "thing": thing}


@pytest.mark.parametrize(("keywords", "struct"), DECLARED)
def test_a_typed_dictionary_is_equal_to_its_struct(keywords, struct):
    names = {name: getattr(mdm.team, name) for name in mdm.team.__all__} | {
        "npt": npt,
        "Symbol": mdm.models.space.Symbol,
    }
    names |= {"Information": mdm.beliefs.Information, "Drive": mdm.actors.Drive}
    hints, fields = get_type_hints(keywords, localns=names), get_type_hints(struct)
    assert {*hints} == {*struct.__struct_fields__}
    required = {field.name for field in msgspec.structs.fields(struct) if field.required}
    assert keywords.__required_keys__ == required
    for name, kind in hints.items():
        if fields[name] is not Any:
            assert kind == fields[name], name
        else:
            assert name in OBJECTS, name


@pytest.mark.parametrize("given", [np.True_, np.array(3), object()])
def test_an_object_of_another_kind_is_refused(given):
    with pytest.raises(mdm.ConfigError, match="lasts"):
        Two(lasts=given)  # type: ignore[call-arg] # of a class in a test
    with pytest.raises(mdm.ConfigError, match="actions: "):
        mdm.team.Placement(actions=given)
