"""Written ProbModelXML is read as the same model; what it has no place for is refused."""

from __future__ import annotations

import warnings
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from loading import load
from places import each
from random_models import NAMES, assert_same, factored_models, flat_models
from sentences import refused
from strict import pgmx as strict
from strict.numbers import assert_same_numbers

from mdm import ModelError
from mdm.errors import ModelWarning
from mdm.formats import openmarkov as pgmx
from mdm.models import MDP, POMDP, Factor, FactoredMDP, FactoredPOMDP, Node, Space, Table, Tree, TwoSliceNetwork
from mdm.problems import fire_fighting_graph, patrol


@given(model=factored_models(events=True, smallest=2))
def test_factored_models_come_back(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("round") / "model.pgmx"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        pgmx.write(model, path)
    again = load(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        assert_same(model, again)
    assert [f.name for f in again.state_space.factors] == [f.name for f in model.state_space.factors]


@given(model=flat_models(events=True, smallest=2))
def test_flat_models_come_back(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("round") / "model.pgmx"
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*MADP", ModelWarning)  # it reads no such links, but others do
        pgmx.write(model, path)
    assert_same(model, load(path), finer=True)


@given(model=flat_models(names=NAMES, finer=False, smallest=2))
def test_odd_names_are_written_so_that_they_can_be_read(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("round") / "model.pgmx"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        pgmx.write(model, path)
    spellable = all(
        name and name == name.strip() and name.isprintable() and not name.endswith("]")
        for space in (model.state_space, model.action_space)
        for factor in space.factors
        for name in factor.names
    )
    assert_same(model, load(path), named=spellable and model.kind == "MDP")


def test_a_factor_of_one_value_has_no_place_in_it(tmp_path):
    model = MDP([np.eye(1)], [[1.0]], discount=0.9)
    with refused(ModelError):
        pgmx.write(model, tmp_path / "m.pgmx")
    assert list(tmp_path.iterdir()) == []


def test_deep_trees_become_tables(tmp_path):
    tree = Table([Node("action", 0)], [1.0, 2.0])
    for _ in range(40):
        tree = Tree(Node("state", 0), [0, 1], [tree, Table([], 3.0)])
    network = TwoSliceNetwork(
        Space.single("light", ["red", "green"]),
        Space.single("robot", ["go", "stop"]),
        initial=[Table([Node("state", 0)], [0.5, 0.5])],
        transitions=[Table([Node("state", 0), Node("next_state", 0)], np.eye(2))],
        utilities=[tree],
    )
    model = FactoredMDP(network, discount=0.9)
    pgmx.write(model, tmp_path / "m.pgmx")
    assert_same(model, load(tmp_path / "m.pgmx"))


@pytest.mark.parametrize(
    "model", [patrol(), patrol(3, 2), fire_fighting_graph()], ids=["patrol", "two robots", "fires"]
)
def test_standard_problems_come_back(tmp_path, model):
    compare_with_what_comes_back(model, tmp_path)


@pytest.mark.foreign("Access_Synch.pgmx and MAISS_TopLevel.pgmx of MADPToolbox/MADP")
@pytest.mark.parametrize("name", each(["Access_Synch", "MAISS_TopLevel"]))
def test_real_models_come_back(corpus, tmp_path, name):
    compare_with_what_comes_back(load(corpus / "models" / "madp" / f"{name}.pgmx"), tmp_path)


def compare_with_what_comes_back(model, tmp_path):
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*MADP reads one observation", ModelWarning)
        pgmx.write(model, tmp_path / "again.pgmx")
    again = load(tmp_path / "again.pgmx")
    assert again.state_space == model.state_space
    assert again.action_space == model.action_space
    seen = [[factor.names for factor in one.observation_space.factors] for one in (again, model)]
    assert seen[0] == seen[1]  # a variable of the file has a name of its own
    np.testing.assert_allclose(again.rewards, model.rewards, atol=1e-12)
    for action in range(len(model.action_space)):
        assert abs(model.transition_matrix(action) - again.transition_matrix(action)).max() <= 1e-12
        for o in range(len(model.observation_space)):
            assert abs(model.joint_matrix(action, o) - again.joint_matrix(action, o)).max() <= 1e-12


def team(names, seen):
    """Return a model whose agents see each for itself."""
    each = np.array([[0.25, 0.75], [0.5, 0.5]])
    joint = each
    for _ in seen[1:]:
        joint = (joint[..., None] * each.reshape(2, *[1] * (joint.ndim - 1), 2)).reshape(2, -1)
    return POMDP(
        [np.eye(2)] * 2 ** len(names),
        [joint] * 2 ** len(names),
        np.zeros((2, 2 ** len(names))),
        discount=0.9,
        actions=Space(Factor(name, 2) for name in names),
        observation_names=Space(Factor(name, 2) for name in seen),
    )


def test_names_that_begin_others_end_with_their_slice(tmp_path):
    """MADP takes the first variable whose name begins with the one that it looks for."""
    pgmx.write(team(["agent", "bot"], ["agent", "see"]), tmp_path / "m.pgmx")
    text = (tmp_path / "m.pgmx").read_text()
    for name in ("agent [0]", "agent_2 [1]", "see [1]"):
        assert f'<Variable name="{name}" timeSlice="{name[-2]}"' in text
    again = load(tmp_path / "m.pgmx")
    assert [factor.name for factor in again.action_space.factors] == ["agent", "bot"]
    pgmx.write(team(["left", "right"], ["hear", "see"]), tmp_path / "n.pgmx")
    assert "[" not in (tmp_path / "n.pgmx").read_text()


def test_independent_observations_are_not_linked(tmp_path):
    pgmx.write(team(["left", "right"], ["hear", "see"]), tmp_path / "m.pgmx")
    text = (tmp_path / "m.pgmx").read_text()
    assert '<Variable name="hear" timeSlice="1"/><Variable name="see" timeSlice="1"/>' not in text


def test_observations_that_madp_does_not_read_are_told(tmp_path):
    with pytest.warns(ModelWarning, match="MADP reads one observation of each agent, but there are 2 for 1"):
        pgmx.write(team(["robot"], ["hear", "see"]), tmp_path / "m.pgmx")


def test_several_observations_of_events_are_told(tmp_path):
    flat = np.full((4, 2, 4, 2), 0.25)
    model = POMDP(
        [np.eye(2)] * 4,
        np.moveaxis(flat, 2, 1),
        np.zeros((2, 4)),
        discount=0.9,
        actions=Space([Factor("left", 2), Factor("right", 2)]),
        observation_names=Space([Factor("hear", 2), Factor("see", 2)]),
        event_observations=True,
    )
    with pytest.warns(ModelWarning, match="MADP reads one observation where it is of events, but there are 2"):
        pgmx.write(model, tmp_path / "m.pgmx")


@pytest.mark.parametrize("as_tree", [False, True])
def test_utilities_are_over_all_that_madp_needs_to_weigh_them(tmp_path, as_tree):
    """MADP reads no utility of no variable; at slice 1 it needs the parents, and their parents, that are there."""
    state, after, seen = (Node(role, 0) for role in ("state", "next_state", "observation"))
    later = Node("next_state", 1)
    spaces = [Space([Factor("door", 2), Factor("lamp", 3)]), Space([Factor("go", 2)]), Space([Factor("see", 2)])]
    each = np.array([[0.25, 0.75], [0.5, 0.5]])
    lamp = np.array([[0.25, 0.5, 0.25], [0.0, 0.5, 0.5]])
    told = Table([seen], [1.5, -2.0])
    network = TwoSliceNetwork(
        *spaces,
        initial=[Table([state], [0.5, 0.5]), Table([Node("state", 1)], [0.25, 0.25, 0.5])],
        transitions=[Table([state, after], each), Table([after, later], lamp)],
        observation=[Table([later, seen], [[0.5, 0.5], [0.25, 0.75], [1.0, 0.0]])],
        utilities=[Table([], 3.0), Tree(seen, [0, 1], [Table([], 1.5), Table([], -2.0)]) if as_tree else told],
    )
    model = FactoredPOMDP(network, discount=0.9)
    pgmx.write(model, tmp_path / "m.pgmx")
    assert_same_numbers(strict.read(tmp_path / "m.pgmx"), model)
    scopes = [
        {(variable.get("name"), variable.get("timeSlice")) for variable in potential.find("Variables")}
        for potential in ET.parse(tmp_path / "m.pgmx").iter("Potential")
        if potential.find("UtilityVariable") is not None
    ]
    assert scopes == [{("go", "0")}, {("see", "1"), ("lamp", "1"), ("door", "1")}]
    assert_same(load(tmp_path / "m.pgmx"), model)
