"""Input of a controller from outside: beliefs of a user's own tracker, and snapshots, maybe of another process."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from mdm.beliefs.tracker import checked_support
from mdm.errors import ModelError

if TYPE_CHECKING:
    from mdm.models.matrices import Vector


def checked_belief(belief: Any, size: int | None) -> Vector:
    """Return a copy of the belief of a user's tracker, which may change its own in place; refuse an invalid one."""
    try:
        array = copied(belief)
    except (TypeError, ValueError):
        raise ModelError(f"the tracker's belief is not an array of numbers, but {belief!r}") from None
    if array.shape != (array.size if size is None else size,):
        raise ModelError(f"the tracker's belief has the shape {array.shape}, but there are {size} states")
    if not (np.isfinite(array).all() and (array >= 0).all() and abs(array.sum() - 1) < 1e-6):
        raise ModelError(
            "the tracker's belief is not a distribution: its numbers are negative, not finite, or do not sum to 1"
        )
    return array


def copied(belief: Any) -> Vector:
    """Return a belief as an immutable array of its own."""
    array = np.array(belief, dtype=np.float64)
    array.flags.writeable = False
    return array


_MOST = (1 << 62) - 1
_ONE = 1 + 1e-6
"""A probability at most, with what rounding adds."""


class Held(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """All that a controller needs to go on from.

    Args:
        configuration: The digest of the constant part.
        epoch: Decisions made in this episode.
        last_action: The last one, None before the first.
        given: Whether the next decision is on a belief from outside.
        probability: Of the observation that was not decided on yet.
        initial: The belief that episodes begin from, if it is not the model's.
        information: The snapshot of the information state.
    """

    configuration: str
    epoch: Annotated[int, Meta(ge=0, le=_MOST)]
    last_action: Annotated[int, Meta(ge=0, le=_MOST)] | None
    given: bool
    probability: Annotated[float, Meta(ge=0, le=_ONE)] | None
    initial: list[float] | None
    information: Any


_decode = msgspec.msgpack.Decoder(Held).decode


def opened(snapshot: bytes) -> Held:
    """Return the content of a snapshot; refuse any other bytes."""
    try:
        return _decode(snapshot)
    except (msgspec.MsgspecError, TypeError, ValueError, RecursionError) as error:
        raise ModelError(f"this is not a snapshot of a controller: {error}") from None


def check_counts(held: Held, num_actions: int, horizon: int | None) -> None:
    """Refuse an action that the policy has not, and more decisions than its horizon allows."""
    if held.last_action is not None and held.last_action >= num_actions:
        raise ModelError(f"its last action is {held.last_action}, but there are {num_actions}")
    if held.last_action is None and held.epoch:
        raise ModelError(f"it has made {held.epoch} decisions, and no action is the last")
    if horizon is not None and held.epoch > horizon:
        raise ModelError(f"it has made {held.epoch} decisions of {horizon}")


def check_information(information: Any, num_states: int | None) -> None:
    """Refuse an information state that is none of the model's, and leave it as it is.

    Raises:
        ModelError: If a state does not exist, or the belief is not a distribution.
    """
    information = getattr(information, "of", information)  # to read what is drawn along with it would draw
    state = getattr(information, "state", None)
    if state is not None and (type(state) is not int or (num_states is not None and not 0 <= state < num_states)):
        raise ModelError(f"there is no state {state!r}; the {num_states} count from 0")
    support = getattr(information, "support", None)
    if support is not None and num_states is not None:
        checked_support(support, num_states)
    elif support is None and isinstance(getattr(information, "current", None), np.ndarray):
        checked_belief(information.current, num_states)
