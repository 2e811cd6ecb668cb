"""Pruning: what is forgotten, and what stays as it was."""

from __future__ import annotations

import numpy as np
import pytest
from places import TIGER

from mdm import load_model
from mdm.solvers import Limits
from mdm.solvers.sarsop import pruning
from mdm.solvers.sarsop.graph import NODES
from mdm.solvers.sarsop.pruning import forget_nodes, needed_vectors, prune_points, prune_vectors
from mdm.solvers.sarsop.solver import _Search


def searched():
    limits = Limits(gap=1e-4)
    search = _Search(load_model(TIGER).with_discount(0.95), limits)
    while search.bounds()[1] - search.bounds()[0] > 1e-4:
        search.run(limits)
    return search


def test_pruning_leaves_the_bounds_as_they_are():
    search = searched()
    graph, layout, roots = search._graph, search._layout, search._roots
    before, many = search.bounds(), search.size
    prune_vectors(graph, layout, needed_vectors(graph, layout, roots, 1e-9))
    prune_points(graph)
    lower, upper = search.bounds()
    assert search.size < many
    assert (lower, upper) == pytest.approx(before, abs=1e-8)
    assert search.policy(search.whole()).value([0.5, 0.5]) == pytest.approx(before[0], abs=1e-8)


def test_what_only_bad_actions_lead_to_is_forgotten_and_can_be_found_again():
    search = searched()
    before, many = search.bounds(), int(search._graph.counts[NODES])
    search._roots = forget_nodes(search._graph, search._roots)
    assert search._graph.counts[NODES] < many
    assert search.bounds() == pytest.approx(before)
    codes = search._graph.code[: search._graph.counts[NODES]]
    table = search._graph.table
    assert sorted(table[table >= 0]) == list(range(len(codes)))
    search.run(Limits(gap=1e-6))
    search.run(Limits(gap=1e-6))
    lower, upper = search.bounds()
    assert lower >= before[0] - 1e-9
    assert upper <= before[1] + 1e-9


def test_stretches_are_moved_to_the_front_a_part_at_a_time(monkeypatch):
    monkeypatch.setattr(pruning, "_CHUNK", 3)
    starts, sizes = np.array([1, 4, 9, 10, 17]), np.array([2, 4, 1, 7, 1], dtype=np.int32)
    array = np.arange(20)
    wanted = np.concatenate([array[start : start + size] for start, size in zip(starts, sizes, strict=True)])
    count = pruning._move((array,), starts, sizes)
    assert array[:count].tolist() == wanted.tolist()
    assert pruning._move((array,), starts[:0], sizes[:0]) == 0


def test_beliefs_are_let_go_of_and_vectors_stay():
    search = searched()
    before = search.whole()
    search.forget_beliefs()
    assert len(search._graph.weight) == 0
    for kept, was in zip(search.whole(), before, strict=True):
        np.testing.assert_array_equal(kept, was)
