"""Factored models as their users see them: names, outcomes, laziness, factors dropped."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_models import dense, distributions, factored_models
from sentences import refused

from mdm import ModelError
from mdm.models import Factor, FactoredMDP, FactoredPOMDP, Node, Space, Table, TwoSliceNetwork
from mdm.problems import patrol


def door(events=False, paid_by_observation=False):
    """Return a robot that opens a door, in a room of which nothing is known, and may hear it."""
    here, door_, door_then = Node("state", 0), Node("state", 1), Node("next_state", 1)
    act, heard = Node("action", 0), Node("observation", 0)
    opens = np.zeros((2, 2, 2))  # act, door, door'
    opens[0] = np.eye(2)
    opens[1] = [[0.25, 0.75], [0, 1]]
    click = np.array([[1.0, 0.0], [0.5, 0.5]])
    told = Table([door_then, heard], click)
    if events:
        each = np.zeros((2, 2, 2))
        each[..., 0] = 1
        each[0, 1] = [0.125, 0.875]  # from shut to open
        told = Table([door_, door_then, heard], each)
    utilities = [Table([act], [0.0, -1.0]), Table([door_, door_then], [[0.0, 10.0], [0.0, 0.0]])]
    if paid_by_observation:
        utilities.append(Table([heard], [0.0, 2.0]))
    return TwoSliceNetwork(
        Space([Factor("room", ["LRM", "Coffee Room"]), Factor("door", ["shut", "open"])]),
        Space.single("robot", ["Stay", "Open"]),
        Space.single("ear", ["nothing", "click"]),
        initial=[Table([here], [0.5, 0.5]), Table([door_], [1.0, 0.0])],
        transitions=[Table([here, Node("next_state", 0)], np.eye(2)), Table([act, door_, door_then], opens)],
        observation=[told],
        utilities=utilities,
    )


def test_numbers_by_name():
    model = FactoredPOMDP(door(), discount=0.9)
    assert model.transition("Open", "LRM shut", "LRM open") == 0.75
    assert model.transition("Open", "Coffee Room shut").tolist() == [0, 0, 0.25, 0.75]
    assert model.transition(1, ("LRM", "shut"), 0) == 0.25
    assert model.observation("Stay", "LRM open", "click") == 0.5
    assert model.observation("Stay", 0).tolist() == [1, 0]
    assert model.reward("Open", "LRM shut") == pytest.approx(-1 + 0.75 * 10)
    assert model.reward("Open", "LRM shut", "LRM open") == 9
    assert model.reward("Open", "LRM shut", "LRM shut", "click") == -1


@pytest.mark.parametrize("sparse", [False, True])
def test_events_are_asked_for_with_the_state_before(sparse):
    model = FactoredPOMDP(door(events=True), discount=0.9, sparse=sparse)
    assert model.event_observations
    assert model.observation("Open", "LRM open", "click", state="LRM shut") == 0.875
    assert model.observation("Open", "LRM open", state="LRM open").tolist() == [1, 0]
    assert dense(model.event_matrix("Open", "click"))[0].tolist() == [0, 0.875, 0, 0 if sparse else 0.875]
    assert dense(model.joint_matrix("Open", "click"))[0].tolist() == [0, 0.75 * 0.875, 0, 0]
    with refused(ModelError):
        model.observation("Open", "LRM open")
    with refused(ModelError):
        model.observation_matrix("Open")


def test_rewards_of_what_is_observed():
    model = FactoredPOMDP(door(events=True, paid_by_observation=True), discount=0.9)
    assert model.reward("Open", "LRM shut") == pytest.approx(-1 + 0.75 * (10 + 0.875 * 2))
    assert model.reward("Open", "LRM shut", "LRM open", "click") == 11
    with refused(ModelError):
        model.reward("Open", "LRM shut", "LRM open")


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda model: model.transition("Opne", 0), "did you mean 'Open'"),
        (lambda model: model.transition("Stay", "LRM ajar"), "'door' has no symbol 'ajar'"),
        (lambda model: model.transition("Stay", "LRM"), "needs a component for each of room, door"),
        (lambda model: model.observation("Stay", 0, "bang"), "'ear' has no symbol 'bang'"),
        (lambda model: model.observation_matrix(2), "no symbol 2"),
        (lambda model: model.event_matrix(0, 0), "ask for observation_matrix"),
        (lambda model: model.marginalize("window"), "no state factor 'window'; there are room, door"),
        (lambda model: model.with_discount(0), "more than 0"),
    ],
)
def test_what_there_is_not_is_told(ask, message):
    with pytest.raises(ModelError, match=message):
        ask(FactoredPOMDP(door(), discount=0.9))


def test_matrices_are_made_once_when_they_are_asked_for():
    model = FactoredPOMDP(door(), discount=0.9)
    assert "_flat" not in vars(model)
    assert model.kind == "POMDP"
    assert model.num_agents == 1
    assert model.initial_belief.tolist() == [0.5, 0, 0.5, 0]
    assert "_flat" not in vars(model)
    flat = model.flatten()
    assert model.flatten() is flat
    assert model.rewards is flat.rewards
    assert model.transition_matrix("Open") is flat.transition_matrix(1)
    other = model.with_discount(0.5)
    assert (type(other), other.discount, other.network) == (FactoredPOMDP, 0.5, model.network)
    assert other.flatten().discount == 0.5
    assert other.rewards is flat.rewards
    for array in (model.rewards, model.initial_belief, model.transition_matrix(0)):
        with refused(ValueError):
            array[0] = 0


@pytest.mark.parametrize("sparse", [False, True])
def test_matrices_are_of_the_kind_that_was_asked_for(sparse):
    for events in (False, True):
        model = FactoredPOMDP(door(events=events), discount=0.9, sparse=sparse)
        assert model.is_sparse == model.flatten().is_sparse == sparse


@given(model=factored_models(events=True))
def test_the_array_of_outcomes_holds_each_outcome(model):
    finer = model.outcome_rewards
    later = {"next_state", "observation"}
    assert (finer is None) == all(node.role not in later for u in model.network.utilities for node in u.scope)
    if finer is None:
        return
    array = finer.array(10**9)
    assert finer.array(array.size - 1) is None
    width = 1 if model.network.observations is None else len(model.network.observations)
    for a, s, t in np.ndindex(array.shape[:3]):
        for o in range(width):
            one = finer.at(a, s, t, None if model.network.observations is None else o)
            assert array[(a, s, t, o)[: array.ndim]] == pytest.approx(one, abs=1e-9)


@st.composite
def with_an_idle_factor(draw):
    """Return a network with a factor whose present value nothing depends on, and its place.

    All next values depend on the others' present ones; what is observed on the next values and, for events, on the
    others' present ones, too.
    """
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    sizes = draw(st.lists(st.integers(1, 3), min_size=2, max_size=3))
    place = draw(st.integers(0, len(sizes) - 1))
    actions, width, events = draw(st.integers(1, 2)), draw(st.integers(1, 3)), draw(st.booleans())
    others = [index for index in range(len(sizes)) if index != place]
    act, own = Node("action", 0), Node("next_state", place)
    tables = {}
    before = [Node("state", index) for index in others]
    for index in others:
        scope = [act, *before, *(Node("next_state", other) for other in others if other < index)]
        shape = [actions if node.role == "action" else sizes[node.place] for node in scope]
        tables[index] = Table([*scope, Node("next_state", index)], distributions(random, *shape, sizes[index]))
    # Not on its own present value, which P(f' | x, y), and so what is observed, would depend on.
    scope = [*before, *(Node("next_state", index) for index in others)]
    tables[place] = Table([*scope, own], distributions(random, *(sizes[node.place] for node in scope), sizes[place]))
    seen = [act, *(before if events else []), *(Node("next_state", index) for index in range(len(sizes)))]
    shape = [actions if node.role == "action" else sizes[node.place] for node in seen]
    table = Table([*seen, Node("observation", 0)], distributions(random, *shape, width))
    utility = Table([*before, act], random.normal(size=[*(sizes[index] for index in others), actions]))
    network = TwoSliceNetwork(
        Space(Factor(f"f{index}", size) for index, size in enumerate(sizes)),
        Space.single("act", actions),
        Space.single("eye", width),
        initial=[Table([Node("state", index)], distributions(random, size)) for index, size in enumerate(sizes)],
        transitions=[tables[index] for index in range(len(sizes))],
        observation=[table],
        utilities=[utility],
    )
    return network, place


def at(table, digits):
    return table.values[tuple(digits[node] for node in table.scope)]


@given(with_an_idle_factor(), st.booleans())
def test_a_factor_dropped_is_summed_over(described, sparse):
    """T', O' and R of the rest, from products of the network's tables over single values."""
    network, place = described
    small = FactoredPOMDP(network, discount=0.9, sparse=sparse).marginalize(f"f{place}")
    sizes = network.states.shape
    others = [index for index in range(len(sizes)) if index != place]
    rest = list(itertools.product(*(range(sizes[index]) for index in others)))
    assert [factor.name for factor in small.state_space.factors] == [f"f{index}" for index in others]
    for a, (x, before), (y, after) in itertools.product(range(len(network.actions)), enumerate(rest), enumerate(rest)):
        told, total = np.zeros(len(network.observations)), 0.0
        for value in range(sizes[place]):
            digits = {Node("action", 0): a, Node("next_state", place): value}
            digits |= {Node("state", index): digit for index, digit in zip(others, before, strict=True)}
            digits |= {Node("next_state", index): digit for index, digit in zip(others, after, strict=True)}
            chance = np.prod([at(table, digits) for table in network.transitions])
            total += chance
            for o in range(len(told)):
                told[o] += chance * at(network.observation[0], digits | {Node("observation", 0): o})
        assert small.transition(a, x, y) == pytest.approx(total, abs=1e-12)
        assert small.rewards[x, a] == pytest.approx(at(network.utilities[0], digits), abs=1e-12)
        if total > 0:
            np.testing.assert_allclose(small.observation(a, y, state=x), told / total, atol=1e-9)


