"""A few random systems, recorded in wall time; `make chaos` records a thousand while other processes keep it busy."""

from __future__ import annotations

import pytest
from replay.runs import violations

FEW = (*range(7), 9, 17, 19, 21)
"""The last three go on for ever where the end of a record ends actions as successes."""

pytestmark = pytest.mark.usefixtures("recorded_here")


@pytest.mark.filterwarnings("ignore")  # asyncio logs errors that nobody awaits, as is meant here
@pytest.mark.parametrize(
    "seed", [*FEW, *(pytest.param(each, marks=pytest.mark.slow) for each in range(60) if each not in FEW)]
)
def test_a_random_system_is_repeated_as_it_was_recorded(tmp_path, seed):
    decisions, wrong = violations(seed, tmp_path / "run.mcap", 0.3)
    assert wrong == []
    assert decisions
