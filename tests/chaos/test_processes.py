"""Some robots as real processes that get signals; ``make chaos`` runs many more of them."""

from __future__ import annotations

import pytest
from chaos.processes import FAULTS, PAIRS, judged, mixed, pair


def first(count, all_):
    """Return the seeds from 0 on: so many of them in the default ring."""
    return [pytest.param(seed, marks=() if seed < count else pytest.mark.slow) for seed in range(len(all_))]


@pytest.mark.parametrize("seed", first(1, PAIRS))
def test_two_signals_end_a_robot_in_its_safe_action(seed):
    assert judged(pair(seed)) == []


@pytest.mark.parametrize("seed", first(2, FAULTS))
def test_a_robot_ends_in_its_safe_action_whatever_else_goes_wrong(seed):
    assert judged(mixed(seed)) == []
