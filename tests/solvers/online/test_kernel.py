"""The tree's functions, compiled."""

from __future__ import annotations

import ast
import subprocess
import sys

import pytest


@pytest.mark.compiled("search")
def test_each_function_is_compiled_once():
    """A second type of an argument would double what its first user waits for."""
    # In a process of its own: other tests may have handed in other types.
    program = (
        "from mdm.problems import tiger; from mdm.solvers import TreeSearch; from mdm.solvers.online import kernel\n"
        "TreeSearch(tiger(), expansions=50, particles=1).search([0.5, 0.5])\n"
        "print({name: len(each.signatures) for name, each in vars(kernel).items() if hasattr(each, 'signatures')})"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=200, check=True)
    functions = ast.literal_eval(done.stdout)
    # What was found on disk has compiled no other: this shows where kernels are compiled anew.
    assert {name: count for name, count in functions.items() if count > 1} == {}
    assert functions["grow"] == 1
