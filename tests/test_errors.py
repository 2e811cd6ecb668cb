"""Errors: one sentence with its place, and the parts of the place."""

from __future__ import annotations

from pathlib import Path

import pytest

from mdm import ConfigError, Error, FormatError, ModelError


@pytest.mark.parametrize(
    ("place", "text"),
    [
        ({"file": Path("a/m.pomdp"), "line": 3, "column": 7}, "a/m.pomdp:3:7: wrong"),
        ({"file": "m.pomdp", "line": 3}, "m.pomdp:3: wrong"),
        ({"file": "m.pomdp"}, "m.pomdp: wrong"),
        ({"column": 2}, "2: wrong"),
        ({}, "wrong"),
    ],
)
def test_a_format_error_begins_with_its_place(place, text):
    error = FormatError("wrong", **place)
    assert str(error) == text
    assert error.message == "wrong"
    given = {"file": None, "line": None, "column": None, **place}
    assert (error.file, error.line, error.column) == (
        given["file"] and str(given["file"]),
        given["line"],
        given["column"],
    )


def test_a_configuration_error_names_the_file_and_the_key():
    error = ConfigError("wrong", file=Path("robot.toml"), key="ensembles.patrol")
    assert str(error) == "robot.toml: ensembles.patrol: wrong"
    assert (error.message, error.file, error.key) == ("wrong", "robot.toml", "ensembles.patrol")
    assert error.problems == (error,)
    assert str(ConfigError("wrong")) == "wrong"


def test_one_class_catches_all():
    assert all(issubclass(kind, Error) for kind in (ConfigError, FormatError, ModelError))
