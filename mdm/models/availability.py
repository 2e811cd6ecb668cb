"""Which actions are available in which states.

Where an action is not available, the row of T and the reward of the first available one stand in place of its own. So
the values of states are those of the available actions, whoever computes them; policies, simulations and controllers
ask which these are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from mdm.errors import ModelError
from mdm.models.matrices import csr, is_compressed

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt

    from mdm.models.mdp import MDP
    from mdm.models.pomdp import POMDP
    from mdm.models.space import Space

    Available: TypeAlias = npt.ArrayLike | Callable[[str, str], bool]
    Mask: TypeAlias = npt.NDArray[np.bool_]

HINT = "declare actions that are not available in a state by available= of mdm.models.MDP and POMDP, and write .npz"
"""The way out of a reward of -inf, for the end of an error."""


def availability(given: Available | None, states: Space, actions: Space) -> Mask | None:
    """Return for each state and action whether it is available, S x A; None where all are.

    Args:
        given: An S x A array of booleans, or a function of the names of a state and an action.
        states: The states.
        actions: The actions.

    Raises:
        ModelError: If it is neither, or a state has no available action.
    """
    if given is None:
        return None
    mask = np.array([[given(s, a) for a in actions.names] for s in states.names] if callable(given) else given)
    if mask.dtype != np.bool_ or mask.shape != (len(states), len(actions)):
        raise ModelError(
            f"available actions are a states x actions array of booleans, here {len(states)} x {len(actions)}, or a "
            f"function of the names of a state and an action that returns one"
        )
    none = ~mask.any(axis=1)
    if none.any():
        raise ModelError(f"no action is available in state {states.names[int(none.argmax())]!r}: one must be")
    mask.setflags(write=False)
    return None if mask.all() else mask


def first_available(available: Mask) -> npt.NDArray[np.intp]:
    """Return for each state its first available action."""
    first: npt.NDArray[np.intp] = available.argmax(axis=1)
    return first


def standing_in(given: Any, available: Mask) -> Any:
    """Return matrices, or rewards of any form but R(s), with those of the first available action where it stands in."""
    size, count = available.shape
    source = np.where(available, np.arange(count), first_available(available)[:, None])
    states = np.arange(size)
    if isinstance(given, np.ndarray) and given.ndim == 2:
        return given[states[:, None], source]
    if len(given) != count or any(np.shape(each)[:2] != (size, size) for each in given):
        return given  # which is refused for its shape
    if any(map(is_compressed, given)):
        from scipy.sparse import vstack  # noqa: PLC0415 - slow to import

        rows = csr(vstack([csr(each) for each in given]))
        return [rows[source[:, action] * size + states] for action in range(count)]
    return np.stack([np.asarray(each, dtype=np.float64) for each in given])[source.T, states]


def refuse(model: MDP, state: int, action: int) -> None:
    """Refuse an action in a state where it is not available.

    Raises:
        ModelError: With the actions that are.
    """
    if model.available is not None and not model.available[state, action]:
        names = model.action_space.names
        there = ", ".join(repr(names[each]) for each in np.flatnonzero(model.available[state]).tolist())
        where = model.state_space.names[state]
        raise ModelError(f"the action {names[action]!r} is not available in state {where!r}; available are {there}")


def check_known(model: POMDP) -> None:
    """Refuse a model whose agent would not know from what it has just observed which actions are available.

    Raises:
        ModelError: With two states that it cannot tell apart; or if observations may be missed.
    """
    if (mask := model.available) is None:
        return
    if model.waits:
        raise ModelError("a model with actions that are not available has to observe each step, and misses no event")
    kinds = np.unique(mask, axis=0, return_inverse=True)[1].ravel()
    reached: list[tuple[str, Any]] = [("at the start", model.initial_belief)]
    for action, name in enumerate(model.action_space.names):
        for observation, seen in enumerate(model.observation_space.names):
            joint = csr(model.joint_matrix(action, observation))[mask[:, action]]
            reached.append((f"after {name!r} and {seen!r}", np.asarray(joint.sum(axis=0)).ravel()))
    for when, chances in reached:
        states = np.flatnonzero(chances > 0)
        other = states[kinds[states] != kinds[states[:1]]]
        if len(other):
            one, two = (repr(model.state_space.names[state]) for state in (states[0], other[0]))
            raise ModelError(
                f"{when} the agent does not know which actions are available: {one} and {two} have different ones. "
                f"Let observations, or the initial belief, tell these states apart"
            )
