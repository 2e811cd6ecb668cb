"""Kernels in the tests: plain Python, but where a test is marked ``compiled``, to hold the one against the other.

To compile takes many seconds of a processor. What the selected tests need is compiled before the first of them, by the
worker that comes first; the others go on meanwhile, and wait where they come to a test that needs it.
"""

from __future__ import annotations

import os
from contextlib import contextmanager, nullcontext
from fcntl import LOCK_EX, LOCK_NB, flock
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING
from unittest.mock import patch

import pytest

from mdm import compilation

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from contextlib import AbstractContextManager

MARK = "compiled"

_LOCK = Path(__file__).parent / "__pycache__" / "kernels.lock"
_ALLOWED = "MDM_COMPILE"
_before = {_ALLOWED: os.environ[_ALLOWED]} if _ALLOWED in os.environ else {}
_is_loaded = compilation._is_loaded


def _beliefs() -> None:
    import numpy as np
    from belief_steps import corridor, track

    from mdm import problems
    from mdm.models import POMDP

    random = np.random.default_rng(1)
    ways, told = random.dirichlet(np.ones(9), size=(2, 9)), random.dirichlet(np.ones(3), size=(2, 9))
    for model in (problems.tiger(), corridor(20), POMDP(ways, told, np.zeros((9, 2)), discount=0.9, sparse=False)):
        track(model, 1)


def _choices() -> None:
    import numpy as np

    from mdm.policies import AlphaVectors, alpha_vectors

    with patch.object(alpha_vectors, "_LARGE", 0):
        AlphaVectors(np.eye(2), [0, 1]).action(np.full(2, 0.5))


def _sweeps() -> None:
    from mdm import problems
    from mdm.models.dynamics import Dynamics
    from mdm.solvers import Limits, bounds
    from mdm.solvers.mdp.value_iteration import modified_policy_iteration, prioritised_sweeping, value_iteration

    with patch.object(Dynamics, "is_dense", False), patch.object(bounds, "_LARGE", 0):
        for solver in (value_iteration, prioritised_sweeping, modified_policy_iteration):
            solver(problems.forest(), limits=Limits(gap=1e-6, iterations=20))
        bounds.informed_values(Dynamics(problems.tiger()), Limits(iterations=2))


def _search() -> None:
    from mdm.problems import tiger
    from mdm.solvers import TreeSearch

    TreeSearch(tiger(), expansions=20, particles=1).search([0.5, 0.5])


def _sarsop() -> None:
    from mdm.solvers.sarsop import solver

    solver._compiled()


def _verification() -> None:
    import numpy as np

    from mdm.models.matrices import csr
    from mdm.verification import choices, optimum

    size = 500  # too many for a dense elimination
    moves = csr(np.diag(np.full(size - 1, 0.5), 1))
    with patch.object(choices, "LARGE", 0), patch.object(optimum, "LARGE", 0):
        optimum.optimum(moves, np.arange(size), np.ones(size), greatest=True)
        ways = choices.Choices(moves, np.ones(size), np.ones(size), np.arange(size), np.arange(size))
        choices.Graph(ways).impossible()


def _rows() -> None:
    from team.spaces import Space
    from team.sweep import Sweep

    Sweep(Space(2, "continue", False, steps=0)).run()


_KINDS: dict[str, tuple[str, Callable[[], None]]] = {
    "beliefs": ("mdm.beliefs.kernels", _beliefs),
    "choices": ("mdm.policies.alpha_kernels", _choices),
    "sweeps": ("mdm.solvers.mdp.sweeps", _sweeps),
    "search": ("mdm.solvers.online.kernel", _search),
    "sarsop": ("mdm.solvers.sarsop.search", _sarsop),
    "verification": ("mdm.verification.kernels", _verification),
    "rows": ("team.rows", _rows),
}
"""What a test may say that it needs: the module of the kernels, and the work that compiles them."""


def compile_for(items: Iterable[pytest.Item]) -> None:
    """Compile what tests need, unless another process does.

    Args:
        items: The tests of this run.
    """
    kinds = {kind for item in items for mark in item.iter_markers(MARK) for kind in mark.args}
    if not kinds or not compilation.can_compile():
        return
    for kind in kinds:
        import_module(_KINDS[kind][0])
    with _alone(waits=False) as first:
        if first:
            for kind in sorted(kinds):
                _KINDS[kind][1]()


@contextmanager
def _alone(*, waits: bool) -> Iterator[bool]:
    """Keep other processes from compiling; give whether none of them does, if it does not wait for that."""
    _LOCK.parent.mkdir(exist_ok=True)
    with _LOCK.open("w") as lock:
        try:
            flock(lock, LOCK_EX if waits else LOCK_EX | LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True


@contextmanager
def as_plain_python() -> Iterator[None]:
    """Run kernels as plain Python within, in this process and those that it starts."""
    compilation.may_compile()  # the answer is kept: nobody is told that there is no compiler
    with patch.object(compilation, "_is_loaded", lambda: False), patch.dict(os.environ, {_ALLOWED: "0"}):
        yield


def needed_by(item: pytest.Item) -> AbstractContextManager[None]:
    """Give a test the kernels that it is marked for."""
    mark = item.get_closest_marker(MARK)
    return nullcontext() if mark is None else _as_compiled(**mark.kwargs)


@contextmanager
def _as_compiled(*, where_possible: bool = False) -> Iterator[None]:
    """Run compiled kernels within, when they have been compiled; skip a test where none can be, unless it may go on."""
    with patch.object(compilation, "_is_loaded", _is_loaded), patch.dict(os.environ):
        os.environ.pop(_ALLOWED)
        os.environ.update(_before)
        if not where_possible and not compilation.can_compile():
            pytest.skip("numba is not there, or MDM_COMPILE is 0")
        with _alone(waits=True):
            pass
        yield
        compilation.may_compile()  # the answer is kept, see above
