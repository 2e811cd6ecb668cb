"""Some random schedules; ``python -m team.schedules 100000``, with ``tests`` in ``PYTHONPATH``, runs many more."""

from __future__ import annotations

import pytest
from team.schedules import violation

SEEDS = 100
PARTS = [*range(4), *(pytest.param(part, marks=pytest.mark.slow) for part in range(4, 20))]


@pytest.mark.parametrize("part", PARTS)
def test_no_schedule_violates_what_is_promised(part):
    found = [wrong for seed in range(part * SEEDS, (part + 1) * SEEDS) if (wrong := violation(seed))[1] is not None]
    assert found == []
