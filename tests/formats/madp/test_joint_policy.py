"""MADP's joint policies of Dec-POMDPs."""

from __future__ import annotations

import numpy as np
import places
import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm import FormatError, ModelError
from mdm.formats import files as policies
from mdm.models import MDP, POMDP, Factor, Space
from mdm.policies import FiniteStateController, JointController
from mdm.problems import dec_tiger

DATA = places.DATA / "policies"
ACTIONS = ["listen", "open-left", "open-right"]
SOUNDS = ["hear-left", "hear-right"]
TEAM = POMDP(
    [np.eye(2)] * 9,
    np.full((9, 2, 4), 0.25),
    np.zeros((2, 9)),
    discount=0.9,
    actions=Space([Factor("first", ACTIONS), Factor("second", ACTIONS)]),
    observation_names=Space([Factor("first", SOUNDS), Factor("second", SOUNDS)]),
)


def test_a_tree_for_each_agent():
    policy = policies.load_policy(DATA / "team.policy", TEAM)
    assert isinstance(policy, JointController)
    for tree in policy.controllers:
        assert tree.actions == (0, 0, 0, 1, 0, 0, 2)
        assert tree.successors == ((1, 2), (3, 4), (5, 6), *((None, None),) * 4)
    nodes = policy.next_nodes(policy.next_nodes(policy.start, (0, 1)), (0, 1))
    assert policy.actions_at(nodes) == (1, 2)
    assert policy.next_nodes(nodes, (0, 0)) == (None, None)


def test_the_words_of_earlier_versions():
    policy = policies.load_policy(DATA / "earlier_team.policy", TEAM)
    assert [tree.actions for tree in policy.controllers] == [(0, 1, 2), (0,)]
    assert policy.controllers[0].successors[0] == (1, 2)


def test_what_is_written_is_what_madp_writes(tmp_path):
    policies.save_policy(policies.load_policy(DATA / "team.policy", TEAM), tmp_path / "team", TEAM)
    written = (tmp_path / "team").read_text()
    assert (DATA / "team.policy").read_text().startswith(written)


def test_names_of_a_model():
    assert policies.load_policy(DATA / "team.policy", dec_tiger()).num_agents == 2


def single(actions):
    return POMDP(
        [np.eye(2)] * 3,
        np.full((3, 2, 2), 0.5),
        np.zeros((2, 3)),
        discount=0.9,
        actions=actions,
        observation_names=SOUNDS,
    )


@given(st.integers(0, 2**32 - 1))
def test_what_is_written_is_read(tmp_path_factory, seed):
    random = np.random.default_rng(seed)
    policy = JointController(tree(random) for _ in range(2))
    path = tmp_path_factory.mktemp("joint") / "x"
    policies.save_policy(policy, path, TEAM)
    again = policies.load_policy(path, TEAM)
    for one, other in zip(policy.controllers, again.controllers, strict=True):
        assert (one.actions, one.successors) == (other.actions, other.successors)


def tree(random):
    """Return a random tree, its nodes level by level."""
    successors, count = [], 1
    while len(successors) < count:
        grown = random.random(2) < (0.7 if count < 20 else 0)
        successors.append(
            [count + int(grown[:observation].sum()) if grows else None for observation, grows in enumerate(grown)]
        )
        count += int(grown.sum())
    return FiniteStateController(random.integers(3, size=count).tolist(), successors, 3)


def test_observations_that_are_not_one_for_each_agent(tmp_path):
    model = POMDP(
        [np.eye(2)] * 9,
        np.full((9, 2, 2), 0.5),
        np.zeros((2, 9)),
        discount=0.9,
        actions=TEAM.action_space,
        observation_names=SOUNDS,
    )
    with refused(FormatError):
        policies.load_policy(DATA / "team.policy", model)
    with refused(ModelError):
        policies.save_policy(policies.load_policy(DATA / "team.policy", TEAM), tmp_path / "x.npz", model)


def agent(*lines):
    return "Policy for agent 0 (index 0):\n" + "".join(f"{line}\n" for line in lines)


OTHER = "Policy for agent 1 (index 0):\n() --> listen\n"


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("JointPolicyPureVector:\n", None, "0 agents, but the model has 2"),
        (agent("() --> listen"), None, "1 agents, but the model has 2"),
        (agent("() --> dance") + OTHER, 2, "dance"),
        (agent("() --> listen", "(moo) --> listen") + OTHER, 3, "moo"),
        (agent("() --> listen", "() --> listen") + OTHER, 3, "has a line already"),
        (agent("(hear-left) --> listen") + OTHER, 2, "has no line before this one"),
        (agent() + OTHER, None, "agent 'first' has no line"),
        (OTHER, 1, "agent 0 was expected, not 1"),
        ("JointPolicyPureVector:\n() --> listen\n", 2, "precedes the first"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path, text, line, words):
    (tmp_path / "x").write_text(text)
    with pytest.raises(FormatError) as caught:
        policies.load_policy(tmp_path / "x", TEAM)
    assert words in str(caught.value)
    assert caught.value.line == line


def test_without_names_there_is_no_telling():
    mdp = MDP([np.eye(2)], np.zeros((2, 1)), discount=0.9)
    for model in (None, mdp):
        with refused(FormatError):
            policies.load_policy(DATA / "team.policy", model)


def test_what_cannot_be_written(tmp_path):
    leaf = FiniteStateController([0], [[None, None]], 3)
    loop = FiniteStateController([0], [[0, 0]], 3)
    small = FiniteStateController([0], [[None]], 3)
    with refused(ModelError):
        policies.save_policy(JointController([leaf, leaf]), tmp_path / "x")
    with refused(ModelError):
        policies.save_policy(JointController([leaf]), tmp_path / "x", single(["a,b", "b", "c"]))
    with refused(ModelError):
        policies.save_policy(JointController([leaf, loop]), tmp_path / "x", TEAM)
    with refused(ModelError):
        policies.save_policy(JointController([small, leaf]), tmp_path / "x", TEAM)
    with refused(ModelError):
        policies.save_policy(JointController([leaf]), tmp_path / "x", TEAM)
