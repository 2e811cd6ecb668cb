"""Flattened networks against sums and products over single entries."""

from __future__ import annotations

import itertools
import tracemalloc
import warnings

import numpy as np
import pytest
from hypothesis import given
from random_models import dense, factored_models
from sentences import refused

from mdm import ModelError
from mdm.errors import ModelWarning
from mdm.models import Factor, FactoredMDP, FactoredPOMDP, Node, Space, Table, Tree, TwoSliceNetwork
from mdm.models.factored.flattening import following, observed_chances, rewards_at
from mdm.problems import patrol


def value(potential, digits):
    """Return a potential at one value of every variable."""
    while isinstance(potential, Tree):
        potential = potential.branches[potential.choice[digits[potential.node]]]
    return potential.values[tuple(digits[node] for node in potential.scope)]


def outcomes(space):
    return list(itertools.product(*(range(len(factor)) for factor in space.factors)))


def at(role, values):
    return {Node(role, place): digit for place, digit in enumerate(values)}


def product(potentials, digits):
    result = 1.0
    for potential in potentials:
        result *= value(potential, digits)
    return result


@given(model=factored_models(events=True))
def test_matrices_are_the_products_of_potentials(model):
    network = model.network
    states, actions = outcomes(network.states), outcomes(network.actions)
    seen = outcomes(network.observations) if network.observations is not None else [()]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        flat = model.flatten()
    assert model.flatten() is flat
    start = [product(network.initial, at("state", state)) for state in states]
    np.testing.assert_allclose(model.initial_belief, start, atol=1e-12)
    for a, action in enumerate(actions):
        transition = dense(flat.transition_matrix(a))
        for s, state in enumerate(states):
            expected = 0.0
            for t, after in enumerate(states):
                digits = at("state", state) | at("action", action) | at("next_state", after)
                chance = product(network.transitions, digits)
                assert transition[s, t] == pytest.approx(chance, abs=1e-12)
                for o, symbols in enumerate(seen):
                    whole = digits | at("observation", symbols)
                    told = product(network.observation, whole)
                    reward = sum(value(utility, whole) for utility in network.utilities)
                    expected += chance * told * reward
                    if network.observations is None:
                        assert flat.reward(a, s, t) == pytest.approx(reward) if flat.outcome_rewards else True
                        continue
                    if flat.outcome_rewards:
                        assert flat.reward(a, s, t, o) == pytest.approx(reward)
                    if chance > 0:
                        assert flat.observation(a, t, o, state=s) == pytest.approx(told, abs=1e-12)
                        joint = dense(flat.joint_matrix(a, o))
                        assert joint[s, t] == pytest.approx(chance * told, abs=1e-12)
            assert flat.rewards[s, a] == pytest.approx(expected, abs=1e-9)


def chain(length):
    """Return a network of binary factors that copy their neighbours, more or less."""
    nodes = [Node("state", place) for place in range(length)]
    later = [Node("next_state", place) for place in range(length)]
    copies = np.array([[0.9, 0.1], [0.2, 0.8]])
    return TwoSliceNetwork(
        Space(Factor(f"x{place}", ["off", "on"]) for place in range(length)),
        Space([Factor("one", ["stay", "flip"]), Factor("idle", 3, prefix="i")]),
        initial=[Table([node], [1.0, 0.0]) for node in nodes],
        transitions=[
            Tree(
                Node("action", 0),
                [0, 1],
                [Table([nodes[place], later[place]], np.eye(2)), Table([nodes[place - 1], later[place]], copies)],
            )
            for place in range(length)
        ],
        utilities=[Table([Node("action", 1)], [0.0, 1.0, 2.0])],
    )


def test_actions_that_act_alike_share_their_matrix_and_nothing_larger_is_made():
    model = FactoredMDP(chain(10), discount=0.9, sparse=True)
    tracemalloc.start()
    flat = model.flatten()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    matrices = {id(flat.transition_matrix(a)) for a in range(6)}
    assert len(matrices) == 2
    size = sum(m.data.nbytes + m.indices.nbytes + m.indptr.nbytes for m in map(flat.transition_matrix, (0, 3)))
    assert size > 10_000_000
    assert peak < 6 * size
    assert flat.rewards[0].tolist() == [0, 1, 2] * 2


def test_names_and_discounts():
    model = FactoredMDP(chain(2), discount=0.9)
    # Each factor copies the one before it: from on, off come off (0.9) and on (0.8).
    assert model.transition("flip i2", "on off", "off on") == pytest.approx(0.9 * 0.8)
    assert model.transition(["stay", "i0"], ["on", "off"]).tolist() == [0, 0, 1, 0]
    assert model.reward("stay i2", 0) == 2
    other = model.with_discount(0.5)
    assert (other.discount, other.flatten().discount, model.discount) == (0.5, 0.5, 0.9)
    assert other.transition_matrix(3) is model.transition_matrix(3)
    with refused(ModelError):
        model.with_discount(2)
    with refused(ModelError):
        FactoredPOMDP(chain(1), discount=0.9)


