"""Alpha vectors, value functions, graphs, planes and tables, each from a small file and with its errors."""

from __future__ import annotations

import numpy as np
import places
import pytest

from mdm import FormatError
from mdm.formats import policies
from mdm.models import POMDP
from mdm.policies import AlphaVectors, FiniteStateController, MaskedAlphaVectors, MixedAlphaVectors, QTable

DATA = places.DATA / "policies"


def tiger(num_states=2, num_actions=3, num_observations=2):
    uniform = np.full((num_actions, num_states, num_observations), 1 / num_observations)
    stay = [np.eye(num_states)] * num_actions
    return POMDP(stay, uniform, np.zeros((num_states, num_actions)), discount=0.9)


def pairs(policy):
    return [(action, vector.tolist()) for action, vector in zip(policy.actions, policy.vectors, strict=True)]


def test_alpha_vectors():
    policy = policies.load_policy(DATA / "tiger.alpha", tiger())
    assert isinstance(policy, AlphaVectors)
    assert pairs(policy) == [(0, [19.37, 19.37]), (1, [-81.6, 28.4]), (2, [28.4, -81.6])]


def test_a_value_function_may_name_no_action_and_end_without_a_line_end():
    policy = policies.load_policy(DATA / "tiger.vf", tiger())
    assert pairs(policy) == [(0, [19.37, 19.37]), (2, [28.4, -81.6])]


def test_a_graph_has_the_values_of_the_file_beside_it():
    graph = policies.load_policy(DATA / "tiger.pg", tiger())
    assert isinstance(graph, FiniteStateController)
    assert graph.actions == (0, 1, 2)
    assert graph.successors == ((2, 1), (0, 0), (0, 0))
    assert graph.start_node(np.array([0.05, 0.95])) == 1
    assert graph.value(np.array([0.5, 0.5])) == pytest.approx(19.37)


def test_a_graph_of_observations_that_cannot_occur(tmp_path):
    graph = policies.load_policy(DATA / "impossible.pg")
    assert graph.successors == ((1, None), (None, 0))
    assert graph.values is None
    without_suffix = tmp_path / "graph.txt"
    without_suffix.write_text((DATA / "impossible.pg").read_text())
    assert policies.load_policy(without_suffix).successors == graph.successors


def test_a_graph_beside_vectors_of_another_is_refused(tmp_path):
    (tmp_path / "tiger.pg").write_text((DATA / "tiger.pg").read_text())
    (tmp_path / "tiger.alpha").write_text("0\n1 2\n")
    with pytest.raises(FormatError, match=r"tiger\.pg: the graph's 3 nodes are not those of tiger\.alpha"):
        policies.load_policy(tmp_path / "tiger.pg")


def test_a_q_table_of_plain_rows():
    policy = policies.load_policy(DATA / "q_table.txt")
    assert isinstance(policy, QTable)
    assert policy.values.tolist() == [[0, 1.5, -2], [3, 0.5, 1]]


def test_two_columns_without_blank_lines_are_a_table(tmp_path):
    (tmp_path / "q").write_text("0 1\n2 3\n4 5\n")
    assert policies.load_policy(tmp_path / "q").values.tolist() == [[0, 1], [2, 3], [4, 5]]
    (tmp_path / "q").write_text("0 -1\n2 3\n")
    assert isinstance(policies.load_policy(tmp_path / "q"), AlphaVectors)
    assert policies.load_policy(tmp_path / "q", kind="q").values.tolist() == [[0, -1], [2, 3]]


def test_planes():
    policy = policies.load_policy(DATA / "masked.policy")
    assert isinstance(policy, MaskedAlphaVectors)
    assert policy.vectors == ({0: 5, 1: 4.5}, {0: 1, 1: 1.5, 2: -0.2})
    assert policy.actions == [0, 1]
    assert policies.load_policy(DATA / "masked.policy", tiger(4)).num_states == 4


def test_planes_over_all_states_are_plain_vectors(tmp_path):
    text = '{\npolicyType => "MaxPlanesLowerBound",\naction => 1,\nentries => [\n1, 3\n0, 2\n]\n'
    (tmp_path / "x").write_text(text)
    policy = policies.load_policy(tmp_path / "x")
    assert isinstance(policy, AlphaVectors)
    assert pairs(policy) == [(1, [2, 3])]


def test_planes_of_an_observed_state():
    policy = policies.load_policy(DATA / "observed.policy")
    assert isinstance(policy, MixedAlphaVectors)
    assert [pairs(vectors) for vectors in policy.sets] == [[(0, [24.5, 3])], [(1, [-81.5, 28.5])]]
    assert policies.load_policy(DATA / "observed.policy", tiger(6)).states.shape == (3, 2)
    with pytest.raises(FormatError, match="observed value 1, but 2 hidden states leave 1"):
        policies.load_policy(DATA / "observed.policy", tiger())


HEAD = 'policyType => "MaxPlanesLowerBound"\n'
OBSERVED = 'policyType => "MaxPlanesLowerBoundWithObservedState"\n'


