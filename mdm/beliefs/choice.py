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
from mdm.models.compilation import can_compile, may_compile
from mdm.models.compressed import is_compressed
from mdm.models.dynamics import Dynamics
from mdm.models.factored.model import FactoredPOMDP
from mdm.models.matrices import held_bytes

if TYPE_CHECKING:
    from mdm.beliefs.filter import Filter
    from mdm.models.pomdp import POMDP

__all__ = ["DENSE", "FOLDED", "PAIRS", "SMALL", "chosen_filter", "compiles", "most_folded"]

FOLDED = 4_000_000
"""The largest total size of dense matrices, one per action and observation."""
PAIRS = 20_000
"""The most pairs of an action and an observation that have something of their own: as objects they take 1 kB each."""
_LEAST_COMPILED = 16_000_000
"""Where memory is short, the bytes of matrices from which what numba takes matters less than its speed."""
_SPARED = 32
"""By how much less is folded where memory is short."""
SMALL = 128
"""The number of states up to which a dense matrix is as fast as any."""
DENSE = 1 / 16
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
        fast = compiles(model) and can_compile()
    most = most_folded(model)
    model = model.flatten()
    all_detected = not model.waits
    actions = range(len(model.action_space))
    pairs = len(actions) * len(model.observation_space)
    by_joints = model.event_observations or not all_detected
    few = pairs <= PAIRS
    fits = few and pairs * size**2 <= most
    filled = size <= SMALL or _filled(model) >= DENSE
    if fast and filled and not by_joints and few and (pairs + len(actions) * size) * (size + LINE) <= FOLDED:
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


def compiles(model: POMDP) -> bool:
    """Whether numba is used for a model, if it can be imported; where memory is short, that takes a large one."""
    return may_compile() and not (model.is_sparing and _held(model) <= _LEAST_COMPILED)


def _held(model: POMDP) -> int:
    """Return the bytes of the matrices of T and O."""
    if isinstance(model, FactoredPOMDP):
        return model.matrix_size.transitions + model.matrix_size.observations
    actions = range(len(model.action_space))
    told = [] if model.event_observations else [model.observation_matrix(action) for action in actions]
    return held_bytes([*map(model.transition_matrix, actions), *told])


def most_folded(model: POMDP) -> int:
    """Return the largest total size of matrices of an action and an observation each."""
    alike = model.event_observations or model.false_negative is not None  # another filter would take as much
    return FOLDED // _SPARED if model.is_sparing and not alike else FOLDED


def _filled(model: POMDP) -> float:
    """Return the density of T."""
    matrices = [model.transition_matrix(a) for a in range(len(model.action_space))]
    entries = sum(matrix.nnz if is_compressed(matrix) else int(np.count_nonzero(matrix)) for matrix in matrices)
    return entries / (len(matrices) * len(model.state_space) ** 2)
