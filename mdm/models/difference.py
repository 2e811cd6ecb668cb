"""The first entry by which two models differ, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_array

from mdm.models.matrices import is_compressed
from mdm.models.units import in_words

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mdm.models.mdp import MDP

__all__ = ["first_difference"]


def first_difference(then: MDP, now: MDP) -> str | None:
    """Return in words the first entry of a model that is another than in an earlier one.

    Spaces come first, then the discount, transitions, observations and rewards, by actions and rows.

    Args:
        then: The earlier one.
        now: The model.

    Returns:
        The sentence; None where no entry differs, or the models are factored, whose entries are not laid out.

    Example:
        >>> from mdm.models import MDP
        >>> first_difference(MDP([[[1.0]]], [[0]], discount=0.9), MDP([[[1.0]]], [[2]], discount=0.9))
        "the reward of '0' in '0' was 0, and is 2"
    """
    for kind, was, is_now in _spaces(then, now):
        if was != is_now:
            return f"the {kind} were {was}, and are {is_now}"
    if then.discount_of != now.discount_of:
        return f"the discount was of {in_words(then.discount_of)}, and is of {in_words(now.discount_of)}"
    if then.discount != now.discount:
        return f"the discount was {then.discount:.12g}, and is {now.discount:.12g}"
    if then.network is not None or now.network is not None:
        return None
    return next(_entries(then, now), None)


def _spaces(then: MDP, now: MDP) -> Iterator[tuple[str, str, str]]:
    """Yield the first names of each kind that differ; their numbers where these do."""
    for kind in ("state", "action", "observation"):
        was, is_now = (getattr(each, f"{kind}_space", None) for each in (then, now))
        sizes = [0 if space is None else len(space) for space in (was, is_now)]
        yield f"numbers of {kind}s", str(sizes[0]), str(sizes[1])
        for one, other in zip(was.names if was else (), is_now.names if is_now else (), strict=False):
            yield f"names of a {kind}", one, other


def _entries(then: MDP, now: MDP) -> Iterator[str]:
    """Yield the first entry of each matrix that differs."""
    states, actions = now.state_space.names, now.action_space.names
    every = np.ones(now.rewards.shape, dtype=bool)
    was, is_now = (every if model.available is None else model.available for model in (then, now))
    for row, column in np.argwhere(was != is_now):
        yield f"whether {actions[column]!r} is available in {states[row]!r} is another thing"
    for action, name in enumerate(actions):
        found = _first(then.transition_matrix(action), now.transition_matrix(action))
        if found is not None:
            row, column, told = found
            yield f"the probability of {states[column]!r} after {name!r} in {states[row]!r} {told}"
    if then.pomdp is not None and now.pomdp is not None:
        names = now.pomdp.observation_space.names
        if then.pomdp.event_observations or now.pomdp.event_observations:
            names = ()
        for action, name in enumerate(actions if names else ()):
            found = _first(then.pomdp.observation_matrix(action), now.pomdp.observation_matrix(action))
            if found is not None:
                row, column, told = found
                yield f"the probability of observing {names[column]!r} in {states[row]!r} after {name!r} {told}"
    found = _first(np.asarray(then.rewards), np.asarray(now.rewards))
    if found is not None:
        row, column, told = found
        yield f"the reward of {actions[column]!r} in {states[row]!r} {told}"


def _first(was: Any, is_now: Any) -> tuple[int, int, str] | None:
    """Return row and column of the first entry of two matrices that differs, and what it was and is."""
    if was.ndim != 2 or was.shape != is_now.shape:
        return None
    if is_compressed(was) != is_compressed(is_now):
        was, is_now = csr_array(was), csr_array(is_now)
    rows, columns = (was != is_now).nonzero()
    if not len(rows):
        return None
    first = np.lexsort((columns, rows))[0]
    row, column = int(rows[first]), int(columns[first])
    return row, column, f"was {was[row, column]:.12g}, and is {is_now[row, column]:.12g}"