@pytest.mark.parametrize(
    ("name", "text", "line", "words"),
    [
        ("x.alpha", "0\n1 2\n\n1 2\n3 4\n", 4, "an action's index was expected, not '1 2'"),
        ("x.alpha", "0\n1 2\n\n-1\n3 4\n", 4, "not '-1'"),
        ("x.alpha", "0\n1 2\n\n1\n", 4, "its vector is missing"),
        ("x.alpha", "0\n1 2\n\n1\n3\n", 5, "2 values were expected, but 1"),
        ("x.alpha", "0\n1 x\n", 2, "'x'"),
        ("x.alpha", "0\n1 1e999\n", 2, "not finite"),
        ("x.alpha", "3\n1 2\n", 1, "no action 3: the model's 3 count from 0"),
        ("x.alpha", "0\n1 2 3\n", None, "3 states and 3 actions, but the model has 2 and 3"),
        ("x.pg", "0 0 1 0\n1 3 0 0\n", 2, "no action 3"),
        ("x.pg", "0 0 1 0\n1 1 0 2\n", 2, "node 1 is followed by node 2, but the graph's 2 nodes"),
        ("x.pg", "0 0 1 0\n1 1 0 99999999999999999999999\n", 2, "followed by node 9999"),
        ("x.pg", "0 0 1 0\n\n1 1 0\n", 3, "node 1: a successor for each of 2 observations"),
        ("x.pg", "0 0 1 0\n1 1 0 0 0\n", 2, "but 3 are given"),
        ("x.pg", "0 0 1 0\n2 1 0 0\n", 2, "node 1 was expected, not 2"),
        ("x.pg", "0 0 1 0\n1 X 0 0\n", 2, "node 1: 'X' is no index"),
        ("x.pg", "0 0 y 0\n", 1, "node 0: 'y' is no index"),
        ("x.pg", "0 0 -1 0\n", 1, "'-1' is no index"),
        ("x.pg", "0 0 0\n", 1, "for each of 2 observations was expected"),
        ("x.vf", "0 -1\n1 2\n\n3 -1\n1 2\n", 4, "no action 3"),
        ("q.txt", "0 1 2\n0 1 x\n", 2, "'x'"),
        ("q.txt", "0 1 2\n0 1\n", 2, "3 values were expected, but 2"),
        ("q.txt", "0 1 2\n0 1 nan\n", None, "action 2 in state 1 is NaN"),
        ("q.txt", "0 1 2\n", None, "1 states and 3 actions"),
        ("z", HEAD, None, "no planes"),
        ("z", 'policyType => "Sawtooth"\naction => 0\n0, 1\n', 1, "is no type of policy"),
        ("z", HEAD + "action => 3\n0, 1\n", 2, "from 0 to 2"),
        ("z", HEAD + "action => -1\n0, 1\n", 2, "'-1'"),
        ("z", HEAD + "action => 0\n0, 1\n0, 2\n", 4, "two entries for state 0"),
        ("z", HEAD + "action => 0\n0, x\n", 3, "'x' is no finite number"),
        ("z", HEAD + "action => 0\n0, inf\n", 3, "no finite number"),
        ("z", HEAD + "action => 0\n0; 1\n", 3, "a state, a comma and a value"),
        ("z", HEAD + "0, 1\n", 2, "before the first plane's action"),
        ("z", HEAD + "action => 0\nnumEntries => 2\n0, 1\n", 2, "numEntries is 2, but 1"),
        ("z", HEAD + "action => 0\n", 2, "0 are given"),
        ("z", HEAD + "numPlanes => 2\naction => 0\n0, 1\n", None, "numPlanes is 2, but 1"),
        ("z", HEAD + "action => 0\nbackups => 3\n0, 1\n", 3, "'backups' is nothing"),
        ("z", HEAD + "action => 0\n2, 1\n", None, "state 2, but the model's 2 count from 0"),
        ("z", OBSERVED + "action => 0\n0, 1\n", 2, "no observed state val"),
        ("z", OBSERVED + "action => 0\nobserved state val => 0\n1, 1\n", 2, "each of 2 hidden states"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path, name, text, line, words):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(FormatError) as caught:
        policies.load_policy(path, tiger())
    assert words in str(caught.value)
    assert caught.value.line == line
    assert caught.value.file == str(path)


def test_a_graph_needs_observations(tmp_path):
    model = tiger()
    with pytest.raises(FormatError, match="2 actions and 2 observations, but the model has 3 and 2"):
        policies.load_policy(_archived(tmp_path, FiniteStateController([0, 1], [[0, 0], [1, 1]])), model)
    with pytest.raises(FormatError, match="values are for 3 states, but the model has 2"):
        policies.load_policy(_archived(tmp_path, FiniteStateController([0], [[0, 0]], 3, values=[[1, 2, 3]])), model)


def _archived(folder, policy):
    policies.save_policy(policy, folder / "x.npz")
    return folder / "x.npz"


@pytest.mark.parametrize("name", ["tiger.alpha", "tiger.pg", "mixed.policy", "masked.policy", "team.policy"])
def test_a_kind_of_table_is_asked_of_tables_only(name):
    with pytest.raises(FormatError, match="no table"):
        policies.load_policy(DATA / name, kind="q")


def test_a_kind_that_plain_rows_are_not(tmp_path):
    with pytest.raises(FormatError, match="a matrix, but kind='table'"):
        policies.load_policy(DATA / "q_table.txt", kind="table")
