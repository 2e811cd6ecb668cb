"""Factors of a network, pooled: what was counted in some states is known of the others."""

from __future__ import annotations

import numpy as np
import pytest
from estimated import visits, wandering
from scipy.linalg import expm

import mdm
from mdm.estimation import chains_of, statistics
from mdm.estimation.reestimation import pool_of
from mdm.models import Factor, FactoredMDP, Node, Space, Table, TwoSliceNetwork

LAMP, DOOR = Node("state", 0), Node("state", 1)
NEXT = Node("next_state", 0), Node("next_state", 1)
ACTIONS = Space.single("robot", ["wait", "look"])


def network(fails, *, opens=0.5, linked=False):
    """Return a model whose lamp fails and is mended at dawn, and whose door swings, whatever the robot does."""
    lamp = Table([LAMP, NEXT[0]], [[0.75, 0.25], [fails, 1 - fails]])
    door = Table([DOOR, NEXT[1]], [[1 - opens, opens], [0.125, 0.875]])
    if linked:
        door = Table([NEXT[0], DOOR, NEXT[1]], [door.values, door.values])
    states = Space([Factor("lamp", ["off", "on"]), Factor("door", ["shut", "open"])])
    made = TwoSliceNetwork(
        states,
        ACTIONS,
        initial=[Table([node], [0.5, 0.5]) for node in (LAMP, DOOR)],
        transitions=[lamp, door],
        utilities=[Table([LAMP], [0, 1])],
    )
    return FactoredMDP(made, discount=0.9)


def test_steps_are_counted_for_each_factor_alone():
    told = visits([0, 2, 2, 3, 0, 1])
    chains = chains_of(told, kind="steps")
    pool = pool_of(network(0.1), chains.stays(), "steps")
    symbols, weights = pool.weights(1, 3)  # never looked anywhere
    assert symbols.tolist() == [0, 1, 2, 3]
    # From on: twice on, once off. From open: once shut. The old row counts as one visit.
    off, shut = (1 + 0.1) / 4, (1 + 0.125) / 2
    assert weights == pytest.approx([off * shut, off * (1 - shut), (1 - off) * shut, (1 - off) * (1 - shut)])


def test_a_row_that_was_never_visited_is_near_the_truth_in_the_new_model():
    truth, used = network(0.4), network(0.05)
    told = visits(wandering(truth.transition_matrix("wait"), 3_000, seed=1))
    report = statistics(told, used, kind="steps")
    assert ("look", "on open") in report.unvisited
    assert report.model.transition("look", "on open") == pytest.approx(truth.transition("look", "on open"), abs=0.03)


def test_jumps_are_rates_of_each_factor_by_the_time_exposed():
    """Of the lamp: on for 6 s, in which it failed once; of the door: open for 7 s, shut for 6, swinging once each."""
    told = visits([2, 3, 1, 0], times=[0, 2, 6, 9])
    model = network(0.1)
    chains = chains_of(told, kind="jumps")
    pool = pool_of(model, chains.stays(), "jumps")
    flat = model.flatten().transition_matrix(0)
    step = sum(seconds * (1 - flat[state, state]) for state, seconds in ((2, 2), (3, 4), (1, 3))) / 3
    assert pool.step == pytest.approx(step)
    symbols, weights = pool.weights(1, 3)
    assert symbols.tolist() == [0, 1, 2]
    off = (1 + 0.1) * step / (6 + step)
    shut = (1 + 0.125) * step / (7 + step)
    assert weights == pytest.approx([off * shut, off, shut])
    assert pool.lasting()[3, 1] == pytest.approx(step / (off * shut + off + shut))
    lamp = np.array([[-0.25 / (3 + step), 0.25 / (3 + step)], [1.1 / (6 + step), -1.1 / (6 + step)]])
    door = np.array([[-1.5 / (2 + step), 1.5 / (2 + step)], [1.125 / (7 + step), -1.125 / (7 + step)]])
    new = pool.model()
    assert isinstance(new, FactoredMDP)
    for seconds, made in ((step, new), (2.0, pool.model(2.0))):
        expected = np.kron(expm(lamp * seconds), expm(door * seconds))
        assert made.transition_matrix("look") == pytest.approx(expected)


def test_the_new_model_of_a_network_is_one_with_its_structure():
    told = visits(wandering(network(0.4).transition_matrix("wait"), 200, seed=1))
    new = statistics(told, network(0.05), kind="steps").model
    assert isinstance(new, FactoredMDP)
    assert [set(each.scope) for each in new.network.transitions] == [{LAMP, NEXT[0]}, {DOOR, NEXT[1]}]
    assert new.rewards.tolist() == network(0.05).rewards.tolist()


def test_a_step_in_seconds_makes_probabilities_of_all_actions():
    told = visits([2, 3, 1, 0] * 50, times=np.cumsum([0, *[2, 4, 3, 1] * 50])[:-1])
    report = statistics(told, network(0.1), step=0.5)
    assert (report.durations.means, report.durations.stages) == (0.5, 200)
    # A lamp that is on for 6 s of each 10 and fails once, then is mended after 4.
    rates = np.array([[-1 / 4, 1 / 4], [1 / 6, -1 / 6]])
    chance = expm(0.5 * rates)[1, 0]
    row = report.model.transition("look", "on open")
    assert row[0] + row[1] == pytest.approx(chance, abs=0.05)


def test_models_without_independent_factors_have_no_pool():
    chains = chains_of(visits([0, 1, 2, 0]), kind="steps")
    assert pool_of(network(0.1).flatten(), chains.stays(), "steps") is None
    assert pool_of(network(0.1, linked=True), chains.stays(), "steps") is None
    assert pool_of(mdm.problems.forest(), chains.stays(), "steps") is None
    assert pool_of(network(0.1), [], "jumps") is None
