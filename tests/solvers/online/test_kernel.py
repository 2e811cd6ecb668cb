"""The tree's functions, compiled."""

from __future__ import annotations

import pytest

from mdm.models.compilation import can_compile
from mdm.problems import tiger
from mdm.solvers import TreeSearch
from mdm.solvers.online import kernel


@pytest.mark.skipif(not can_compile(), reason="numba is not there, or MDM_COMPILE is 0")
def test_each_function_is_compiled_once():
    """A second type of an argument would double what its first user waits for."""
    TreeSearch(tiger(), expansions=50, particles=1).search([0.5, 0.5])
    functions = {name: each.signatures for name, each in vars(kernel).items() if hasattr(each, "signatures")}
    # What was found on disk has compiled no other: this shows where kernels are compiled anew.
    assert {name: len(found) for name, found in functions.items() if len(found) > 1} == {}
    assert len(functions["grow"]) == 1
