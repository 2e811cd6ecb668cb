"""Construction of table policies from a vector or matrix, including the choice of their kind."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.formats.source import LARGEST
from mdm.policies import DeterministicPolicy, QTable, StochasticPolicy

if TYPE_CHECKING:
    from mdm.formats.policies import PolicyKind
    from mdm.formats.source import Source
    from mdm.models import MDP

__all__ = ["table"]


def table(
    source: Source,
    array: npt.NDArray[np.float64],
    model: MDP | None,
    kind: PolicyKind | None,
    seed: int | None,
) -> DeterministicPolicy | QTable | StochasticPolicy:
    """Make a policy of a vector or matrix.

    Args:
        source: The file, for errors.
        array: A vector, an action per state; or a matrix of probabilities (actions x states) or values (states x
            actions).
        model: The policy's model, if known.
        kind: The kind of table; None to find out.
        seed: Seed of a stochastic policy's draws.

    Raises:
        FormatError: If a vector's entry is not an action, or the array does not fit the kind.
        ModelError: If a matrix is not a policy.
    """
    if kind is not None and (kind == "table") != (array.ndim == 1):
        held = "a vector of actions" if array.ndim == 1 else "a matrix"
        source.fail(f"the file holds {held}, not kind={kind!r}")
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
    """Return the kind of a matrix, from its shape if the model decides, else from its numbers."""
    if model is not None and array.shape[0] != array.shape[1]:
        sizes = len(model.action_space), len(model.state_space)
        if array.shape in {sizes, sizes[::-1]}:
            return "stochastic" if array.shape == sizes else "q"
    stochastic = bool((array >= 0).all() and (np.abs(array.sum(axis=0) - 1) <= 1e-4).all())
    nearly = bool((array >= 0).all() and (array <= 1).all() and array.sum(axis=0).max() > 1)
    # Probabilities that do not sum to 1 are more likely a broken policy than a Q-table.
    return "stochastic" if stochastic or nearly else "q"


def _vector(source: Source, array: npt.NDArray[np.float64], num_actions: int | None) -> DeterministicPolicy:
    for state, action in enumerate(array.tolist()):
        if not (0 <= action <= LARGEST and action.is_integer()):
            source.fail(f"the action for state {state} is {action:g}, not an index from 0 on")
        if num_actions is not None and action >= num_actions:
            source.fail(f"the action for state {state} is {action:g}, but the model has actions 0 to {num_actions - 1}")
    return DeterministicPolicy(array.astype(int).tolist(), num_actions)
