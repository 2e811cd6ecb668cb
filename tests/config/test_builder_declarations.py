"""Predicates and events as a file declares them."""

from __future__ import annotations

from pathlib import Path

import pytest
from sentences import refused

from mdm import ConfigError
from mdm.config.builder import Declarations
from mdm.config.functions import Functions
from mdm.config.readers import Readers, Reading
from mdm.config.tables import Problems


def without_extensions(declarations, problems):
    functions = Functions(Path(), problems, callbacks=False)
    return Readers({}, (), {}, Reading(Path(), declarations.manager, functions, problems))


def declared(**tables):
    problems = Problems(Path("robot.toml"))
    declarations = Declarations(problems)
    declarations.declare(tables, without_extensions(declarations, problems))
    declarations.check()
    problems.raise_all()
    return declarations


def test_predicates_and_events_are_declared_by_what_their_tables_say():
    manager = declared(
        predicates={"A": {"initial": True}, "B": "not A", "C": {"set": "A", "reset": "Up"}},
        events={"Up": "B", "Go": {}},
    ).manager
    known = manager.declared
    assert known.names == {"A": "predicate", "B": "predicate", "C": "predicate", "Up": "event", "Go": "event"}
    assert known.derived("B")
    assert known.senses("A")
    assert known.raises("Go")


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"predicates": {"A": "not A"}}, "A"),
        ({"predicates": {"A": {}, "B": "not AA"}}, "'B' uses 'AA', which is not declared; did you mean 'A'"),
        ({"predicates": {"A": {"set": "B"}}}, "a latch needs both 'set' and 'reset'"),
        ({"predicates": 7}, "predicates must be a table"),
        ({"events": {"Up": {"formula": "not"}}}, "events.Up"),
    ],
)
def test_what_cannot_be_declared_is_told(tables, words):
    with pytest.raises(ConfigError) as caught:
        declared(**tables)
    assert words in str(caught.value)


def test_a_monitor_is_declared_by_its_formula():
    table = {"monitor": "G(not Stairs) and F(Dock)"}
    known = declared(predicates={"Stairs": {}, "Dock": {}, "Careful": table}).manager.declared
    assert known.definition("Careful") == "false once G(not Stairs) and F(Dock) is false for ever"
    assert known.written("Careful") == table
    assert known.inputs_of("Careful") == {"Careful", "Stairs", "Dock"}


@pytest.mark.parametrize(
    "table",
    [
        {"monitor": "G(not Stair)"},
        {"monitor": "G(not Stairs"},
        {"monitor": "true"},
        {"monitor": "G(Seen)"},
        {"monitor": "G(Stairs)", "held_for": 2.0},
        {"monitor": "G(Stairs)", "formula": "Stairs"},
        {"monitor": "G(Stairs)", "set": "Stairs", "reset": "not Stairs"},
        {"sensor": False},
    ],
)
def test_what_is_no_monitor_is_refused(table):
    with refused(ConfigError):
        declared(predicates={"Stairs": {}, "Careful": table}, events={"Seen": {}})


def test_ends_of_actions_are_those_of_the_ensembles():
    problems = Problems(Path("robot.toml"))
    declarations = Declarations(problems)
    tables = {"predicates": {"Done": {"set": "Work.succeeded", "reset": "Rest.succeeded"}}}
    declarations.declare(tables, without_extensions(declarations, problems))
    declarations.check_ends(["Work", "Rst"])
    with refused(ConfigError):
        problems.raise_all()
