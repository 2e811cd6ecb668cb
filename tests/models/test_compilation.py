"""Whether kernels are compiled: by numba where it is there, and never with MDM_COMPILE=0."""

from __future__ import annotations

import sys
from importlib.util import find_spec

import pytest

from mdm.models import compilation


@pytest.fixture(autouse=True)
def forgotten():
    """Ask anew in each test: the answer is kept for a process."""
    compilation.can_compile.cache_clear()
    yield
    compilation.can_compile.cache_clear()


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
