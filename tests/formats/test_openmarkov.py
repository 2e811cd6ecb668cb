"""ProbModelXML: the corpus' files against MADP's own numbers."""

from __future__ import annotations

import contextlib
import json
import random
import re

import numpy as np
import pytest
from hypothesis import given, strategies as st
from loading import assert_refused_where_it_breaks, load
from mutation import mutated
from places import CORPUS, DATA, each
from random_models import assert_same, dense

from mdm import FormatError

SIZES = {
    "MAISS_TopLevel": (1584, 16, 13),
    "MAISS_Patrol_Single": (126, 6, 8),
    "Access": (360, 6, 9),
    "Access_Large_Synch": (216, 54, 256),
    "Access_Synch": (72, 8, 96),
    "FFG343": (81, 8, 8),
    "DTPGMX": (2, 9, 4),
}
"""States, joint actions and joint observations, from MADP."""
GUARD = (DATA / "models" / "guard.pgmx").read_text()
EVENTS = {"MAISS_TopLevel", "MAISS_Patrol_Single", "Access"}


def entries(path):
    """Return what is expected of the files of a folder."""
    file = CORPUS / path
    return json.loads(file.read_text()) if file.is_file() else {}


EDGE = {file: entry for file, entry in entries("edge/expected.json").items() if file.endswith(".pgmx")}
MALFORMED = {
    file: entry for file, entry in entries("malformed/expected.json").get("cases", {}).items() if file.endswith(".pgmx")
}


def weights(*shape):
    """Return MADP's weights of a checksum, for arrays of up to four axes."""
    primes = (7919, 104729, 1299709, 15485863)
    grid = np.ix_(*(np.arange(size, dtype=np.int64) * prime for size, prime in zip(shape, primes, strict=False)))
    return (sum(grid) % 1000003) / 1000003


@pytest.mark.foreign(".pgmx models of MADPToolbox/MADP")
@pytest.mark.parametrize("name", each(sorted(SIZES)))
def test_real_models_have_the_sizes_that_madp_finds(corpus, name):
    model = load(corpus / "models" / "madp" / f"{name}.pgmx")
    sizes = (len(model.state_space), len(model.action_space), len(model.observation_space))
    assert sizes == SIZES[name]
    assert model.event_observations is (name in EVENTS)
    assert model.discount == 1
    assert model.initial_belief.sum() == pytest.approx(1, abs=1e-12)


@pytest.mark.foreign(".pgmx models of MADPToolbox/MADP")
@pytest.mark.parametrize("name", each(["Access_Synch", "DTPGMX", "FFG343", "MAISS_Patrol_Single"]))
def test_agrees_with_madp(corpus, name):
    for sparse in (None, True):
        compare_with_madp(corpus, name, sparse)


def compare_with_madp(corpus, name, sparse):
    oracle = json.loads((corpus / "oracles" / f"{name}.pgmx.json").read_text())
    model = load(corpus / "models" / "madp" / f"{name}.pgmx", sparse=sparse)
    states, actions, observations = model.state_space, model.action_space, model.observation_space
    assert model.num_agents == oracle["nr_agents"]
    assert [list(factor.names) for factor in actions.factors] == oracle["action_names"]
    assert [list(factor.names) for factor in observations.factors] == oracle["observation_names"]
    assert [{"name": f.name, "values": list(f.names)} for f in states.factors] == oracle["state_factors"]
    for space, key in (
        (actions, "first_joint_actions"),
        (observations, "first_joint_observations"),
        (states, "first_state_factor_values"),
    ):
        assert [list(space.unravel(index)) for index in range(len(oracle[key]))] == oracle[key]
    np.testing.assert_allclose(model.initial_belief, oracle["isd"], atol=1e-12)
    transitions = np.stack([dense(model.transition_matrix(a)) for a in range(len(actions))], axis=1)  # s, a, s'
    if "T_full_a_s_s1" in oracle:
        np.testing.assert_allclose(transitions.swapaxes(0, 1), oracle["T_full_a_s_s1"], atol=1e-9)
    if "R_full_s_a" in oracle:
        np.testing.assert_allclose(model.rewards, oracle["R_full_s_a"], atol=1e-9)
    for state, action, following, value in oracle["T_random"] + oracle["T_nonzero"]:
        assert transitions[state, action, following] == pytest.approx(value, abs=1e-9)
    for state, action, value in oracle["R_random"]:
        assert model.rewards[state, action] == pytest.approx(value, abs=1e-9)
    checksum = oracle["T_checksum"]
    assert np.count_nonzero(transitions) == checksum["nonzeros"]
    assert (transitions * weights(*transitions.shape)).sum() == pytest.approx(checksum["weighted"], rel=1e-9)
    checksum = oracle["R_checksum"]
    assert model.rewards.sum() == pytest.approx(checksum["sum"], abs=1e-6)
    assert (model.rewards * weights(*model.rewards.shape)).sum() == pytest.approx(checksum["weighted_s_a_0"], rel=1e-9)
    if model.event_observations:
        check_events(model, transitions, oracle, sparse)
    else:
        check_observations(model, oracle)


def check_observations(model, oracle):
    observations = np.stack([dense(model.observation_matrix(a)) for a in range(len(model.action_space))])
    for action, following, symbol, value in oracle["O_random_a_s1_o"]:
        assert observations[action, following, symbol] == pytest.approx(value, abs=1e-9)
    if "O_full_a_s1_o" in oracle:
        np.testing.assert_allclose(observations, oracle["O_full_a_s1_o"], atol=1e-9)
    weighted = (observations * weights(*observations.shape)).sum()
    assert weighted == pytest.approx(oracle["O_checksum"]["weighted_a_s1_o"], rel=1e-9)


