"""Differences between a recorded run and its replay."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np

from mdm.messages import Decision
from mdm.stimuli import Stimulus

__all__ = ["Difference", "unlike"]


class Difference(msgspec.Struct, frozen=True):
    """A decision that was not repeated as it was recorded.

    Attributes:
        number: The number of the recorded decision, from 0; of one that only the replay made, of the next.
        recorded: The decision of the record; None where the replay alone has made one.
        replayed: That of the replay; None where it made none.
        fields: The names of the fields that differ.
        since: The stimuli before it, the last one last.
    """

    number: int
    recorded: Decision | None
    replayed: Decision | None
    fields: tuple[str, ...]
    since: tuple[Stimulus, ...]

    def describe(self, epoch: int = 0) -> str:
        """Return the difference in words, over several lines; times in seconds since an epoch in nanoseconds."""
        recorded, replayed = self.recorded, self.replayed
        known = recorded if recorded is not None else replayed
        assert known is not None
        at = (known.time - epoch) / 1e9
        if replayed is None:
            text = (
                f"decision {self.number}: {known.ensemble!r} decided {known.action_name!r} at {at:.6f} s, and not now"
            )
        elif recorded is None:
            text = (
                f"decision {self.number}: {known.ensemble!r} decides {known.action_name!r} at {at:.6f} s, and did not"
            )
        else:
            told = "; ".join(
                f"{field} {_short(recorded, field)}, now {_short(replayed, field)}" for field in self.fields
            )
            text = f"decision {self.number}, of {known.ensemble!r} at {at:.6f} s: {told}"
        lines = [text, *(f"  before it: {_told(stimulus, epoch)}" for stimulus in self.since)]
        return "\n".join(lines)


def unlike(recorded: Decision, replayed: Decision, tolerance: float) -> tuple[str, ...]:
    """Return the names of the fields of two decisions that differ; numbers by more than a tolerance."""
    found = [
        field
        for field in ("time", "ensemble", "epoch", "cause", "state", "observation", "action")
        if getattr(recorded, field) != getattr(replayed, field)
    ]
    if not _alike(recorded.reward, replayed.reward, tolerance):
        found.append("reward")
    before, now = recorded.belief, replayed.belief
    if before is not None and (now is None or len(now) != len(before) or not _close(before, now, tolerance)):
        found.append("belief")
    return tuple(found)


def _alike(one: float | None, other: float | None, tolerance: float) -> bool:
    if one is None or other is None:
        return one is other
    return one == other or abs(one - other) <= tolerance or (math.isnan(one) and math.isnan(other))


def _close(one: Any, other: Any, tolerance: float) -> bool:
    return bool(np.array_equal(one, other) or (tolerance and np.max(np.abs(np.asarray(one) - other)) <= tolerance))


def _short(decision: Decision, field: str) -> str:
    value = decision.action_name if field == "action" else getattr(decision, field)
    if isinstance(value, np.ndarray):
        best = int(np.argmax(value))
        return f"{value[best]:.12g} of state {best}"
    return repr(value)


def _told(stimulus: Any, epoch: int) -> str:
    facts = {name: value for name, value in msgspec.structs.asdict(stimulus).items() if value not in ("", 0, None)}
    at = (facts.pop("time", epoch) - epoch) / 1e9
    facts = {name: f"{len(value)} bytes" if isinstance(value, bytes) else value for name, value in facts.items()}
    kind = type(stimulus).__name__.lower()
    return f"{at:.6f} s, {kind} " + ", ".join(f"{name} {value}" for name, value in facts.items())
