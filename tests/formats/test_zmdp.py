"""ZMDP's planes: over some states, over all, and of an observed state."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from places import POLICIES
from policy_files import assert_refused, model_of, pairs
from random_policies import alpha, assert_same
from sentences import refused

from mdm import FormatError
from mdm.formats import files as policies, zmdp
from mdm.policies import AlphaVectors, MaskedAlphaVectors, MixedAlphaVectors


def test_planes():
    policy = policies.load_policy(POLICIES / "masked.policy")
    assert isinstance(policy, MaskedAlphaVectors)
    assert policy.vectors == ({0: 5, 1: 4.5}, {0: 1, 1: 1.5, 2: -0.2})
    assert policy.actions == [0, 1]
    assert policies.load_policy(POLICIES / "masked.policy", model_of(4)).num_states == 4


def test_planes_over_all_states_are_plain_vectors(tmp_path):
    text = '{\npolicyType => "MaxPlanesLowerBound",\naction => 1,\nentries => [\n1, 3\n0, 2\n]\n'
    (tmp_path / "x").write_text(text)
    policy = policies.load_policy(tmp_path / "x")
    assert isinstance(policy, AlphaVectors)
    assert pairs(policy) == [(1, [2, 3])]


def test_planes_of_an_observed_state():
    policy = policies.load_policy(POLICIES / "observed.policy")
    assert isinstance(policy, MixedAlphaVectors)
    assert [pairs(vectors) for vectors in policy.sets] == [[(0, [24.5, 3])], [(1, [-81.5, 28.5])]]
    assert policies.load_policy(POLICIES / "observed.policy", model_of(6)).states.shape == (3, 2)
    with refused(FormatError):
        policies.load_policy(POLICIES / "observed.policy", model_of())


HEAD = 'policyType => "MaxPlanesLowerBound"\n'


OBSERVED = 'policyType => "MaxPlanesLowerBoundWithObservedState"\n'


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        (HEAD, None, "no planes"),
        ('policyType => "Sawtooth"\naction => 0\n0, 1\n', 1, "is not a known policy type"),
        (HEAD + "action => 3\n0, 1\n", 2, "from 0 to 2"),
        (HEAD + "action => -1\n0, 1\n", 2, "'-1'"),
        (HEAD + "action => 0\n0, 1\n0, 2\n", 4, "two entries for state 0"),
        (HEAD + "action => 0\n0, x\n", 3, "'x' is not a finite number"),
        (HEAD + "action => 0\n0, inf\n", 3, "not a finite number"),
        (HEAD + "action => 0\n0; 1\n", 3, "a state, a comma and a value"),
        (HEAD + "0, 1\n", 2, "precedes the first plane's action"),
        (HEAD + "action => 0\nnumEntries => 2\n0, 1\n", 2, "numEntries is 2, but 1"),
        (HEAD + "action => 0\n", 2, "0 are given"),
        (HEAD + "numPlanes => 2\naction => 0\n0, 1\n", None, "numPlanes is 2, but 1"),
        (HEAD + "action => 0\nbackups => 3\n0, 1\n", 3, "the key 'backups' is unknown"),
        (HEAD + "action => 0\n2, 1\n", None, "state 2, but the model has states 0 to 1"),
        (OBSERVED + "action => 0\n0, 1\n", 2, "no observed state val"),
        (OBSERVED + "action => 0\nobserved state val => 0\n1, 1\n", 2, "each of 2 hidden states"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path, text, line, words):
    assert_refused(tmp_path / "z", text, line, words)


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_vectors_over_all_states_come_back(tmp_path_factory, seed, count):
    vectors = alpha(np.random.default_rng(seed), count)
    path = tmp_path_factory.mktemp("round") / "z"
    zmdp.write(vectors, path)
    assert_same(policies.load_policy(path), vectors)
