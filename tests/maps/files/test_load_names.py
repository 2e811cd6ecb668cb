"""The colours of places."""

from __future__ import annotations

import pytest

from mdm.errors import FormatError
from mdm.maps.files.load import load_colours


def load(tmp_path, text):
    (tmp_path / "names.yaml").write_text(text)
    return load_colours(tmp_path / "names.yaml")


def test_numbers_are_decimal_or_hexadecimal_and_may_have_a_sign(tmp_path):
    assert load(tmp_path, "a: 255\nb: 0xFFB400\nc: 0\nd: -16777216\ne: 4294967295") == {
        "a": 255,
        "b": 16757760,
        "c": 0,
        "d": 0xFF000000,
        "e": 0xFFFFFFFF,
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: red", ":1: a: the number of a colour was expected, not 'red'"),
        ("a: 1\nb: 1.5", ":2: b: the number of a colour"),
        ("a: 4294967296", "more than 32 bits"),
        ("a: [1, 2, 3]", "a text was expected, not a list"),
        ("- 1", "keys and values were expected"),
        ("{}", "no place has a colour"),
    ],
)
def test_what_is_no_colour_is_told(tmp_path, text, message):
    with pytest.raises(FormatError, match=message):
        load(tmp_path, text)


@pytest.mark.foreign("topology/predicate_labels.yaml")
def test_the_colours_of_the_original(corpus):
    colours = load_colours(corpus / "topology" / "predicate_labels.yaml")
    assert len(colours) == 6
    assert (colours["IsInSoccerField"], colours["IsInWestCorridor"]) == (255, 16757760)
