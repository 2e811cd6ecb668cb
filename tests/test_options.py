"""Options that there are not are refused, with those that were meant."""

from __future__ import annotations

from typing import TypedDict

import pytest
from sentences import refused

from mdm import ConfigError
from mdm.options import ControllerOptions, check_options


class Two(TypedDict, total=False):
    colour: str
    size: int


@pytest.mark.parametrize(
    ("option", "words"),
    [("color", "did you mean 'colour'?"), ("weight", "there are colour, size"), ("Size", "did you mean 'size'?")],
)
def test_an_unknown_option_is_told_with_those_that_are_near(option, words):
    with refused(ConfigError) as caught:
        check_options(["size", option], Two)
    assert words in str(caught.value)
    assert caught.value.key == option


def test_known_options_pass():
    check_options([], Two)
    check_options(["horizon", "seed"], ControllerOptions)
