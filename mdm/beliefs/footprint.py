"""How much memory a model takes in a process that tracks beliefs over it, known before anything of it is made.

What is told is the most that is held at once, while a model is flattened and its filter is built, beside the model as
it was given. It is within a factor of two of what is then allocated.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mdm.beliefs.choice import DENSE, FOLDED, PAIRS, SMALL, compiles, most_folded
from mdm.beliefs.compact import LINE
from mdm.errors import ConfigError

if TYPE_CHECKING:
    from mdm.models.matrices import MatrixSize
    from mdm.models.mdp import MDP
    from mdm.models.pomdp import POMDP

__all__ = ["check_memory", "footprint"]

_MEMORY = "/proc/meminfo"
_MEGABYTE = 1e6
_NUMBER = 8
"""Bytes of a number."""
_ENTRY = 12
"""Bytes of an entry of a sparse matrix, with its column."""
_MAKING = 2.5
"""How many times the size of a network's matrices is held while they are made."""


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
    if limit is not None and not (isinstance(limit, int | float) and not isinstance(limit, bool) and limit > 0):
        raise ConfigError(f"memory is a number of megabytes, more than 0, not {limit!r}", key="memory")
    needed = footprint(model, beliefs=beliefs, matrices=matrices is not None)
    most = _free() if limit is None else limit * _MEGABYTE
    if most is None or needed <= most:
        return
    size = model.matrix_size
    counts = [f"{len(model.state_space)} states", f"{len(model.action_space)} actions"]
    parts = [f"T {_text(size.transitions)}", f"R {_text(size.rewards)}"]
    if model.observation_space is not None:
        counts.append(f"{len(model.observation_space)} observations")
        parts.insert(1, f"O {_text(size.observations)}")
    allowed = f"the machine has {_text(most)} free" if limit is None else f"at most {_text(most)} are allowed (memory)"
    raise ConfigError(
        f"the model has {', '.join(counts)}: as matrices {', '.join(parts)}. To run it would take {_text(needed)}, and "
        f"{allowed}; {_help(model, limit, matrices)}",
        key="memory",
    )


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


def _free() -> float | None:
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
