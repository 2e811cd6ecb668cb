"""Policies over states as a vector or matrix of numbers: which of the kinds of tables it is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.formats.cassandra.model import LARGEST
from mdm.policies import DeterministicPolicy, QTable, StochasticPolicy

if TYPE_CHECKING:
    from mdm.formats.source import Source
    from mdm.models import MDP

__all__ = ["PolicyKind", "table"]

PolicyKind: TypeAlias = Literal["table", "stochastic", "q"]


def table(
    source: Source,
    array: npt.NDArray[np.float64],
    model: MDP | None,
    kind: PolicyKind | None,
    seed: int | None,
) -> DeterministicPolicy | QTable | StochasticPolicy:
    """Return the policy that a vector or matrix is.

    Args:
        source: The file that it stands in.
        array: The vector, an action per state; or the matrix, probabilities (actions x states) or values (states x
            actions).
        model: The model that it is for.
        kind: Which of these it is, where that is known.
        seed: For the draws of a stochastic policy.

    Raises:
        FormatError: If a vector's entry is no action, or the array is not of the kind that was asked for.
        ModelError: If a matrix is no policy.
    """
    if kind is not None and (kind == "table") != (array.ndim == 1):
        held = "a vector, an action per state" if array.ndim == 1 else "a matrix"
        source.fail(f"the file holds {held}, but kind={kind!r} was asked for")
    if array.ndim == 1:
        return _vector(source, array, None if model is None else len(model.action_space))
    if kind is None:
        kind = _matrix_kind(array, model)
    if kind == "q":
        return QTable(array)
    try:
        return StochasticPolicy(array, seed=seed)
    except ModelError as error:
        raise ModelError(f"{error}; if the matrix is a Q-table (states x actions), say kind='q'") from None


def _matrix_kind(array: npt.NDArray[np.float64], model: MDP | None) -> PolicyKind:
    """Return what a matrix is: by the model's sizes, where it is not square, and else by its numbers."""
    if model is not None and array.shape[0] != array.shape[1]:
        sizes = len(model.action_space), len(model.state_space)
        if array.shape in {sizes, sizes[::-1]}:
            return "stochastic" if array.shape == sizes else "q"
    stochastic = bool((array >= 0).all() and (np.abs(array.sum(axis=0) - 1) <= 1e-4).all())
    nearly = bool((array >= 0).all() and (array <= 1).all() and array.sum(axis=0).max() > 1)
    # Probabilities that do not sum to one are a broken policy rather than a Q-table.
    return "stochastic" if stochastic or nearly else "q"


def _vector(source: Source, array: npt.NDArray[np.float64], num_actions: int | None) -> DeterministicPolicy:
    for state, action in enumerate(array.tolist()):
        if not (0 <= action <= LARGEST and action.is_integer()):
            source.fail(f"the action for state {state} is {action:g}: an index from 0 on was expected")
        if num_actions is not None and action >= num_actions:
            source.fail(f"the action for state {state} is {action:g}, but the model's {num_actions} count from 0")
    return DeterministicPolicy(array.astype(int).tolist(), num_actions)
