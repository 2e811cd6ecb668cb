"""The policy files of other tools, of whatever format, against their models and what is known of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from places import each, foreign

from mdm import FormatError, load_model
from mdm.formats import files as policies
from mdm.policies import (
    AlphaVectors,
    DeterministicPolicy,
    FiniteStateController,
    MaskedAlphaVectors,
    MixedAlphaVectors,
    QTable,
    StochasticPolicy,
)

SUFFIXES = {".alpha", ".policy", ".pg", ".txt"}


@pytest.mark.foreign("policies of cassandra/pomdp-solve, AdaCompNUS/sarsop, JuliaPOMDP and others")
@pytest.mark.parametrize("name", foreign("policies/**/*"))
def test_every_policy_is_read_and_written_back(corpus, tmp_path, name):
    path = corpus / name
    policy = policies.load_policy(path)
    assert policy.num_actions > 0
    copies = [tmp_path / "copy.npz"]
    if not isinstance(policy, FiniteStateController):
        copies.append(tmp_path / ("copy.alpha" if path.suffix == ".alpha" else "copy.policy"))
    else:
        copies.append(tmp_path / "copy.pg")
    for copy in copies:
        policies.save_policy(policy, copy)
        again = policies.load_policy(copy)
        assert type(again) is type(policy)
        if isinstance(policy, AlphaVectors):
            assert again.actions == policy.actions
            np.testing.assert_array_equal(again.vectors, policy.vectors)
        elif isinstance(policy, FiniteStateController):
            assert (again.actions, again.successors) == (policy.actions, policy.successors)


@pytest.mark.foreign("a collection of policy files with one quirk each")
@pytest.mark.parametrize("name", foreign("edge/policy/*"))
def test_files_with_quirks(corpus, name):
    path = corpus / name
    expected = json.loads((corpus / "edge" / "expected.json").read_text())[f"policy/{path.name}"]["expect"]
    policy = policies.load_policy(path)
    if path.suffix == ".alpha":
        vectors = expected["vectors"], expected["length"]
        assert policy.vectors.shape == vectors
        assert policy.actions == sorted(expected["actions"])
        for vector in (expected["first"], expected["last"]):
            assert np.isclose(policy.vectors, vector).all(axis=1).any()
        belief = load_model(corpus / "edge" / "pomdp" / Path(expected["model"]).name).initial_belief
        assert policy.value(belief) == pytest.approx(expected["value_at_b0"])
        assert policy.action(belief) == expected["action_at_b0"]
    elif "rows" in expected:
        rows = [[str(node), str(policy.action_at(node)), *map(str, row)] for node, row in enumerate(policy.successors)]
        assert rows == expected["rows"]
    elif "successors" in expected:
        assert policy.num_nodes == expected["nodes"]
        assert [list(row) for row in policy.successors] == expected["successors"]
    elif "obs_values" in expected:
        assert isinstance(policy, MixedAlphaVectors)
        assert policy.states.shape == (len(expected["obs_values"]), expected["length"])
        assert sum(len(vectors.actions) for vectors in policy.sets) == expected["vectors"]
    elif "value" in expected:
        assert isinstance(policy, MaskedAlphaVectors)
        for belief, (value, action) in expected["value"].items():
            assert policy.value(np.array(json.loads(belief))) == value
            assert policy.action(np.array(json.loads(belief))) == action
    elif "policy" in expected:
        assert isinstance(policy, DeterministicPolicy)
        assert list(policy.actions) == expected["policy"]
    elif "pi_state_action" in expected:
        assert isinstance(policy, StochasticPolicy)
        np.testing.assert_allclose(policy.probabilities.T, expected["pi_state_action"])
    elif "R" in expected:
        np.testing.assert_array_equal(policies.load_rewards(path), expected["R"])
    elif "Q" in expected:
        assert isinstance(policy, QTable)
        np.testing.assert_array_equal(policy.values, expected["Q"])
    elif "action" in expected:
        assert (policy.actions, policy.vectors.shape) == ([expected["action"]], (1, expected["length"]))
    else:
        known = [(action, vector) for action, _, vector in expected["vectors"] if action is not None]
        assert [(a, v.tolist()) for a, v in zip(policy.actions, policy.vectors, strict=True)] == sorted(known)


@pytest.mark.foreign("a collection of broken policy files")
@pytest.mark.parametrize("name", [name for name in foreign("malformed/*") if Path(name or "x.pg").suffix in SUFFIXES])
def test_broken_files_are_refused(corpus, name):
    path = corpus / name
    expected = json.loads((corpus / "malformed" / "expected.json").read_text())["cases"][path.name]
    model = load_model(corpus / "models" / "pomdp-solve" / "tiger.95.POMDP") if path.name.startswith("u11") else None
    with pytest.raises(FormatError) as caught:
        policies.load_policy(path, model)
    assert str(path) in str(caught.value)
    if expected["line"] is not None:
        assert caught.value.line == expected["line"]
    for words in expected["message_mentions"]:
        assert words in str(caught.value)


SOLVED = ["1d", "cheese.95", "parr95.95", "tiger.95", "tiger.aaai"]
"""Those whose values had converged when the solver ended, so that its graph closes on itself."""


@pytest.mark.filterwarnings("ignore::mdm.ModelWarning")
@pytest.mark.foreign("models and policies of cassandra/pomdp-solve")
@pytest.mark.parametrize("name", each(SOLVED))
def test_following_a_graph_earns_what_its_vectors_say(corpus, name):
    """Nodes, observations and vectors are matched rightly: alpha_n(s) = R(s, a) + discount sum T O alpha_next(s')."""
    model = load_model(corpus / "models" / "pomdp-solve" / f"{name}.POMDP")
    graph = policies.load_policy(corpus / "policies" / "pomdp-solve" / f"{name}.pg", model)
    for node in range(graph.num_nodes):
        action = graph.action_at(node)
        transitions, observations = (
            matrix if isinstance(matrix, np.ndarray) else matrix.toarray()
            for matrix in (model.transition_matrix(action), model.observation_matrix(action))
        )
        expected = model.rewards[:, action].copy()
        for observation in range(graph.num_observations):
            following = graph.next_node(node, observation)
            reached = transitions * observations[:, observation]
            if following is not None:
                expected += model.discount * reached @ graph.values[following]
        np.testing.assert_allclose(graph.values[node], expected, atol=1e-5)


@pytest.mark.filterwarnings("ignore::mdm.ModelWarning")
@pytest.mark.foreign("models of cassandra/pomdp-solve and policies of AdaCompNUS/sarsop")
@pytest.mark.parametrize("name", each(["1d", "4x3.95", "cheese.95", "shuttle.95", "tiger.95"]))
def test_the_policies_of_sarsop_fit_their_models(corpus, name):
    model = load_model(corpus / "models" / "pomdp-solve" / f"{name}.POMDP")
    policy = policies.load_policy(corpus / "policies" / "sarsop" / f"{name}.policy", model)
    other = corpus / "policies" / "pomdp-solve" / f"{name}.alpha"
    if other.exists():
        exact = policies.load_policy(other, model).value(model.initial_belief)
        assert policy.value(model.initial_belief) == pytest.approx(exact, rel=1e-2)


@pytest.mark.foreign("momdp.policy of JuliaPOMDP/POMDPXFiles.jl")
def test_mixed_observability_of_a_real_policy(corpus):
    policy = policies.load_policy(corpus / "policies" / "pomdpxfiles-momdp.policy")
    belief = np.zeros(policy.num_states)
    belief[4:8] = 0.25  # the second observed value, all hidden states alike
    vectors = np.array([[10] * 4, [23.3593, 15.0887, 16.3759, 7.73781], [17.5987, 17.5987, 9.025, 9.025]])
    assert policy.value(belief) == pytest.approx(vectors.mean(axis=1).max())
    assert policy.action(belief) == 4
