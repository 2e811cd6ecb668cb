"""Some random schedules; ``python -m team.schedules 100000``, with ``tests`` in ``PYTHONPATH``, runs many more."""

from __future__ import annotations

import pytest
from team.schedules import violation

PARTS, SEEDS = 10, 200


@pytest.mark.parametrize("part", range(PARTS))
def test_no_schedule_violates_what_is_promised(part):
    found = [wrong for seed in range(part * SEEDS, (part + 1) * SEEDS) if (wrong := violation(seed))[1] is not None]
    assert found == []