def test_rewards_of_any_size_allow_a_factor_to_be_dropped():
    """Rewards in expectation differ in their last digits where the factor differs, by 1e-4 here."""
    random = np.random.default_rng(0)
    moves, own = distributions(random, 3, 3), random.dirichlet(np.ones(2), size=2)
    factors = [Node("state", 0), Node("next_state", 0)]
    network = TwoSliceNetwork(
        Space([Factor("x", 3), Factor("f", 2)]),
        Space.single("act", 1),
        initial=[Table([Node("state", 0)], [1, 0, 0]), Table([Node("state", 1)], [1, 0])],
        transitions=[Table(factors, moves), Table([Node("state", 1), Node("next_state", 1)], own)],
        utilities=[Table(factors, random.normal(size=(3, 3)) * 1e12)],
    )
    model = FactoredMDP(network, discount=0.9)
    assert np.abs(model.rewards[::2] - model.rewards[1::2]).max() > 1e-9
    np.testing.assert_allclose(model.marginalize("f").rewards, model.rewards[::2], rtol=1e-12)


def test_a_factor_that_tells_of_its_past_cannot_be_dropped():
    """The lamp stays as it is, and is seen: what is observed depends on what it was."""
    lamp = [Node("state", 1), Node("next_state", 1)]
    network = TwoSliceNetwork(
        Space([Factor("x", 2), Factor("lamp", 2)]),
        Space.single("act", 1),
        Space.single("eye", 2),
        initial=[Table([Node("state", place)], [1, 0]) for place in range(2)],
        transitions=[Table([Node("next_state", 0)], [0.5, 0.5]), Table(lamp, np.eye(2))],
        observation=[Table([lamp[1], Node("observation", 0)], np.eye(2))],
    )
    with refused(ModelError):
        FactoredPOMDP(network, discount=0.9).marginalize("lamp")


def test_names_go_wherever_indices_go():
    model = patrol()
    state = model.state_space.ravel([4, 0, 0])
    names = ("LRM", "Phase 0", "No Goose")
    assert [factor.names[4 if place == 0 else 0] for place, factor in enumerate(model.state_space.factors)] == [*names]
    row = model.transition("Move Up", names)
    np.testing.assert_array_equal(row, model.transition_matrix(2)[state])
    np.testing.assert_array_equal(row, model.transition("Move Up", "LRM Phase 0 No Goose"))
    after = int(row.argmax())
    assert model.transition("Move Up", names, after) == row[after] > 0
    told = model.observation("Move Up", after, state=names)
    np.testing.assert_array_equal(told, [model.event_matrix(2, o)[state, after] for o in range(8)])
    assert model.observation("Move Up", after, "LRM Clear", state=names) == told[5]
    assert model.reward("Move Up", names) == model.rewards[state, 2]
