"""Declarations: what names stand for, what they are made of, and what is wrong with them."""

from __future__ import annotations

import pytest
from sentences import refused

from mdm import ConfigError, Error, P, PredicateManager


@pytest.fixture
def manager():
    manager = PredicateManager()
    manager.sensor("Open", max_age=2.0)
    manager.define("Shut", ~P("Open"), held_for=0.5)
    manager.event("Bump")
    manager.event("Opened", "Open and robot2/Near")
    manager.latch("Done", set="Go.succeeded", reset="Bump")
    return manager


def test_a_name_stands_for_what_was_declared_or_for_what_it_looks_like(manager):
    declared = manager.declared
    kinds = {"Open": "predicate", "Shut": "predicate", "Bump": "event", "Opened": "event", "Done": "predicate"}
    assert declared.names == kinds
    others = {"Go.failed": "event", "robot2/Near": "predicate", "Nothing": None}
    assert {name: declared.knows(name) for name in (*kinds, *others)} == kinds | others
    assert [name for name in kinds if declared.senses(name)] == ["Open"]
    assert [name for name in kinds if declared.raises(name)] == ["Bump"]
    assert [name for name in kinds if declared.derived(name)] == ["Shut", "Opened", "Done"]


def test_what_is_used_and_what_it_depends_on(manager):
    declared = manager.declared
    assert declared.used == ("Bump", "Go.succeeded", "Open", "robot2/Near")
    declared.use("Go.failed")
    assert "Go.failed" in declared.used
    assert declared.inputs_of("Done") == {"Done", "Go.succeeded", "Bump"}
    assert declared.inputs_of("Opened") == {"Opened", "Open", "robot2/Near"}
    assert declared.aged == {"Open"}


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Open", "set by code, unknown after 2 s"),
        ("Shut", "not Open, held for 0.5 s"),
        ("Bump", "raised by code"),
        ("Done", "set by Go.succeeded, reset by Bump"),
        ("Go.failed", "an action's end"),
        ("robot2/Near", "another agent's predicate"),
    ],
)
def test_each_definition_reads_in_words(manager, name, words):
    assert manager.declared.definition(name) == words


def test_the_network_has_what_is_used_as_others_told_it(manager):
    network = manager.declared.network({"robot2/Near": True})
    network.compile()
    assert network.value("robot2/Near") is True
    assert set(network.events) == {"Bump", "Opened", "Go.succeeded"}


def test_what_is_refused_leaves_what_was_declared_as_it_is(manager):
    for again in (
        lambda: manager.sensor("Open", max_age=9.0),
        lambda: manager.define("Shut", "Open", held_for=9.0),
        lambda: manager.event("Bump", "Open"),
    ):
        with refused(ConfigError):
            again()
    assert manager.declared.definition("Open") == "set by code, unknown after 2 s"
    assert manager.declared.definition("Shut") == "not Open, held for 0.5 s"
    assert manager.declared.definition("Bump") == "raised by code"


@pytest.mark.parametrize(
    ("name", "kind", "words"),
    [
        ("Opne", "predicate", "no predicate 'Opne'; did you mean 'Open'"),
        ("Shut", "predicate", "predicate 'Shut' is derived from others"),
        ("Bump", "predicate", "no predicate 'Bump': it is an event"),
        ("Go.failed", "event", "no event 'Go.failed'"),
    ],
)
def test_input_is_checked_against_what_is_declared_and_used(manager, name, kind, words):
    for fine, its in (
        ("Open", "predicate"),
        ("Bump", "event"),
        ("Go.succeeded", "event"),
        ("robot2/Near", "predicate"),
    ):
        manager.declared.check_input(fine, its)
    with pytest.raises(Error, match=words):
        manager.declared.check_input(name, kind)
