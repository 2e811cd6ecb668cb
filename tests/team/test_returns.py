"""A few schedules of `team.returns`; `make chaos` runs many more of them."""

from __future__ import annotations

import tempfile

import pytest
from team.returns import Schedule

from mdm.testing import run_virtual

SEEDS = [*range(3), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3, 100))]


@pytest.mark.parametrize("seed", SEEDS)
def test_nobody_moves_before_a_start_whatever_ends_when(seed):
    async def main(runtime):
        with tempfile.TemporaryDirectory() as folder:
            squad = await Schedule(runtime, seed, folder).begin()
            await squad.befall(await squad.asker())

    run_virtual(main)
