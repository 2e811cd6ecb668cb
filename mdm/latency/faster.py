"""Advice on making decisions faster on this machine, in sentences."""

from __future__ import annotations

import importlib
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from mdm.compilation import may_compile
from mdm.models.matrices import is_compressed, is_large_and_sparse, num_entries

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mdm.actors import Ensemble


def faster(ensembles: Iterable[Ensemble]) -> Iterator[str]:
    """Yield advice on making the decisions of these ensembles faster, a sentence each.

    Each is about this machine as it is now: packages that are absent, threads of linear algebra, matrices of a model.
    """
    ensembles = list(ensembles)
    believing = [each.name for each in ensembles if each.controller.takes != "state" and each.controller.model]
    if believing and not may_compile():
        way_out = "unset MDM_COMPILE" if find_spec("numba") else "pip install numba"
        yield f"the beliefs of {', '.join(believing)} are computed by numpy: {way_out}"
    threads = blas_threads()
    if believing and threads > 1:
        yield f"linear algebra uses {threads} threads, which wait for each other: set OMP_NUM_THREADS=1"
    install = "" if find_spec("uvloop") else "pip install uvloop, and "
    yield (
        "input from threads and other processes waits until asyncio's own event loop wakes up, and uvloop wakes up "
        f"sooner: {install}mdm.run(…, uvloop=True)"
    )
    for ensemble in ensembles:
        yield from _of_model(ensemble.name, ensemble.controller.model)


def _of_model(name: str, model: Any) -> Iterator[str]:
    if model is None or model.network is not None or is_compressed(model.transition_matrix(0)):
        return
    entries = sum(num_entries(model.transition_matrix(action)) for action in range(len(model.action_space)))
    if is_large_and_sparse(len(model.action_space), len(model.state_space), len(model.state_space), entries):
        yield f"the matrices of {name} are dense, and nearly all zeros: make its model with sparse=True"


def blas_threads() -> int:
    """Return how many threads numpy's linear algebra uses; 0 where nothing tells it."""
    try:
        library = importlib.import_module("threadpoolctl")
    except ImportError:
        return 0
    found = [int(each["num_threads"]) for each in library.threadpool_info() if each.get("user_api") == "blas"]
    return max(found, default=0)
