"""Loading a model or a policy from a file of any format, chosen by suffix and content."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from mdm.errors import FormatError, ModelError
from mdm.formats import cassandra, dpomdp, ublas, value_function
from mdm.formats.cassandra import LARGEST
from mdm.formats.source import Source, suffixes
from mdm.policies import AlphaVectors, DeterministicPolicy, QTable, StochasticPolicy

if TYPE_CHECKING:
    from pathlib import Path

    from mdm.models import MDP, POMDP

__all__ = ["LoadedPolicy", "PolicyKind", "load_model", "load_policy", "load_rewards"]

LoadedPolicy = AlphaVectors | DeterministicPolicy | QTable | StochasticPolicy
PolicyKind = Literal["table", "stochastic", "q"]
_AGENTS = re.compile(r"^\s*agents\s*:", re.MULTILINE)


def load_model(path: str | Path, *, sparse: bool | None = None) -> MDP | POMDP:
    """Read a model: Cassandra's ``.pomdp`` and ``.mdp``, or MADP's ``.dpomdp``; any of them may be gzipped.

    Args:
        path: The file.
        sparse: Force CSR (True) or dense (False) matrices; None chooses by size and density.

    Raises:
        FormatError: With the place, what stands there and what was expected.
    """
    suffix = suffixes(path)
    if suffix == ".dpomdp":
        return dpomdp.read(path, sparse=sparse)
    if suffix not in {".pomdp", ".mdp"} and _AGENTS.search(Source(path).text):
        return dpomdp.read(path, sparse=sparse)
    return cassandra.read(path, sparse=sparse)


def load_policy(
    path: str | Path,
    model: MDP | POMDP | None = None,
    *,
    kind: PolicyKind | None = None,
    seed: int | None = None,
) -> LoadedPolicy:
    """Read a policy: the original MDM's vectors, matrices and Q-tables (uBLAS text), or MADP's ``.vf``.

    A matrix whose columns are distributions is a stochastic policy (actions x states), any other a Q-table
    (states x actions); with a model, its sizes decide.

    Args:
        path: The file.
        model: The model that the policy is for; its sizes are checked.
        kind: What uBLAS text holds, where neither content nor model decide: ``stochastic`` or ``q`` for a matrix,
            ``table`` for a vector of actions.
        seed: For the draws of a stochastic policy.

    Raises:
        FormatError: With the place, what stands there and what was expected.
    """
    source = Source(path)
    num_actions = None if model is None else len(model.action_space)
    policy: LoadedPolicy
    try:
        if source.text.lstrip().startswith("["):
            policy = _table(source, ublas.read(path), model, kind, seed)
        else:
            policy = value_function.read(path, num_actions=num_actions)
    except ModelError as error:
        raise FormatError(str(error), file=source.path) from None
    if model is not None and (policy.num_states, policy.num_actions) != (len(model.state_space), num_actions):
        source.fail(
            f"the policy is for {policy.num_states} states and {policy.num_actions} actions, but the model has "
            f"{len(model.state_space)} and {num_actions}"
        )
    return policy


def load_rewards(path: str | Path) -> npt.NDArray[np.float64]:
    """Read a reward matrix R(s, a): states x actions, as uBLAS text.

    Raises:
        FormatError: If it is no matrix of finite numbers.
    """
    matrix = ublas.read(path)
    if matrix.ndim != 2 or not np.isfinite(matrix).all():
        raise FormatError("a reward matrix of states x actions was expected, of finite numbers", file=path)
    return matrix


def _table(
    source: Source,
    array: npt.NDArray[np.float64],
    model: MDP | POMDP | None,
    kind: PolicyKind | None,
    seed: int | None,
) -> LoadedPolicy:
    if kind is not None and (kind == "table") != (array.ndim == 1):
        held = "a vector, an action per state" if array.ndim == 1 else "a matrix"
        source.fail(f"the file holds {held}, but kind={kind!r} was asked for")
    if array.ndim == 1:
        return _vector(source, array, None if model is None else len(model.action_space))
    stochastic = bool((array >= 0).all() and (np.abs(array.sum(axis=0) - 1) <= 1e-4).all())
    if kind is None and model is not None and array.shape[0] != array.shape[1]:
        as_policy = array.shape == (len(model.action_space), len(model.state_space))
        as_table = array.shape == (len(model.state_space), len(model.action_space))
        kind = "stochastic" if as_policy else "q" if as_table else None
    if kind is None:
        nearly = bool((array >= 0).all() and (array <= 1).all())
        if not stochastic and nearly and array.sum(axis=0).max() > 1:
            kind = "stochastic"  # probabilities that do not sum to one are a broken policy rather than a Q-table
        else:
            kind = "stochastic" if stochastic else "q"
    if kind == "q":
        return QTable(array)
    try:
        return StochasticPolicy(array, seed=seed)
    except ModelError as error:
        raise ModelError(f"{error}; if the matrix is a Q-table (states x actions), say kind='q'") from None


def _vector(source: Source, array: npt.NDArray[np.float64], num_actions: int | None) -> DeterministicPolicy:
    for state, action in enumerate(array.tolist()):
        if not (0 <= action <= LARGEST and action.is_integer()):
            source.fail(f"the action for state {state} is {action:g}: an index from 0 on was expected")
        if num_actions is not None and action >= num_actions:
            source.fail(f"the action for state {state} is {action:g}, but the model's {num_actions} count from 0")
    return DeterministicPolicy(array.astype(int).tolist(), num_actions)
