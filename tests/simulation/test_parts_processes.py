"""Processes of this machine as workers."""

from __future__ import annotations

import os

import pytest
from sentences import refused

from mdm import ConfigError
from mdm.simulation import Processes


@pytest.mark.slow
def test_a_process_that_is_killed_is_replaced():
    with Processes(1) as executor:
        first = executor.submit(os.getpid).result()
        executor.renew()
        assert executor.submit(os.getpid).result() not in {first, os.getpid()}


@pytest.mark.parametrize("wait", [True, False])
def test_none_starts_after_the_end(wait):
    executor = Processes(1)
    executor.shutdown(wait=wait)
    with pytest.raises(RuntimeError, match="after shutdown"):
        executor.submit(os.getpid)


def test_their_number():
    assert Processes(3).workers == 3
    assert Processes().workers >= 1
    for wrong in (0, 1.5, "two"):
        with refused(ConfigError):
            Processes(wrong)
