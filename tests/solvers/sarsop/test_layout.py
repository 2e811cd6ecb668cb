"""The layout of states by what is seen of them."""

from __future__ import annotations

import pytest
from hypothesis import given, settings, strategies as st
from sarsop_models import mixed

from mdm.models import POMDP
from mdm.policies import MixedAlphaVectors
from mdm.problems import tag
from mdm.solvers import Limits
from mdm.solvers.sarsop import sarsop


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_mixed_observability_changes_the_layout_and_no_value(seed):
    model = mixed(seed)
    plain = POMDP(
        [model.transition_matrix(a) for a in range(2)],
        [model.observation_matrix(a).toarray() for a in range(2)],
        model.rewards,
        discount=model.discount,
        initial_belief=model.initial_belief,
        sparse=False,
    )
    ours = sarsop(model, limits=Limits(gap=1e-4, time=5))
    theirs = sarsop(plain, limits=Limits(gap=1e-4, time=5))
    assert isinstance(ours.policy, MixedAlphaVectors)
    assert ours.lower <= theirs.upper + 1e-9
    assert theirs.lower <= ours.upper + 1e-9
    assert ours.policy.value(model.initial_belief) == pytest.approx(ours.lower, abs=1e-9)


def test_factors_that_are_seen_make_tag_easier():
    """The bounds of C++ SARSOP after 10 s: -5.959 and -2.30; of the flat model after 60 s -6.20 and -1.95."""
    found = sarsop(tag(), limits=Limits(iterations=3000))
    assert isinstance(found.policy, MixedAlphaVectors)
    assert -10 < found.lower < -5.5 < found.upper < 0
