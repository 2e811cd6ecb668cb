"""Policies of every format: which one a file holds is told by its suffix and content."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from mdm.errors import FormatError, ModelError
from mdm.formats.archive import npz, policy as policy_archive
from mdm.formats.plans import joint_policy, policy_graph
from mdm.formats.recognition import JOINT, PLANES, beginning, holds_policy
from mdm.formats.source import Source, suffixes
from mdm.formats.tables import q_table, state_table, ublas
from mdm.formats.tables.state_table import PolicyKind
from mdm.formats.target import check_place
from mdm.formats.vectors import alpha, sarsop as sarsop_policy, value_function, zmdp
from mdm.models import POMDP
from mdm.policies import (
    AlphaVectors,
    DeterministicPolicy,
    FiniteStateController,
    JointController,
    MaskedAlphaVectors,
    MixedAlphaVectors,
    QTable,
    StochasticPolicy,
    mismatch,
)

if TYPE_CHECKING:
    from mdm.models import MDP
    from mdm.policies import Policy

__all__ = ["PolicyKind", "check_policy_file", "load_policy", "load_rewards", "save_policy"]

_Form: TypeAlias = Literal["array", "sarsop", "zmdp", "joint", "graph", "alpha", "value function", "q-table"]
_Writer: TypeAlias = Callable[[Any, Path, "MDP | None"], object]
_TABLES: dict[str, type] = {"table": DeterministicPolicy, "stochastic": StochasticPolicy, "q": QTable}
_BY_SUFFIX: dict[str, _Form] = {".pg": "graph", ".alpha": "alpha", ".vf": "value function"}


def _nameless(write: Callable[[Any, Path], object]) -> _Writer:
    """Return what writes a format that has no names of the model."""
    return lambda policy, path, _: write(policy, path)


_TABLE = {".policy": _nameless(ublas.write)}
_VECTORS = {".policy": _nameless(sarsop_policy.write), ".policyx": _nameless(sarsop_policy.write)}
_WRITERS: dict[type, dict[str, _Writer]] = {
    AlphaVectors: {**_VECTORS, ".alpha": _nameless(alpha.write), ".vf": _nameless(value_function.write)},
    MixedAlphaVectors: _VECTORS,
    MaskedAlphaVectors: {".policy": _nameless(zmdp.write)},
    DeterministicPolicy: _TABLE,
    StochasticPolicy: _TABLE,
    QTable: _TABLE,
    FiniteStateController: {".pg": _nameless(policy_graph.write)},
    JointController: {".policy": joint_policy.write},
}
"""By their suffixes, the formats that hold policies of each kind; ``.npz`` holds any."""


def load_policy(
    path: str | Path,
    model: MDP | None = None,
    *,
    kind: PolicyKind | None = None,
    seed: int | None = None,
) -> Policy:
    """Read a policy of any format.

    These are the original MDM's vectors, matrices and Q-tables (uBLAS text); MADP's ``.vf``, Q-tables and joint
    policies; Cassandra's ``.alpha`` and ``.pg``; SARSOP's ``.policy``; ZMDP's; and mdm's own ``.npz``.

    A uBLAS matrix whose columns are distributions is a stochastic policy (actions x states), any other a Q-table
    (states x actions); with a model, its sizes decide.

    Args:
        path: The file.
        model: The model that the policy is for; its sizes are checked, and names where the file has them.
        kind: What a table is, where neither content nor model decide: ``stochastic`` or ``q`` for a matrix,
            ``table`` for a vector of actions.
        seed: For the draws of a stochastic policy.

    Raises:
        FormatError: With the place, what stands there and what was expected.
    """
    path = Path(path)
    if path.suffix.lower() == ".npz" or npz.is_archive(path):
        policy = policy_archive.read(path, model, seed=seed)
        if kind is not None and not isinstance(policy, _TABLES[kind]):
            raise FormatError(f"the archive holds {type(policy).__name__}, but kind={kind!r} was asked for", file=path)
        return policy
    source = Source(path)
    if holds_policy(beginning(path)) is False:
        source.fail("the file holds a model; a policy was expected")
    form = _form(source, kind)
    if kind is not None and form not in {"array", "q-table"}:
        source.fail(f"the file holds no table ({form}), but kind={kind!r} was asked for")
    try:
        policy = _read(source, form, model, kind, seed)
    except ModelError as error:
        raise FormatError(str(error), file=path) from None
    wrong = None if model is None else mismatch(policy, model)
    if wrong is not None:
        source.fail(wrong)
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


def save_policy(policy: Policy, path: str | Path, model: MDP | None = None) -> None:
    """Write a policy, in the format that the file's suffix stands for.

    ``.npz`` keeps any policy, with the names of its model. ``.alpha`` and ``.vf`` hold alpha vectors, ``.pg``
    controllers (and an ``.alpha`` beside it their values). In a ``.policy`` file, and in one without a suffix, alpha
    vectors are written as SARSOP does (as ``.policyx``, too), those with masks as ZMDP, tables as uBLAS text, and joint
    controllers as MADP, which needs the model.

    Args:
        policy: The policy.
        path: The file.
        model: The model that the policy is for.

    Raises:
        ModelError: If the suffix stands for no format that holds such a policy, or the policy does not fit the model.
        FormatError: If the file cannot be written.
    """
    wrong = None if model is None else mismatch(policy, model)
    if wrong is not None:
        raise ModelError(wrong)
    _writer(type(policy), Path(path))(policy, Path(path), model)


def check_policy_file(kind: type, path: str | Path) -> None:
    """Refuse a file whose name stands for no format that holds policies of a kind, before there is one to write.

    Args:
        kind: The policy's class.
        path: The file.

    Raises:
        ModelError: If its suffix stands for no format that holds such a policy.
        FormatError: If it is a folder, or its folder is none that can be written to.
    """
    path = Path(path)
    _writer(kind, path)
    check_place(path)


def _writer(kind: type, path: Path) -> _Writer:
    """Return what writes policies of a kind into a file."""
    writers: dict[str, _Writer] = {".npz": policy_archive.write}
    for other, more in _WRITERS.items():
        if issubclass(kind, other):
            writers |= more
    writer = writers.get(path.suffix.lower() or ".policy")
    if writer is None:
        raise ModelError(f"{kind.__name__} cannot be written as {path.name!r}: its files end in {', '.join(writers)}")
    return writer


def _form(source: Source, kind: PolicyKind | None) -> _Form:
    """Return what a text holds: told by how it begins or by a word that none but one form has, then by its suffix."""
    text = source.text.lstrip()
    if text[0] in "[<":
        return "array" if text[0] == "[" else "sarsop"
    if PLANES.search(text):
        return "zmdp"
    if JOINT.search(text):
        return "joint"
    by_suffix = _BY_SUFFIX.get(suffixes(source.path))
    if by_suffix is not None:
        return by_suffix
    lines = [line.split() for line in text.rstrip().split("\n")]
    if kind is not None:
        return "q-table"
    if not {"X", "x", "-"}.isdisjoint(lines[0]):
        return "graph"
    # Blocks have blank lines between them, a table has none: this alone tells two columns from a head of two words.
    table = len(lines) > 2 and all(len(line) == len(lines[0]) for line in lines)
    if len(lines[0]) == 1:
        return "alpha"
    return "value function" if len(lines[0]) == 2 and not table else "q-table"


def _read(source: Source, form: _Form, model: MDP | None, kind: PolicyKind | None, seed: int | None) -> Policy:
    path = source.path
    num_actions = None if model is None else len(model.action_space)
    match form:
        case "array":
            return state_table.table(source, ublas.read(path), model, kind, seed)
        case "q-table":
            return state_table.table(source, q_table.read(path), model, kind or "q", seed)
        case "sarsop":
            return sarsop_policy.read(path, model)
        case "zmdp":
            return zmdp.read(path, model)
        case "joint":
            return joint_policy.read(path, model)
        case "graph":
            num_observations = len(model.observation_space) if isinstance(model, POMDP) else None
            return policy_graph.read(path, num_actions=num_actions, num_observations=num_observations)
        case "alpha":
            return alpha.read(path, num_actions=num_actions)
        case "value function":
            return value_function.read(path, num_actions=num_actions)
