"""The choice of a belief filter: by the size and sparsity of the model, and whether numba is installed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.beliefs.adaptive import AdaptiveFilter
from mdm.beliefs.compact import LINE, CompactFilter
from mdm.beliefs.compressed import CompressedFilter, GroupedFilter, held_numbers
from mdm.beliefs.dense import FoldedFilter, LikelyFilter
from mdm.beliefs.network import NetworkFilter
from mdm.beliefs.support import CompiledSupportFilter, SupportFilter
from mdm.models.compilation import can_compile
from mdm.models.compressed import is_compressed
from mdm.models.dynamics import Dynamics
from mdm.models.factored.model import FactoredPOMDP

if TYPE_CHECKING:
    from mdm.beliefs.filter import Filter
    from mdm.models.pomdp import POMDP

__all__ = ["chosen_filter"]

_FOLDED = 4_000_000
"""The largest total size of dense matrices, one per action and observation."""
_PAIRS = 20_000
"""The most pairs of an action and an observation that have something of their own: as objects they take 1 kB each."""
_SMALL = 128
"""The number of states up to which a dense matrix is as fast as any."""
_DENSE = 1 / 16
"""The density of T from which a dense matrix is as fast as a CSR one."""
_ARRANGED = 200_000_000
"""The largest number of CSR entries that are copied for beliefs over all states."""
_NARROW = 8
"""The support is used while it is smaller than S divided by this."""
_GATHERED = 5_000, 64
"""Without numba, the least S for the support, and the divisor of S: a step costs at least 40 µs."""


def chosen_filter(model: POMDP, *, fast: bool | None = None) -> Filter:
    """Return the best filter for a model.

    Args:
        model: The POMDP.
        fast: Whether to use numba; by default if it is installed.
    """
    if isinstance(model, FactoredPOMDP) and model.stays_factored:
        return NetworkFilter(model.network)
    size = len(model.state_space)
    if fast is None:
        fast = not (model.is_sparing and size <= _SMALL) and can_compile()
    model = model.flatten()
    all_detected = not model.waits
    actions = range(len(model.action_space))
    pairs = len(actions) * len(model.observation_space)
    by_joints = model.event_observations or not all_detected
    few = pairs <= _PAIRS
    fits = few and pairs * size**2 <= _FOLDED
    filled = size <= _SMALL or _filled(model) >= _DENSE
    if (
        fast
        and filled
        and not by_joints
        and pairs <= _PAIRS
        and (pairs + len(actions) * size) * (size + LINE) <= _FOLDED
    ):
        return CompactFilter(model)
    if fits and (filled or not all_detected):
        return (CompactFilter if fast else FoldedFilter)(model)
    if filled and not by_joints:
        return LikelyFilter(model, fast=fast)
    dynamics = Dynamics(model)
    wide = GroupedFilter if fast else CompressedFilter
    if not all_detected or (not fast and size <= _GATHERED[0]):  # steps without a detection spread over all states
        return wide(dynamics)
    narrow = CompiledSupportFilter(dynamics) if fast else SupportFilter(dynamics)
    if held_numbers(dynamics) > _ARRANGED:
        return narrow
    most = size // (_NARROW if fast else _GATHERED[1])
    return AdaptiveFilter(narrow, wide(dynamics), most, most // 2)


def _filled(model: POMDP) -> float:
    """Return the density of T."""
    matrices = [model.transition_matrix(a) for a in range(len(model.action_space))]
    entries = sum(matrix.nnz if is_compressed(matrix) else int(np.count_nonzero(matrix)) for matrix in matrices)
    return entries / (len(matrices) * len(model.state_space) ** 2)
