"""Problems of a file, all told at once."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import msgspec
import pytest
from loading import written
from robot_file import GOOD
from sentences import refused

from mdm import (
    ConfigError,
    FormatError,
    ModelError,
    load_system,
)
from mdm.config.tables import Problems


def test_all_mistakes_are_told_at_once(folder):
    text = GOOD.replace("robot_code:work", "robot_code:wrk").replace("max_age", "maxage").replace("horizon", "horizn")
    text = text.replace('"not A"', '"no A"').replace('"Ping"', '"Pong"').replace('"hold"', '"hld"')
    with pytest.raises(ConfigError) as caught:
        load_system(written(folder, text, "robot.toml"))
    assert [problem.key for problem in caught.value.problems] == [
        "predicates.A.maxage",
        "predicates.B",
        "ensembles.below.horizn",
        "ensembles.below.actions.Work",
        "ensembles.below.states.a.on_violation",
        "predicates.Seen",
    ]
    assert len(str(caught.value).splitlines()) == 6


class Table(msgspec.Struct, forbid_unknown_fields=True):
    """A table of a file, as the tests need one."""

    name: str
    way: Literal["first", "hold"] = "first"
    numbers: tuple[int, ...] = ()


@pytest.fixture
def problems():
    return Problems(Path("robot.toml"))


def told(problems):
    """Return the keys and messages of all problems; there must be some."""
    with pytest.raises(ConfigError) as caught:
        problems.raise_all()
    return [(problem.key, problem.message) for problem in caught.value.problems]


def test_without_problems_nothing_is_raised(problems):
    assert problems.convert({"name": "a", "numbers": [1]}, Table, "here") == Table("a", numbers=(1,))
    problems.raise_all()
    assert len(problems) == 0


def test_one_error_holds_all_problems(problems):
    problems.add("first", "a")
    problems.add("second", None)
    assert told(problems) == [("a", "first"), (None, "second")]
    with refused(ConfigError):
        problems.raise_all()


@pytest.mark.parametrize(
    ("value", "found"),
    [
        ({"nme": "a", "name": "b"}, [("here.nme", "there is no key 'nme' here; did you mean 'name' or 'numbers'?")]),
        ({"zzz": 1, "name": "b"}, [("here.zzz", "there is no key 'zzz' here; the keys are name, way, numbers")]),
        ({}, [("here", "the required key 'name' is missing")]),
        ({"name": "a", "way": "last"}, [("here.way", "'last' is not one of 'first', 'hold'")]),
        ({"name": "a", "numbers": [1, "x"]}, [("here.numbers[1]", "a whole number was expected, not 'x'")]),
        (7, [("here", "a table was expected, not 7")]),
    ],
)
def test_what_a_table_should_not_hold_is_told_with_its_key(problems, value, found):
    assert problems.convert(value, Table, "here") is None
    assert told(problems) == found


def test_several_mistakes_of_a_table_are_all_told_and_the_rest_may_be_kept(problems):
    value = {"name": "a", "way": "last", "nmbers": [], "numbers": [3]}
    kept = problems.convert(value, Table, "here", partly=True)
    assert kept == Table("a", numbers=(3,))
    assert [key for key, _ in told(problems)] == ["here.way", "here.nmbers"]
    assert problems.convert({"name": 7}, Table, "there", partly=True) is None  # nothing is left without a name


@pytest.mark.parametrize(
    ("error", "found"),
    [
        (ConfigError("wrong", key="inner"), ("here", "wrong")),
        (ConfigError("wrong", key="ensembles.a"), ("ensembles.a", "wrong")),
        (FormatError("wrong", column=3), ("here", "wrong (column 3)")),
        (FormatError("wrong", file="m.pomdp", line=2), ("here", "m.pomdp:2: wrong")),
        (ModelError("wrong"), ("here", "wrong")),
    ],
)
def test_an_error_within_a_block_becomes_a_problem_of_its_key(problems, error, found):
    with problems.collecting("here"):
        raise error
    assert told(problems) == [found]
    with pytest.raises(ZeroDivisionError), problems.collecting("here"):
        1 / 0  # noqa: B018