def check_events(model, transitions, oracle, sparse):
    events = np.stack(
        [
            np.stack([dense(model.event_matrix(a, o)) for o in range(len(model.observation_space))], axis=-1)
            for a in range(len(model.action_space))
        ],
        axis=1,
    )  # s, a, s', o
    for state, action, following, symbol, value in oracle["O_event_nonzero_where_T_positive_s_a_s1_o"]:
        assert events[state, action, following, symbol] == pytest.approx(value, abs=1e-9)
    for state, action, following, symbol, value in oracle["O_event_random_s_a_s1_o"]:
        if not sparse or transitions[state, action, following] > 0:
            assert events[state, action, following, symbol] == pytest.approx(value, abs=1e-9)
    if not sparse:  # which holds nothing where T is 0
        checksum = oracle["O_checksum"]
        assert np.count_nonzero(events) == checksum["nonzeros"]
        weighted = (events * weights(*events.shape)).sum()
        assert weighted == pytest.approx(checksum["weighted_s_a_s1_o"], rel=1e-9)


@pytest.mark.foreign("a collection of .pgmx files with one quirk each")
@pytest.mark.parametrize("file", each(sorted(EDGE)))
def test_quirks(corpus, file):
    model = load(corpus / "edge" / file)
    if "same_numbers_as" in EDGE[file]:
        same_numbers(model, load(corpus / "edge" / "pgmx" / EDGE[file]["same_numbers_as"]))
    if "expect" not in EDGE[file]:
        return
    expected = EDGE[file]["expect"]
    actions = model.action_space
    assert [[f.name, list(f.names)] for f in model.state_space.factors] == expected["factors"]
    assert [[f.name, list(f.names)] for f in actions.factors] == expected["decisions"]
    seen = [] if model.kind == "MDP" else [[f.name, list(f.names)] for f in model.observation_space.factors]
    assert seen == expected["observations"]
    assert len(model.state_space) == expected["states"]
    assert len(actions) == expected["joint_actions"]
    assert (model.kind == "POMDP" and model.event_observations) is expected["event_driven"]
    transitions = np.stack([dense(model.transition_matrix(a)) for a in range(len(actions))])
    for action, state, following, value in expected["T_entries"]:
        assert transitions[action, state, following] == pytest.approx(value, abs=1e-9)
    assert np.count_nonzero(transitions) == expected["T_nonzero"]
    np.testing.assert_allclose(model.rewards.T, expected["R_action_state"], atol=1e-9)
    assert sum(model.initial_belief * np.arange(1, len(model.state_space) + 1)) == pytest.approx(
        expected["b0_checksum"]
    )
    for action, following, symbol, value in expected.get("O_entries", []):
        assert dense(model.observation_matrix(action))[following, symbol] == pytest.approx(value, abs=1e-9)


def same_numbers(model, plain):
    assert model.state_space == plain.state_space
    np.testing.assert_array_equal(model.rewards, plain.rewards)
    for action in range(len(plain.action_space)):
        np.testing.assert_array_equal(model.transition_matrix(action), plain.transition_matrix(action))


@pytest.mark.foreign("a collection of broken .pgmx files")
@pytest.mark.parametrize("file", each(sorted(MALFORMED)))
def test_broken_files_are_refused_where_they_break(corpus, file):
    assert_refused_where_it_breaks(corpus / "malformed" / file, MALFORMED[file])


@given(seed=st.integers(0, 2**32 - 1))
def test_mutated_files_make_a_model_or_an_error(seed, tmp_path_factory):
    path = tmp_path_factory.mktemp("mutated") / "m.pgmx"
    path.write_text(mutated(GUARD, random.Random(seed), ["<", "0", "-1", "1e999", "nan", "&x;", "</Branch>", '"']))
    with contextlib.suppress(FormatError):
        load(path)


def test_two_agents_may_be_informed_of_one_observation(tmp_path):
    """Both hear the same: the joint observations in which they differ never occur."""
    text = GUARD.replace(
        '<Variable name="heard" type',
        '<Variable name="camera" type="finiteStates" role="decision" timeSlice="1"><Agent name="camera"/>'
        '<States><State name="left"/><State name="right"/></States></Variable>\n<Variable name="heard" type',
    )
    link = '<Link directed="true"><Variable name="heard" timeSlice="1"/><Variable name="{}" timeSlice="1"/></Link>'
    text = text.replace(link.format("guard"), link.format("guard") + link.format("camera"))
    (tmp_path / "both.pgmx").write_text(text)
    both = load(tmp_path / "both.pgmx")
    (tmp_path / "one.pgmx").write_text(GUARD)
    one = load(tmp_path / "one.pgmx")
    assert both.observation_space.shape == (2, 2)
    for action in range(6):
        for o, p in np.ndindex(2, 2):
            expected = one.joint_matrix(action, o) if o == p else 0
            np.testing.assert_allclose(dense(both.joint_matrix(action, 2 * o + p)), expected)


def test_names_may_have_their_slice_beside_the_attribute(tmp_path):
    text = re.sub(r'name="([^"]*)"([^>]*) timeSlice="([01])"', r'name="\1 [\3]"\2 timeSlice="\3"', GUARD)
    assert text != GUARD
    path = tmp_path / "guard.pgmx"
    path.write_text(text)
    model, other = load(path), load(DATA / "models" / "guard.pgmx")
    assert [factor.name for factor in model.state_space.factors] == [f.name for f in other.state_space.factors]
    assert_same(model, other, within=0)
