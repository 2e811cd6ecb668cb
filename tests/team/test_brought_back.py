"""Some schedules of real processes; ``python -m team.brought_back 100``, with ``tests`` in ``PYTHONPATH``, runs more.

`test_storage.py` has the same in virtual time, in the default ring.
"""

from __future__ import annotations

import pytest
from team.brought_back import Return
from team.commanded import MODES, violation


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(len(MODES)))
def test_nobody_moves_before_a_start_whatever_is_killed_after_a_stop(seed):
    pytest.importorskip("zenoh", reason="pip install eclipse-zenoh")
    mode, stops, wrong = violation(seed, Return)
    assert (mode, wrong) == (MODES[seed], None)
    assert stops >= 3
