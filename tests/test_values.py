"""Which values of options are noted, and when a run fails for want of them."""

from __future__ import annotations

import inspect
import os
import re
import subprocess
import sys
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, TypedDict

import msgspec
import pytest
import values
from decided import nothing
from loading import written
from places import ROOT

import mdm
from mdm.config.tables import Problems
from mdm.policies import DeterministicPolicy

if TYPE_CHECKING:
    import numpy.typing as npt

ARGS, TESTPATHS = pytest.Config.ArgsSource.ARGS, pytest.Config.ArgsSource.TESTPATHS
NOTHING = {"markexpr": "", "keyword": "", "maxfail": 0, "deselect": None, "ignore": None, "collectonly": False}


@pytest.fixture
def noted(monkeypatch):
    """What is noted within a test: here alone, for the run's own notes are about other tests."""
    heard = [(taker, "__init__") for taker, *_ in values.takers()]
    for owner, name in [*heard, (Problems, "convert"), (Problems, "raise_all")]:
        monkeypatch.setattr(owner, name, inspect.unwrap(getattr(owner, name)))
    found = values.Values()
    found.listen()
    return found.given


def test_numbers_are_found_among_the_types_of_options():
    class Some(msgspec.Struct):
        one: int
        two: Annotated[float, msgspec.Meta(gt=0)] | None = None
        three: str | float | None = None
        four: list[float] | str | None = None
        five: dict[str, int] | None = None
        six: bool = False

    class Options(TypedDict):
        a: float | None
        b: str | None
        c: npt.ArrayLike | None
        d: int

    assert values.numbers_of(Some) == ["one", "two", "three"]
    assert values.keywords_of(Options) == ["a", "d"]


OTHERS = {"Literal", "Simulated", "TopicTable", "Quality", "Heard"}
"""A type, a stand-in for tests, the base of tables, a part of these, and a message."""


def test_all_tables_and_typed_dictionaries_are_known():
    rooms = [ROOT / "mdm" / name for name in ("config", "ros2")]
    source = "".join(path.read_text(encoding="utf-8") for room in rooms for path in room.glob("*.py"))
    converted = re.findall(r"convert\([^,]+, ([A-Z]\w+), ", source)  # that of factors is a parameter
    declared = re.findall(r"class (\w+)\(\w+, frozen=True", source)
    assert {table.__name__ for table in values.tables()} == {*converted, *declared} - OTHERS
    assert {"ActionTable", "EnsembleTable", "TeamTable", "Placement", "Agent", "Ceiling"} <= {*converted, *declared}
    source = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "mdm").rglob("*.py"))
    taken = {options.__name__ for _, options, _ in values.takers()}
    assert taken == {*re.findall(r"class (\w+)\(\w+, total=False\)", source)} - {"DriveOptions"}  # of bindings, too
    assert {"keyword horizon", "keyword idle_after", "keyword pause", "TeamTable.lease"} <= {*values.known()}


def test_keywords_are_noted_where_they_are_accepted_and_not_by_default(noted):
    policy = DeterministicPolicy([0])
    mdm.Controller(policy, horizon=3)
    mdm.Controller(policy, horizon=5)
    mdm.Ensemble("robot", policy=policy, actions={0: nothing}, drive=mdm.FixedRate(4.0), idle_after=7)
    with pytest.raises(mdm.ConfigError):
        mdm.Ensemble("robot", policy=policy, actions={0: nothing}, deadline=-1.0)
    mdm.Binding(nothing, pause=2.0)
    mdm.Binding(nothing, pause=1.0)
    assert noted == {
        "keyword horizon": {3.0, 5.0},
        "keyword drive": {4.0},
        "keyword idle_after": {7.0},
        "keyword pause": {2.0},
    }


def test_keys_of_files_are_noted_where_the_file_is_accepted(noted, tmp_path):
    text = "[predicates]\nA = { max_age = AGE }\n[ensembles.a]\npolicy = [0]\nhorizon = 9\nactions = { X = 'a:x' }\n"
    mdm.load_system(written(tmp_path, text.replace("AGE", "2.5"), "a.toml"), callbacks=False)
    with pytest.raises(mdm.ConfigError):
        mdm.load_system(written(tmp_path, text.replace("AGE", "-1.0"), "a.toml"), callbacks=False)
    with pytest.raises(mdm.ConfigError):
        mdm.load_system(written(tmp_path, text.replace("AGE", "4.0 }\nB = { held_by = 1"), "a.toml"), callbacks=False)
    assert noted == {"PredicateTable.max_age": {2.5}, "EnsembleTable.horizon": {9.0}, "keyword horizon": {9.0}}


def test_options_with_fewer_than_two_values_are_named_with_those():
    found, worker = values.Values(), values.Values()
    for value in (1, 1.0, True, None, "event"):
        found.note("a", value)
    found.note("b", 2.5)
    worker.note("b", 3)
    worker.note("c", 1e-6)
    found.merge({option: sorted(given) for option, given in worker.given.items()})
    assert found.too_few(["a", "b", "c", "d"]) == ["a: 1", "c: 1e-06", "d: none"]


@pytest.mark.parametrize(
    ("source", "given", "words"),
    [
        (TESTPATHS, {}, ""),
        (TESTPATHS, {"markexpr": "not slow"}, ""),
        (TESTPATHS, {"markexpr": "slow"}, "-m 'slow'"),
        (TESTPATHS, {"keyword": "belief"}, "keyword"),
        (TESTPATHS, {"maxfail": 1}, "maxfail"),
        (TESTPATHS, {"lf": True}, "lf"),
        (ARGS, {}, "paths"),
    ],
)
def test_a_run_is_complete_without_anything_that_chooses_tests(source, given, words):
    why = values.why_partial(SimpleNamespace(args_source=source, option=SimpleNamespace(**NOTHING | given)))
    assert (words in why) if words else why == ""


CONFTEST = """
import values
values.known = lambda: ["keyword horizon", "keyword pause"]
def pytest_configure(config):
    config.pluginmanager.register(values.ValuesPlugin(config))
"""
TESTS = """
import mdm, pytest
@pytest.mark.parametrize("number", [3, 4])
def test_it(number):
    mdm.Controller(mdm.policies.DeterministicPolicy([0]), horizon=number)
    mdm.Binding(print, pause=PAUSE)
"""
NAMED = "options that tests gave fewer than 2 values =+\nkeyword pause: 7\n"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pause", "arguments", "status", "words"),
    [
        ("number", ["-n", "2"], 0, "= 2 passed"),
        ("7.0", ["-n", "2"], 1, NAMED),
        ("7.0", ["-p", "no:xdist"], 1, NAMED),
        ("7.0", ["-n", "2", "-k", "it"], 0, "is not judged: the option keyword is given"),
        ("-1.0", ["-p", "no:xdist"], 1, "is not judged: not all tests have passed"),
    ],
)
def test_workers_hand_over_what_they_note_and_the_session_fails(tmp_path, pause, arguments, status, words):
    written(tmp_path, CONFTEST, "conftest.py")
    written(tmp_path, TESTS.replace("PAUSE", pause), "test_it.py")
    written(tmp_path, "[pytest]\ntestpaths = .\n", "pytest.ini")
    plugins = [f"-pno:{name}" for name in ("randomly", "cacheprovider", "asyncio", "hypothesispytest")]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *plugins, *arguments],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT / "tests"), "PYTEST_ADDOPTS": ""},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == status, done.stdout + done.stderr
    assert re.search(words, done.stdout), done.stdout
    assert ("values" in done.stdout) == (pause != "number")
