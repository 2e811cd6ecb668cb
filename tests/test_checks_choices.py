"""Choices among words, and flags."""

from __future__ import annotations

import numpy as np
import pytest

from mdm import ConfigError
from mdm.checks import check_choice, check_flag, check_seed


@pytest.mark.parametrize("given", ["blue", "Red", "", None, 1, ["red"], {}, b"red"])
def test_what_is_none_of_the_words_is_refused_with_them(given):
    with pytest.raises(ConfigError, match="colour is 'red', 'green' or 'grey', not ") as caught:
        check_choice(given, ("red", "green", "grey"), "colour", key="paint")
    assert caught.value.key == "paint"


@pytest.mark.parametrize("given", ["no", 0, 1, None, [], 0.0])
def test_what_is_neither_true_nor_false_is_refused(given):
    with pytest.raises(ConfigError, match="debug is True or False, not "):
        check_flag(given, "debug")


def test_the_words_and_flags_pass():
    check_choice("grey", ("red", "green", "grey"), "colour")
    check_flag(True, "debug")
    check_flag(False, "debug")


@pytest.mark.parametrize("given", [0, 2**70, np.int64(3), None])
def test_seeds(given):
    check_seed(given)


@pytest.mark.parametrize("given", ["a", 1.5, -1, True])
def test_what_is_no_seed(given):
    with pytest.raises(ConfigError, match="a seed is a whole number from 0 on, not"):
        check_seed(given)
