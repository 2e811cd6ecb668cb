"""The choice of a belief filter: by the size and sparsity of the model, and whether numba is installed.

Where the support of a belief may be small or large, one filter holds it by its support and another over all states, in
turn.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.beliefs.compact import LINE, CompactFilter
from mdm.beliefs.compressed import CompressedFilter, GroupedFilter, held_numbers
from mdm.beliefs.dense import FoldedFilter, LikelyFilter
from mdm.beliefs.filter import Filter
from mdm.beliefs.network import NetworkFilter
from mdm.beliefs.support import CompiledSupportFilter, SupportFilter
from mdm.models.compilation import can_compile, may_compile
from mdm.models.dynamics import Dynamics
from mdm.models.matrices import num_entries

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.beliefs.compressed import WideFilter
    from mdm.beliefs.filter import SparseFilter, Support
    from mdm.models.matrices import Vector
    from mdm.models.pomdp import POMDP

__all__ = ["DENSE", "FOLDED", "PAIRS", "SMALL", "AdaptiveFilter", "chosen_filter", "compiles", "most_folded"]

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


class AdaptiveFilter(Filter):
    """Holds a belief by its support while that is small, else over all states.

    Args:
        narrow: The filter by support.
        wide: The filter over all states.
        most: A larger support switches to the wide filter.
        least: A smaller support switches back.
    """

    def __init__(self, narrow: SparseFilter, wide: WideFilter, most: int, least: int) -> None:
        self._narrow = narrow
        self._wide = wide
        self._most = most
        self._least = least
        self._present: SparseFilter | WideFilter = narrow

    @property
    def is_sparse(self) -> bool:
        """Whether the belief is held by its support."""
        return self._present is self._narrow

    def load(self, belief: Support) -> None:
        """Load a belief."""
        self._present = self._narrow if len(belief.states) <= self._most else self._wide
        self._present.load(belief)

    def step(self, action: int, observation: int) -> float:
        """Update by an action and an observation; return P(observation | belief, action)."""
        probability = self._present.step(action, observation)
        self._switch()
        return probability

    def step_any(self, action: int, observations: Sequence[int]) -> float:
        """Update by an action and a set of possible observations; return their probability."""
        probability = self._present.step_any(action, observations)
        self._switch()
        return probability

    def predict(self, action: int) -> float:
        """Predict: update by an action without an observation; return 1."""
        probability = self._present.predict(action)
        self._switch()
        return probability

    def dense(self) -> Vector:
        """Return the belief as a new array of S numbers, read-only."""
        return self._present.dense()

    def support(self) -> Support:
        """Return the support of the belief, as new arrays."""
        return self._present.support()

    def snapshot(self) -> Any:
        """Return which filter holds the belief, and its snapshot."""
        return [self.is_sparse, self._present.snapshot()]

    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot."""
        is_sparse, held = snapshot
        self._present = self._narrow if is_sparse else self._wide
        self._present.restore(held)

    def _switch(self) -> None:
        size = self._present.size
        if self._present is self._narrow:
            if size <= self._most:
                return
            other: SparseFilter | WideFilter = self._wide
        elif size >= self._least:
            return
        else:
            other = self._narrow
        other.load(self._present.support())
        self._present = other


def chosen_filter(model: POMDP, *, fast: bool | None = None) -> Filter:
    """Return the best filter for a model.

    Args:
        model: The POMDP.
        fast: Whether to use numba; by default if it is installed.
    """
    if model.network is not None and model.stays_factored:
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
    """Return the bytes of T and O; the events of a flat model are not counted."""
    size = model.matrix_size
    events = model.network is None and model.event_observations
    return size.transitions + (0 if events else size.observations)


def most_folded(model: POMDP) -> int:
    """Return the largest total size of matrices of an action and an observation each."""
    alike = model.event_observations or model.false_negative is not None  # another filter would take as much
    return FOLDED // _SPARED if model.is_sparing and not alike else FOLDED


def _filled(model: POMDP) -> float:
    """Return the density of T."""
    matrices = [model.transition_matrix(a) for a in range(len(model.action_space))]
    return sum(map(num_entries, matrices)) / (len(matrices) * len(model.state_space) ** 2)
