"""The choice of a belief filter: by the size and sparsity of the model, and whether numba is installed.

Where the support of a belief may be small or large, one filter holds it by its support and another over all states, in
turn.

How much memory a model and its filter take in a process is known before anything of them is made: the most that is held
at once, while the model is flattened and its filter is built, beside the model as it was given. It is within a factor
of two of what is then allocated.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdm.beliefs.compressed import CompressedFilter, GroupedFilter, held_numbers
from mdm.beliefs.dense import LINE, CompactFilter, FoldedFilter, LikelyFilter
from mdm.beliefs.filter import Filter
from mdm.beliefs.support import CompiledSupportFilter, NetworkFilter, SupportFilter
from mdm.compilation import can_compile, may_compile
from mdm.errors import ConfigError
from mdm.models.dynamics import Dynamics
from mdm.models.matrices import num_entries
from mdm.texts import counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.beliefs.compressed import WideFilter
    from mdm.beliefs.filter import SparseFilter, Support
    from mdm.models.matrices import MatrixSize, Vector
    from mdm.models.mdp import MDP
    from mdm.models.pomdp import POMDP

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
_MEMORY = "/proc/meminfo"
_MEGABYTE = 1e6
_SLOW = 4e9
"""Bytes of a model from which it takes minutes to build."""
_NUMBER = 8
"""Bytes of a number."""
_ENTRY = 12
"""Bytes of an entry of a sparse matrix, with its column."""
_MAKING = 2.5
"""How many times the size of a network's matrices is held while they are made."""


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
        return self._switched(self._present.step(action, observation))

    def step_any(self, action: int, observations: Sequence[int]) -> float:
        """Update by an action and a set of possible observations; return their probability."""
        return self._switched(self._present.step_any(action, observations))

    def predict(self, action: int) -> float:
        """Predict: update by an action without an observation; return 1."""
        return self._switched(self._present.predict(action))

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

    def _switched(self, probability: float) -> float:
        """Change the filter where the support has become too large or small; return the probability of the step."""
        size = self._present.size
        if size > self._most if self._present is self._narrow else size < self._least:
            other = self._wide if self._present is self._narrow else self._narrow
            other.load(self._present.support())
            self._present = other
        return probability


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
    if not model.is_sparing:
        return may_compile()
    size = model.matrix_size
    events = model.network is None and model.event_observations  # whose O is not counted
    return may_compile() and size.transitions + (0 if events else size.observations) > _LEAST_COMPILED


def most_folded(model: POMDP) -> int:
    """Return the largest total size of matrices of an action and an observation each."""
    alike = model.event_observations or model.false_negative is not None  # another filter would take as much
    return FOLDED // _SPARED if model.is_sparing and not alike else FOLDED


def _filled(model: POMDP) -> float:
    """Return the density of T."""
    matrices = [model.transition_matrix(a) for a in range(len(model.action_space))]
    return sum(map(num_entries, matrices)) / (len(matrices) * len(model.state_space) ** 2)


def footprint(model: MDP, *, beliefs: bool, matrices: bool = False) -> int:
    """Return how many bytes a model takes, beside those that it has.

    Args:
        model: The model.
        beliefs: Whether beliefs over it are tracked.
        matrices: Whether its matrices are needed, also where it could stay factored.
    """
    if model.stays_factored and not matrices:
        return 0
    size = model.matrix_size
    used = size.rewards
    if beliefs and model.pomdp is not None:
        used += _filter(model.pomdp, size)
    return used if model.is_flattened else round(max(_MAKING * size.total, size.total + used))


