"""What a two-slice network says of its structure, and which variable it blames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_models import networks
from sentences import refused

from mdm import ModelError
from mdm.models import Factor, FactoredMDP, FactoredPOMDP, Node, Space, Table, Tree, TwoSliceNetwork
from mdm.models.factored.two_slice import PotentialError
from mdm.models.validation import collect_problems

ACTION = Node("action", 0)


def now(place):
    return Node("state", place)


def later(place):
    return Node("next_state", place)


def copies(parent, child):
    return Table([parent, child], np.eye(2))


def binary(count, **changes):
    """Return a network of binary factors x0, x1, ... that stay as they are."""
    arguments = {
        "initial": [Table([now(place)], [1, 0]) for place in range(count)],
        "transitions": [copies(now(place), later(place)) for place in range(count)],
    }
    states = Space(Factor(f"x{place}", ["off", "on"]) for place in range(count))
    return TwoSliceNetwork(states, Space.single("act", ["go", "stop"]), **arguments | changes)


@given(networks(events=True))
def test_every_variable_comes_after_its_parents(network):
    for role in ("state", "next_state", "observation"):
        order = network.orders[role]
        assert sorted(order) == list(range(len(network.factors(role))))
        for at, place in enumerate(order):
            parents = network.parents(Node(role, place))
            assert Node(role, place) not in parents
            assert {parent.place for parent in parents if parent.role == role} <= set(order[:at])
    told = any(node.role == "state" for potential in network.observation for node in potential.scope)
    assert network.event_observations == told


def test_variables_may_depend_on_those_that_are_listed_after_them():
    network = binary(
        3,
        initial=[copies(now(1), now(0)), copies(now(2), now(1)), Table([now(2)], [0.25, 0.75])],
        transitions=[copies(later(2), later(0)), copies(now(1), later(1)), copies(later(1), later(2))],
    )
    assert (network.orders["state"], network.orders["next_state"]) == ((2, 1, 0), (1, 2, 0))
    model = FactoredMDP(network, discount=0.9)
    np.testing.assert_allclose(model.initial_belief, [0.25, 0, 0, 0, 0, 0, 0, 0.75])
    assert model.transition("go", "off on off", "on on on") == 1  # all become what x1 is


def test_names_of_variables():
    network = binary(2)
    assert [network.name(node) for node in (now(1), later(1), ACTION)] == ["x1", "x1'", "act"]
    assert network.factor(later(1)) is network.states.factors[1]
    assert network.factors("observation") == ()
    assert network.potentials("action") == ()


@pytest.mark.parametrize("bystander", [0, 1, 2])
def test_a_circle_is_told_without_those_that_only_depend_on_it(bystander):
    a, b = (place for place in range(3) if place != bystander)
    transitions = {a: copies(later(b), later(a)), b: copies(later(a), later(b))}
    transitions[bystander] = copies(later(a), later(bystander))
    with pytest.raises(ModelError) as error:
        binary(3, transitions=[transitions[place] for place in range(3)])
    assert str(error.value) == f'"x{a}\'" and "x{b}\'" depend on each other in a circle'


@given(st.permutations(range(5)), st.integers(2, 5), st.data())
def test_circles_of_any_length_are_told_whole(places, length, data):
    circle, rest = places[:length], places[length:]
    parents = dict(zip(circle, circle[1:] + circle[:1], strict=True))
    parents |= {place: data.draw(st.sampled_from(circle + rest[:at])) for at, place in enumerate(rest)}
    with pytest.raises(ModelError) as error:
        binary(5, transitions=[copies(later(parents[place]), later(place)) for place in range(5)])
    names = " and ".join(f'"x{place}\'"' for place in sorted(circle))
    assert str(error.value) == f"{names} depend on each other in a circle"


def test_what_is_wrong_in_a_branch_is_told_with_the_values_that_lead_there():
    right, wrong = Table([later(0)], [0.5, 0.5]), Table([now(0), later(0)], [[0.5, 0.5], [0.5, 0.125]])
    tree = Tree(ACTION, [0, 1], [right, Tree(now(1), [0, 0], [wrong])])
    with pytest.raises(PotentialError) as error:
        binary(2, transitions=[tree, copies(now(1), later(1))])
    assert str(error.value) == (
        'the probabilities of "x0\'" given act=stop, x1=off|on, x0=on: they sum to 0.625, not to 1'
    )
    assert error.value.node == later(0)


def test_a_branch_that_nothing_leads_to_is_not_looked_at():
    right, wrong = Table([later(0)], [0.5, 0.5]), Table([later(0)], [0.5, 0.125])
    network = binary(1, transitions=[Tree(ACTION, [1, 1], [wrong, right])])
    assert FactoredMDP(network, discount=0.9).transition("stop", "on").tolist() == [0.5, 0.5]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -0.5])
def test_what_is_no_probability_is_told(bad):
    with refused(PotentialError):
        binary(1, initial=[Table([now(0)], [1.5, bad])])


def test_all_problems_are_collected():
    wrong = [Table([now(0)], [0.5, 0.25]), Table([now(1)], [-1.0, 2.0])]
    with collect_problems() as problems:
        binary(2, initial=wrong)
    assert [(problem.text, problem.is_sum) for problem in problems] == [
        ("the probabilities of 'x0': they sum to 0.75, not to 1", True),
        ("the probabilities of 'x1': -1 is not a probability", False),
    ]
    with collect_problems(sums_only=True) as problems, refused(ModelError):
        binary(2, initial=wrong)
    assert len(problems) == 1


def test_what_a_shared_branch_does_wrong_is_told_once():
    wrong = Table([later(0)], [0.5, 0.25])
    with collect_problems() as problems:
        binary(1, transitions=[Tree(ACTION, [0, 1], [wrong, Tree(now(0), [0, 0], [wrong])])])
    assert [problem.text for problem in problems] == [
        'the probabilities of "x0\'" given act=go: they sum to 0.75, not to 1'
    ]


def test_a_distribution_given_too_many_variables_at_once_is_refused_without_a_table_of_it():
    top = Table([later(0)], [0.5, 0.5])
    for place in range(26):
        top = Tree(now(place), [0, 0], [top])
    over = Tree(later(0), [0, 0], [top])  # the child on top: every combination below would have to be looked at
    transitions = [over, *(copies(now(place), later(place)) for place in range(1, 26))]
    with refused(ModelError):
        binary(26, transitions=transitions)


def test_what_events_say_counts_only_where_their_transition_is_possible():
    """O sums to 1.5 given x0=on, which never becomes off: it has no meaning there. From off, it has."""
    seen = Node("observation", 0)
    told = np.full((2, 2, 2), 0.5)
    told[1, 0] = 0.75
    options = {"observations": Space.single("eye", 2), "observation": [Table([now(0), later(0), seen], told)]}
    model = FactoredPOMDP(binary(1, **options), discount=0.9)
    assert model.event_observations
    assert model.observation("go", "on", state="on").tolist() == [0.5, 0.5]
    told[1, 1] = 0.75
    options["observation"] = [Table([now(0), later(0), seen], told)]
    wrong = FactoredPOMDP(binary(1, **options), discount=0.9)
    with refused(ModelError):
        wrong.flatten()
