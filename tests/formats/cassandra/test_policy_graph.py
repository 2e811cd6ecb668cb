"""Policy graphs, with and without the values of a file beside them."""

from __future__ import annotations

import numpy as np
import pytest
from places import POLICIES
from policy_files import assert_refused, model_of
from sentences import refused

from mdm import FormatError
from mdm.formats import files as policies
from mdm.policies import FiniteStateController


def test_a_graph_has_the_values_of_the_file_beside_it():
    graph = policies.load_policy(POLICIES / "tiger.pg", model_of())
    assert isinstance(graph, FiniteStateController)
    assert graph.actions == (0, 1, 2)
    assert graph.successors == ((2, 1), (0, 0), (0, 0))
    assert graph.start_node(np.array([0.05, 0.95])) == 1
    assert graph.value(np.array([0.5, 0.5])) == pytest.approx(19.37)


def test_a_graph_of_observations_that_cannot_occur(tmp_path):
    graph = policies.load_policy(POLICIES / "impossible.pg")
    assert graph.successors == ((1, None), (None, 0))
    assert graph.values is None
    without_suffix = tmp_path / "graph.txt"
    without_suffix.write_text((POLICIES / "impossible.pg").read_text())
    assert policies.load_policy(without_suffix).successors == graph.successors


def test_a_graph_beside_vectors_of_another_is_refused(tmp_path):
    (tmp_path / "tiger.pg").write_text((POLICIES / "tiger.pg").read_text())
    (tmp_path / "tiger.alpha").write_text("0\n1 2\n")
    with refused(FormatError):
        policies.load_policy(tmp_path / "tiger.pg")


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("0 0 1 0\n1 3 0 0\n", 2, "no action 3"),
        ("0 0 1 0\n1 1 0 2\n", 2, "node 1 has the successor 2, but the graph has nodes 0 to 1"),
        ("0 0 1 0\n1 1 0 99999999999999999999999\n", 2, "has the successor 9999"),
        ("0 0 1 0\n\n1 1 0\n", 3, "node 1: a successor for each of 2 observations"),
        ("0 0 1 0\n1 1 0 0 0\n", 2, "but 3 are given"),
        ("0 0 1 0\n2 1 0 0\n", 2, "node 1 was expected, not 2"),
        ("0 0 1 0\n1 X 0 0\n", 2, "node 1: 'X' is not an index"),
        ("0 0 y 0\n", 1, "node 0: 'y' is not an index"),
        ("0 0 -1 0\n", 1, "'-1' is not an index"),
        ("0 0 0\n", 1, "for each of 2 observations was expected"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path, text, line, words):
    assert_refused(tmp_path / "x.pg", text, line, words)