def check_memory(model: MDP, limit: float | None, *, beliefs: bool, matrices: str | None = None) -> None:
    """Refuse a model that would take too much memory.

    Args:
        model: The model.
        limit: The most megabytes; by default what the machine has free.
        beliefs: Whether beliefs over it are tracked.
        matrices: What needs its matrices, also where it could stay factored.

    Raises:
        ConfigError: If it would take more; with its size, and with what would help.
    """
    needed = footprint(model, beliefs=beliefs, matrices=matrices is not None)
    most = free_memory() if limit is None else limit * _MEGABYTE
    if most is None or needed <= most:
        return
    allowed = f"the machine has {_text(most)} free" if limit is None else f"at most {_text(most)} are allowed (memory)"
    raise ConfigError(
        f"{_sizes(model)}. To run it would take {_text(needed)}, and {allowed}; {_help(model, limit, matrices)}",
        key="memory",
    )


def slow_to_build(model: MDP) -> str | None:
    """Return in a sentence how large a model is whose matrices take minutes to build; None for others."""
    needed = footprint(model, beliefs=True, matrices=True)
    return None if needed <= _SLOW else f"{_sizes(model)}: {_text(needed)} are needed to build them, and minutes"


def _sizes(model: MDP) -> str:
    size = model.matrix_size
    counts = [
        counted(len(model.state_space), "state"),
        counted(len(model.action_space), "action"),
    ]
    parts = [f"T {_text(size.transitions)}", f"R {_text(size.rewards)}"]
    if model.observation_space is not None:
        counts.append(counted(len(model.observation_space), "observation"))
        parts.insert(1, f"O {_text(size.observations)}")
    return f"the model has {', '.join(counts)}: as matrices {', '.join(parts)}"


def _help(model: MDP, limit: float | None, matrices: str | None) -> str:
    more = "raise memory" if limit is not None else "use a machine with more"
    if matrices is not None:
        return f"{matrices} needs the matrices: use a policy of alpha vectors or a plan alone, or {more}"
    if model.network is None:
        return f"give it as factors, in a .npz, .pgmx or .pomdpx file, whose matrices nobody makes, or {more}"
    if model.false_negative is not None:
        return f"its false negative needs the matrices: leave it out, or {more}"
    if limit is None:
        return "with the option memory it stays factored, and no matrices are made"
    return f"its events may leave steps without an observation, which needs the matrices: let them sum to 1, or {more}"


def _filter(model: POMDP, size: MatrixSize) -> int:
    """Return the bytes of the form in which a filter holds the matrices; `chosen_filter` chooses it."""
    states, observations = len(model.state_space), len(model.observation_space)
    if states > SMALL and size.entries < DENSE * states**2:
        told = len(model.action_space) if model.event_observations else size.kinds
        if not compiles(model):
            joined = size.kinds * (size.entries + states) * observations
            folds = joined <= FOLDED or model.event_observations
            return size.transitions + size.observations + (_ENTRY * joined if folds else 0)
        starts = 2 * size.kinds * states * _NUMBER
        return starts + size.observations + _ENTRY * (size.kinds * size.entries + told * size.seen)
    pairs = len(model.action_space) * observations
    joined = pairs * states**2
    if pairs <= PAIRS and joined <= most_folded(model) and not compiles(model):
        return joined * _NUMBER
    compact = (pairs + size.kinds * states) * (states + LINE)
    if pairs <= PAIRS and compact <= FOLDED and compiles(model):
        return 2 * compact * _NUMBER
    whole = states * observations * _NUMBER  # a matrix of O; those that are dense are not held twice
    return size.kinds * states**2 * _NUMBER + (0 if size.observations % whole == 0 else size.kinds * whole)


def free_memory() -> float | None:
    """Return how many bytes of memory the machine has free; None where it does not say."""
    try:
        found = dict(line.split(":") for line in Path(_MEMORY).read_text(encoding="ascii").splitlines())
        return float(found["MemAvailable"].split()[0]) * 1024
    except (OSError, ValueError, KeyError):
        return None


def _text(size: float) -> str:
    """Return a number of bytes in words."""
    if size >= 1e9:
        return f"{size / 1e9:.1f} GB"
    return f"{size / _MEGABYTE:.0f} MB" if size >= _MEGABYTE else f"{size / 1e3:.1f} kB"
