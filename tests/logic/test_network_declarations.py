"""Declarations: what makes no sense together is refused, and what is named of other agents is an input."""

from __future__ import annotations

import pytest
from sentences import refused

from mdm.errors import Error, FormatError
from mdm.logic import Network
from mdm.logic.network import similar


def test_other_agents_predicates_are_unknown_inputs():
    network = Network()
    network.define("both", "robot2/IsMoving and robot3/IsMoving")
    network.compile()
    assert network.remote == ("robot2/IsMoving", "robot3/IsMoving")
    assert network.update([("robot2/IsMoving", False)]).falling == ("robot2/IsMoving", "both")


@pytest.mark.parametrize(
    ("declare", "message"),
    [
        (lambda n: (n.define("a", "b"), n.define("b", "c"), n.define("c", "a")), r"cycle: (a -> b|b -> c|c -> a)"),
        (lambda n: n.define("a", "a"), "cycle: a -> a"),
        (lambda n: (n.add_input("IsMoving"), n.define("b", "IsMovng")), r"'IsMovng'.*did you mean 'IsMoving'"),
        (lambda n: (n.add_input("a"), n.add_event("a")), "'a' is declared twice"),
        (lambda n: (n.add_event("e"), n.define("b", "e")), "the event .* latch"),
        (lambda n: n.define("b", "not"), "formula of 'b'"),
    ],
)
def test_wrong_declarations_are_refused(declare, message):
    network = Network()
    with pytest.raises(Error, match=message):
        declare(network)
        network.compile()


def test_a_formula_s_error_tells_whose_it_is_and_where():
    with refused(FormatError) as caught:
        Network().define("b", "a and and c")
    assert caught.value.column == 7


@pytest.mark.parametrize(
    ("name", "hint"),
    [("IsMovng", "; did you mean 'IsMoving'?"), ("Doors", "; did you mean 'Door' or 'Door2'?"), ("xyz", "")],
)
def test_hints_are_the_closest_names(name, hint):
    assert similar(name, ["IsMoving", "Door", "Door2"]) == hint
