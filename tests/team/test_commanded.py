"""Some schedules of real processes; ``python -m team.commanded 100``, with ``tests`` in ``PYTHONPATH``, runs more."""

from __future__ import annotations

import pytest
from team.commanded import MODES, violation


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(len(MODES)))
def test_no_robot_moves_after_a_stop_that_it_confirmed(seed):
    pytest.importorskip("zenoh", reason="pip install eclipse-zenoh")
    mode, stops, wrong = violation(seed)
    assert (mode, wrong) == (MODES[seed], None)
    assert stops >= 3