def network(**changes):
    light = Space.single("light", ["red", "green"])
    now, later, act = Node("state", 0), Node("next_state", 0), Node("action", 0)
    arguments = {
        "states": light,
        "actions": Space.single("robot", ["go", "stop"]),
        "observations": Space.single("eye", ["r", "g"]),
        "initial": [Table([now], [0.5, 0.5])],
        "transitions": [Table([now, act, later], np.full((2, 2, 2), 0.5))],
        "observation": [Table([later, Node("observation", 0)], np.eye(2))],
        "utilities": [Table([now], [0.0, 1.0])],
    }
    return TwoSliceNetwork(**arguments | changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"initial": []}, "0 distributions are given for 1 states"),
        ({"initial": [Table([Node("state", 0)], [0.5, 0.6])]}, "of 'light': they sum to 1.1"),
        ({"initial": [Table([Node("state", 0)], [1.5, -0.5])]}, "-0.5 is not a probability"),
        ({"initial": [Table([Node("action", 0)], [0.5, 0.5])]}, "'light' does not have it in its scope"),
        ({"transitions": [Table([Node("next_state", 0)], [0.2, 0.3, 0.5])]}, r"\"light'\" is for 3 values"),
        (
            {"transitions": [Table([Node("observation", 0), Node("next_state", 0)], np.eye(2))]},
            "depends on 'eye', a later variable",
        ),
        (
            {"transitions": [Table([Node("state", 0), Node("next_state", 0)], [[0.5, 0.5], [0.5, 0.25]])]},
            r"\"light'\" given light=green: they sum to 0.75",
        ),
        ({"utilities": [Table([Node("state", 7)], [0.0, 1.0])]}, "state 7 in its scope, but there is none"),
        ({"observations": None}, "no observation space"),
        ({"fully_observed": [True, False]}, "fully_observed is for 2 state factors"),
    ],
)
def test_wrong_networks_are_refused_with_the_culprit(changes, message):
    with pytest.raises(ModelError, match=message):
        network(**changes)


def test_a_circle_is_refused():
    a, b = Node("next_state", 0), Node("next_state", 1)
    with refused(ModelError):
        TwoSliceNetwork(
            Space([Factor("a", 2), Factor("b", 2)]),
            Space.single("act", 1),
            initial=[Table([Node("state", 0)], [1, 0]), Table([Node("state", 1)], [1, 0])],
            transitions=[Table([b, a], np.eye(2)), Table([a, b], np.eye(2))],
        )


def test_a_large_model_of_events_is_flattened_in_little_memory():
    """Arrays of 1,350 states, 36 actions and 49 observations would take 26 gigabytes."""
    tracemalloc.start()
    model = patrol(5, 2).flatten()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert model.is_sparse
    assert peak < 100e6


@given(model=factored_models(events=True))
def test_rewards_in_some_states_are_those_of_the_matrices(model):
    states = np.arange(len(model.state_space))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        expected = model.rewards
    for action in range(len(model.action_space)):
        np.testing.assert_allclose(rewards_at(model.network, action, states), expected[:, action], atol=1e-12)
        np.testing.assert_allclose(rewards_at(model.network, action, states[::-2]), expected[::-2, action], atol=1e-12)


def rounded_network(digits):
    """Return a network of two factors and two observations, with thirds written with so many digits."""
    third = round(1 / 3, digits)
    row = [third, third, third]
    return TwoSliceNetwork(
        Space([Factor("one", 3, prefix="a"), Factor("other", 3, prefix="b")]),
        Space.single("agent", ["wait"]),
        Space([Factor("left", 3, prefix="l"), Factor("right", 3, prefix="r")]),
        initial=[Table([Node("state", place)], [0.5, 0.25, 0.25]) for place in range(2)],
        transitions=[Table([Node("state", place), Node("next_state", place)], [row] * 3) for place in range(2)],
        observation=[
            Table([Node("next_state", place), Node("observation", place)], [row, [1, 0, 0], row]) for place in range(2)
        ],
        utilities=[Table([Node("next_state", 0)], [1, 2, 4]), Table([Node("observation", 1)], [1, 2, 4])],
    )


@pytest.mark.parametrize("digits", [5, 17])
def test_sums_that_are_not_quite_one_count_as_in_matrices(digits):
    """Matrices are normalised when they are made, so rows that are computed one by one are, too."""
    network = rounded_network(digits)
    assert network.is_exact == (digits == 17)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        flat = FactoredPOMDP(network, discount=0.9).flatten()
    of, after, chances = following(network, 0, np.arange(9))
    transitions = np.zeros((9, 9))
    np.add.at(transitions, (of, after), chances)
    np.testing.assert_allclose(transitions, dense(flat.transition_matrix(0)), atol=1e-15)
    told = dense(flat.observation_matrix(0))
    for seen in ([4], [0, 1, 2], [1, 4, 7], [0, 5], list(range(9))):
        chances = observed_chances(network, 0, None, np.arange(9), seen)
        np.testing.assert_allclose(chances, told[:, seen].sum(axis=1), atol=1e-15)
    np.testing.assert_allclose(rewards_at(network, 0, np.arange(9)), flat.rewards[:, 0], atol=1e-12)
