"""Which belief filter suits a model: by its size, how many of its probabilities are 0, and whether there is numba."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.beliefs.adaptive import AdaptiveFilter
from mdm.beliefs.compressed import CompressedFilter, GroupedFilter, held_numbers
from mdm.beliefs.dense import CompiledFoldedFilter, FoldedFilter, LikelyFilter
from mdm.beliefs.network import NetworkFilter
from mdm.beliefs.support import CompiledSupportFilter, SupportFilter
from mdm.models.compilation import can_compile
from mdm.models.compressed import is_compressed
from mdm.models.dynamics import Dynamics
from mdm.models.factored.model import FactoredPOMDP

if TYPE_CHECKING:
    from mdm.beliefs.filter import Filter
    from mdm.models.pomdp import POMDP

__all__ = ["chosen_filter", "is_vast"]

_ROWS = 10_000_000
"""A factored model with more rows of T than these is asked for rows one by one."""
_FOLDED = 4_000_000
"""So many numbers may be held as a dense matrix for each action and observation."""
_SMALL = 128
"""Up to so many states a dense matrix is as fast as any."""
_DENSE = 1 / 16
"""From this part of non-zeros on a dense matrix is as fast as a compressed one."""
_ARRANGED = 200_000_000
"""So many numbers of CSR matrices may be held a second time, arranged for beliefs over all states."""
_NARROW = 8
"""A belief is held by its support while that is a smaller part of the states than one in so many."""
_GATHERED = 5_000, 64
"""By numpy alone: only for more states than the first, and one in so many as the second; it costs 40 µs at least."""


def chosen_filter(model: POMDP, *, fast: bool | None = None) -> Filter:
    """Return the filter that suits a model best.

    Args:
        model: The POMDP.
        fast: Whether to use numba; by default where it is there.
    """
    fast = can_compile() if fast is None else fast
    all_detected = model.false_negative is None
    if isinstance(model, FactoredPOMDP) and all_detected and is_vast(model):
        return NetworkFilter(model.network)
    model = model.flatten()
    actions, size = range(len(model.action_space)), len(model.state_space)
    fits = len(actions) * len(model.observation_space) * size**2 <= _FOLDED
    filled = size <= _SMALL or _filled(model) >= _DENSE
    if fits and (filled or not all_detected):
        return (CompiledFoldedFilter if fast else FoldedFilter)(model)
    if filled and all_detected and not model.event_observations:
        return LikelyFilter(model, fast=fast)
    dynamics = Dynamics(model)
    wide = GroupedFilter if fast else CompressedFilter
    if not all_detected or (not fast and size <= _GATHERED[0]):  # false negatives lead everywhere
        return wide(dynamics)
    narrow = CompiledSupportFilter(dynamics) if fast else SupportFilter(dynamics)
    if held_numbers(dynamics) > _ARRANGED:
        return narrow
    most = size // (_NARROW if fast else _GATHERED[1])
    return AdaptiveFilter(narrow, wide(dynamics), most, most // 2)


def is_vast(model: POMDP) -> bool:
    """Whether a factored model has too many rows of T to make matrices for belief updates alone."""
    return isinstance(model, FactoredPOMDP) and len(model.state_space) * len(model.action_space) > _ROWS


def _filled(model: POMDP) -> float:
    """Return which part of T is not zero."""
    matrices = [model.transition_matrix(a) for a in range(len(model.action_space))]
    entries = sum(matrix.nnz if is_compressed(matrix) else int(np.count_nonzero(matrix)) for matrix in matrices)
    return entries / (len(matrices) * len(model.state_space) ** 2)
