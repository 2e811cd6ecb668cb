"""Messages that agents of a team did not send: nobody ends by them, and the team goes on when they stop."""

from __future__ import annotations

import pytest
from team import forgery

# Each mode without certificates, and one with them, which are there from 9 on; then the others.
SEEDS = [0, 1, 2, 9, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (*range(3, 9), 13, 17))]


@pytest.mark.parametrize("seed", SEEDS)
def test_forged_messages_end_no_agent_and_hold_none_up(seed):
    wrong, dropped = forgery.attacked(forgery.MODES[seed % 3], seed, 120)
    assert wrong == []
    assert 0 < dropped["incredible"] < 200  # of these the envelope was right
    assert dropped["missing"] < 2**24  # a leap in the numbers that a second message confirms counts, up to 2**20
    assert dropped["malformed"] > 0
