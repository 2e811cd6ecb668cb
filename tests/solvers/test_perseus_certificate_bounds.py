"""Upper bounds, of those who see some of the state, too."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from perseus_models import SEEDS, parts, recursion
from random_models import factored_models

from mdm.models import MixedPOMDP
from mdm.solvers import Limits
from mdm.solvers.perseus import perseus


@given(factored_models().filter(lambda model: model.kind == "POMDP" and any(model.network.fully_observed)), SEEDS)
@settings(max_examples=15)
def test_bounds_are_for_who_sees_what_is_observed_from_the_start(model, seed):
    model = model.with_discount(min(model.discount, 0.5)).revealed()
    assert isinstance(model, MixedPOMDP)
    solution = perseus(model, beliefs=20, seed=seed, limits=Limits(iterations=4))
    each = parts(model)
    ends = [float(pick(model.rewards)) / (1 - model.discount) for pick in (np.min, np.max)]
    starts = [np.where(model.seen_in == seen, model.initial_belief, 0.0) for seen in range(max(model.seen_in) + 1)]
    low, high = (sum(recursion(each, model.discount, start, 1, end) for start in starts) for end in ends)
    slack = 1e-9 * (1 + np.abs(ends).max())
    assert solution.lower <= high + slack
    assert solution.upper >= low - slack
    worth = sum(start.sum() * solution.policy.value(start / start.sum()) for start in starts if start.any())
    assert worth == pytest.approx(solution.lower, abs=slack)
