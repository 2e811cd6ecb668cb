"""Whether kernels are compiled: by numba where it is there, and never with MDM_COMPILE=0."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from mdm import ModelWarning, compilation
from mdm.compilation import COMPILE_TIME

pytestmark = pytest.mark.compiled(where_possible=True)


@pytest.fixture(autouse=True)
def forgotten():
    """Ask anew in each test: the answer is kept for a process."""
    for known in (compilation._is_loaded, compilation.may_compile):
        known.cache_clear()
    yield
    for known in (compilation._is_loaded, compilation.may_compile):
        known.cache_clear()


def twice(number):
    return 2 * number


@pytest.mark.skipif(find_spec("numba") is None, reason="numba is not installed")
@pytest.mark.parametrize(("said", "expected"), [(None, True), ("1", True), ("0", False)])
def test_the_environment_can_forbid_it(monkeypatch, said, expected):
    monkeypatch.delenv("MDM_COMPILE", raising=False)
    if said is not None:
        monkeypatch.setenv("MDM_COMPILE", said)
    assert compilation.can_compile() is expected
    function = compilation.compiled(twice)
    assert (function is twice) is not expected
    assert hasattr(function, "py_func") is expected


def test_without_numba_a_function_stays_as_it_is(monkeypatch):
    monkeypatch.delenv("MDM_COMPILE", raising=False)
    monkeypatch.setattr(compilation, "find_spec", lambda name: None)
    monkeypatch.setitem(sys.modules, "numba", None)  # importing it would fail
    assert not compilation.can_compile()
    assert compilation.compiled(twice) is twice


def test_a_numba_that_cannot_be_imported_is_told_once_and_done_without(monkeypatch):
    monkeypatch.delenv("MDM_COMPILE", raising=False)
    monkeypatch.setattr(compilation, "find_spec", lambda name: object())
    monkeypatch.setitem(sys.modules, "numba", None)  # as where it, or what it needs, is broken
    with pytest.warns(ModelWarning, match=r"numba is installed, but cannot be imported .* reinstall it"):
        assert not compilation.can_compile()
    assert not compilation.can_compile()
    assert compilation.compiled(twice) is twice


@pytest.mark.skipif(find_spec("numba") is None, reason="numba is not installed")
def test_what_is_compiled_is_measured(monkeypatch):
    monkeypatch.delenv("MDM_COMPILE", raising=False)
    assert compilation.can_compile()
    import numba

    function = numba.njit(twice)  # not kept on disk
    before = COMPILE_TIME.seconds
    assert function(2) == 4
    after = COMPILE_TIME.seconds
    assert after > before
    assert function(3) == 6
    assert COMPILE_TIME.seconds == after


def test_a_module_of_kernels_can_be_had_as_plain_python():
    module = compilation.plain("mdm.solvers.sarsop.search")
    assert not hasattr(module.explore, "py_func")
    assert not hasattr(module.refresh, "py_func")
    assert compilation.plain("mdm.solvers.sarsop.search") is module


def bounds_checked(*arguments):
    """Run all kernels in a process in which each index is checked; return the names of those that were called.

    There they are plain Python on arrays of numpy, which refuse the indices that numba would refuse if it checked them.
    To have numba check them takes a minute of compilation.
    """
    tests = Path(__file__).parent
    run = subprocess.run(
        [sys.executable, str(tests / "kernels_program.py"), *map(str, arguments)],
        capture_output=True,
        text=True,
        env={
            **os.environ,
            "MDM_COMPILE": "1",
            "PYTHONPATH": os.pathsep.join((str(tests.parent), str(tests))),
        },
    )
    assert run.returncode == 0, run.stderr
    return {tuple(line.split()[:2]) for line in run.stdout.splitlines()}


@pytest.mark.skipif(find_spec("numba") is None, reason="numba is not installed")
@pytest.mark.parametrize("random", [0, pytest.param(6, marks=pytest.mark.slow)])
def test_no_kernel_leaves_its_arrays(random):
    assert bounds_checked(random) >= {
        ("solvers.online.kernel", "grow"),
        ("solvers.sarsop.search", "explore"),
        ("solvers.mdp.sweeps", "informed_sweep"),
        ("solvers.mdp.sweeps", "sweep"),
        ("solvers.mdp.sweeps", "prioritised_sweeps"),
        ("policies.alpha_kernels", "at_belief"),
        ("policies.alpha_kernels", "at_support"),
        ("beliefs.kernels", "move_dense"),
        ("beliefs.kernels", "move_sparse"),
        ("beliefs.kernels", "move_likely"),
        ("beliefs.kernels", "pull"),
        ("beliefs.kernels", "push"),
    }


@pytest.mark.slow
@pytest.mark.foreign("models of cassandra/pomdp-solve, AdaCompNUS/sarsop and MADPToolbox/MADP")
@pytest.mark.skipif(find_spec("numba") is None, reason="numba is not installed")
def test_no_kernel_leaves_its_arrays_on_models_of_others(corpus):
    files = [f"pomdp-solve/{name}" for name in ("1d.POMDP", "4x3.95.POMDP", "cheese.95.POMDP", "shuttle.95.POMDP")]
    files += ["madp/dectiger.dpomdp", "madp/MAISS_Patrol_Single.pgmx"]  # plain Python is slow on larger ones
    assert ("solvers.sarsop.search", "explore") in bounds_checked(0, *(corpus / "models" / file for file in files))


@pytest.mark.compiled("beliefs")
def test_a_direct_call_is_the_same_call():
    from mdm.beliefs.kernels import move

    arrays = np.eye(2), np.array([0.25, 0.5]), np.empty(2)
    assert compilation.direct(move, *arrays)(*arrays) == 0.75
    assert arrays[2].tolist() == [0.25, 0.5]


def test_a_direct_call_of_what_is_not_compiled_is_the_function():
    assert compilation.direct(max, 1, 2) is max


def test_sparing_holds_within_a_block_and_only_where_it_is_wanted():
    assert not compilation.is_sparing()
    with compilation.sparing():
        assert compilation.is_sparing()
        with compilation.sparing(wanted=False):
            assert not compilation.is_sparing()
        assert compilation.is_sparing()
    assert not compilation.is_sparing()
