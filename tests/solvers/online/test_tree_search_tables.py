"""What a tree search reads of a model, and the bounds it begins with."""

from __future__ import annotations

import gc

import numpy as np
import pytest
from hypothesis import given, settings
from random_models import dense, flat_models
from sentences import refused

from mdm import ModelError
from mdm.loading import spared
from mdm.models import MDP, FactoredMDP, TwoSliceNetwork
from mdm.models.dynamics import Rows
from mdm.problems import tag, tiger
from mdm.runtime.process.frames import HEADER, frame, unframed
from mdm.solvers import TreeSearch
from mdm.solvers.online.tree_search import received, search_tables


def row(rows, number, width):
    """Return a row as an array."""
    found = np.zeros(width)
    entries = slice(int(rows.starts[number]), int(rows.starts[number + 1]))
    np.add.at(found, rows.columns[entries].astype(int), rows.values[entries])
    return found


@given(flat_models(events=True, finer=False))
@settings(max_examples=30)
def test_rows_are_those_of_the_model(model):
    model = model.with_discount(0.5)
    tables = search_tables(model, upper=None, lower=None)
    size = len(model.state_space)
    for action in range(len(model.action_space)):
        for state in range(size):
            at = int(tables.transitions.first[action]) + state
            np.testing.assert_allclose(row(tables.transitions, at, size), dense(model.transition_matrix(action))[state])
            if not tables.by_transition:
                seen = int(tables.observations.first[action]) + state
                found = row(tables.observations, seen, tables.num_observations)
                if model.kind == "MDP":
                    np.testing.assert_array_equal(found, np.eye(size)[state])
                else:
                    np.testing.assert_allclose(found, dense(model.observation_matrix(action))[state])


@given(flat_models(events=True, finer=False))
@settings(max_examples=30)
def test_each_action_s_value_lies_between_its_bounds(model):
    model = model.with_discount(0.5)
    tables = search_tables(model, upper=None, lower=None)
    matrices = [dense(model.transition_matrix(a)) for a in range(len(model.action_space))]
    known = np.zeros(len(model.state_space))
    for _ in range(60):  # of who sees the state
        known = np.max([model.rewards[:, a] + 0.5 * matrix @ known for a, matrix in enumerate(matrices)], axis=0)
    for action, matrix in enumerate(matrices):
        slack = 1e-4 * (1 + np.abs(model.rewards).max())
        assert (tables.upper[:, action] >= model.rewards[:, action] + 0.5 * matrix @ known - slack).all()
        blind = np.linalg.solve(np.eye(len(matrix)) - 0.5 * matrix, model.rewards[:, action])
        assert (tables.lower[:, action] <= blind + slack).all()
    assert tables.actions.tolist() == list(range(len(matrices)))


def test_a_false_negative_is_an_observation_of_its_own_and_plans_are_added():
    model = tiger(discount=0.5)
    plain = search_tables(model, upper=None, lower=None)
    missed = search_tables(model.with_false_negatives(0), upper=None, lower=(np.array([[7.0, 8.0]]), [2]))
    assert set(plain.observations.columns.tolist()) == {0, 1}
    assert set(missed.observations.columns.tolist()) == {1, 2}
    assert missed.actions.tolist() == [0, 1, 2, 2]
    assert missed.lower[:, -1].tolist() == [7, 8]


def test_values_of_what_never_ends_have_no_bounds():
    with refused(ModelError):
        search_tables(MDP([np.eye(2)], [[0.0], [1.0]], discount=1), upper=None, lower=None)


def unobserved(network):
    """Return a network without its observations."""
    parts = {name: getattr(network, name) for name in ("initial", "transitions", "utilities")}
    return TwoSliceNetwork(network.states, network.actions, None, observation=[], **parts)


@pytest.mark.parametrize(
    ("model", "left_out"),
    [
        (tag, 2),
        (lambda: tag().revealed(), 2),
        (lambda: tag().with_false_negatives(0), 1),
        (lambda: FactoredMDP(unobserved(tag().network), discount=0.9), 1),
    ],
    ids=["observations", "seen factors", "a false negative", "an MDP"],
)
def test_what_another_process_can_map_is_not_sent(model, left_out, tmp_path, monkeypatch):
    monkeypatch.setenv("MDM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("mdm.formats.archive.flat._LEAST", 0)
    search = TreeSearch(spared(model()), expansions=1)
    data = frame(search.parts())
    (path,) = (tmp_path / "cache").iterdir()
    given, options = unframed(data[HEADER:])
    assert sum(len(rows.starts) == 0 for rows in given.tables[:2]) == left_out
    found = received(given)
    for one, other in zip(search._tables, found, strict=True):
        for array, again in zip(one, other, strict=True) if isinstance(one, Rows) else [(one, other)]:
            assert np.array_equal(array, again)
    assert np.shares_memory(found.transitions.values, given.model.flatten().stacked["T"].values)
    assert np.shares_memory(found.rewards, given.model.flatten().rewards)
    # Where the file has gone, and cannot be made again, it is computed.
    path.unlink()
    monkeypatch.setenv("MDM_CACHE", "")
    del found, given
    gc.collect()
    found = received(unframed(data[HEADER:])[0])
    assert np.array_equal(found.transitions.values, search._tables.transitions.values)
    assert options["expansions"] == 1


def test_what_it_cannot_map_is_sent_whole():
    tables, _ = TreeSearch(tiger(), expansions=1).parts()
    assert received(tables) is tables
