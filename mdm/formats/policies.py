"""Loading and saving policies in any format, chosen by content and suffix."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from mdm.errors import FormatError, ModelError
from mdm.formats.archive import npz, policy as policy_archive
from mdm.formats.recognition import JOINT, PLANES, format_of, is_policy
from mdm.formats.source import Source, suffixes
from mdm.formats.target import check_place
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

_Form: TypeAlias = Literal["array", "sarsop", "zmdp", "joint", "graph", "alpha", "value function", "vectors", "q-table"]
PolicyKind: TypeAlias = Literal["table", "stochastic", "q"]
_TABLES: dict[str, type] = {"table": DeterministicPolicy, "stochastic": StochasticPolicy, "q": QTable}
_BY_SUFFIX: dict[str, _Form] = {".pg": "graph", ".alpha": "alpha", ".vf": "value function"}
_BY_FORM = {
    "sarsop": "sarsop.policy",
    "zmdp": "zmdp",
    "joint": "madp.joint_policy",
}
"""The modules that read these forms."""

_ARCHIVE, _JOINT = "archive.policy", "madp.joint_policy"
_TABLE = {".policy": "mdm1"}
_VECTORS = {".policy": "sarsop.policy", ".policyx": "sarsop.policy"}
_WRITTEN: dict[type, dict[str, str]] = {
    AlphaVectors: {**_VECTORS, ".alpha": "cassandra.alpha", ".vf": "madp.value_function"},
    MixedAlphaVectors: _VECTORS,
    MaskedAlphaVectors: {".policy": "zmdp"},
    DeterministicPolicy: _TABLE,
    StochasticPolicy: _TABLE,
    QTable: _TABLE,
    FiniteStateController: {".pg": "cassandra.policy_graph"},
    JointController: {".policy": _JOINT},
}
"""The module that writes, by class of policy and suffix; ``.npz`` holds any policy."""


def load_policy(
    path: str | Path,
    model: MDP | None = None,
    *,
    kind: PolicyKind | None = None,
    seed: int | None = None,
) -> Policy:
    """Read a policy in any format.

    The formats are the original MDM's vectors, matrices and Q-tables (uBLAS text); MADP's ``.vf``, Q-tables and joint
    policies; Cassandra's ``.alpha`` and ``.pg``; SARSOP's ``.policy``; ZMDP's ``.policy``; and mdm's own ``.npz``.

    A uBLAS matrix whose columns are distributions is a stochastic policy (actions x states), any other a Q-table
    (states x actions); with a model, its sizes decide.

    Example::

        model = mdm.load_model("tiger.pomdp")
        policy = mdm.load_policy("tiger.vf", model)
        policy.value(model.initial_belief)  # 19.37

    Args:
        path: The file.
        model: The policy's model. Sizes are checked against it, and names where the file has them.
        kind: The kind of a table: ``stochastic`` or ``q`` for a matrix, ``table`` for a vector of actions; by default
            found from content and model.
        seed: Seed of a stochastic policy's draws.

    Raises:
        FormatError: If the file cannot be read, is malformed or does not fit the model, with the place and what was
            expected.
    """
    path = Path(path)
    if path.suffix.lower() == ".npz" or npz.is_archive(path):
        policy = policy_archive.read(path, model, seed=seed)
        if kind is not None and not isinstance(policy, _TABLES[kind]):
            raise FormatError(f"the archive holds a {type(policy).__name__}, not kind={kind!r}", file=path)
        return policy
    source = Source(path)
    if suffixes(path) == ".toml":
        source.fail("this is a TOML file of ensembles; a policy was expected")
    if kind is None and not is_policy(path):
        source.fail("the file holds a model; a policy was expected")
    form = _form(source, kind)
    if kind is not None and form not in {"array", "q-table"}:
        source.fail(f"kind={kind!r} is for tables, but this file is of form {form!r}")
    try:
        policy = _read(source, form, model, kind, seed)
    except ModelError as error:
        raise FormatError(str(error), file=path) from None
    wrong = None if model is None else mismatch(policy, model)
    if wrong is not None:
        hint = "; each line begins with an index, as of an action before its alpha vector: if these are values of "
        source.fail(wrong + (f"{hint}actions, say kind='q'" if form == "vectors" else ""))
    return policy


def load_rewards(path: str | Path) -> npt.NDArray[np.float64]:
    """Read a reward matrix R(s, a): states x actions, as uBLAS text.

    Raises:
        FormatError: If the file is not a matrix of finite numbers.
    """
    matrix: npt.NDArray[np.float64] = format_of("mdm1").read(path)
    if matrix.ndim != 2 or not np.isfinite(matrix).all():
        raise FormatError("a states x actions matrix of finite rewards was expected", file=path)
    return matrix


def save_policy(policy: Policy, path: str | Path, model: MDP | None = None) -> None:
    """Write a policy in the format of the file's suffix.

    ``.npz`` keeps any policy, with the names of its model. ``.alpha`` and ``.vf`` hold alpha vectors, ``.pg``
    finite-state controllers (with their values in an ``.alpha`` file beside it). A ``.policy`` file, or one without a
    suffix, has SARSOP's format for alpha vectors (as has ``.policyx``), ZMDP's for masked ones, uBLAS text for tables,
    and MADP's for joint controllers, which needs the model.

    Example::

        mdm.save_policy(policy, "tiger.npz", model)

    Args:
        policy: The policy.
        path: The file.
        model: The policy's model.

    Raises:
        ModelError: If the suffix's format cannot hold this policy, or the policy does not fit the model.
        FormatError: If the file cannot be written.
    """
    if model is None and isinstance(policy, AlphaVectors) and policy.named:
        raise ModelError("the policy's file names its actions, and the model alone knows their indices: give the model")
    wrong = None if model is None else mismatch(policy, model)
    if wrong is not None:
        raise ModelError(wrong)
    form = _written(type(policy), Path(path))
    names = (model,) if form in {_ARCHIVE, _JOINT} else ()  # the others do not use the model's names
    format_of(form).write(policy, Path(path), *names)


def check_policy_file(kind: type, path: str | Path) -> None:
    """Check, before a policy is computed, that a file could hold it and can be written.

    Args:
        kind: The policy's class.
        path: The file.

    Raises:
        ModelError: If the suffix's format cannot hold this kind of policy.
        FormatError: If the path is a folder, or its folder is not writable.
    """
    path = Path(path)
    _written(kind, path)
    check_place(path)


def _written(kind: type, path: Path) -> str:
    """Return the module that writes a class of policies to a file with this suffix."""
    forms = {".npz": _ARCHIVE}
    for other, more in _WRITTEN.items():
        if issubclass(kind, other):
            forms |= more
    form = forms.get(path.suffix.lower() or ".policy")
    if form is None:
        raise ModelError(f"{kind.__name__} cannot be written as {path.name!r}: its files end in {', '.join(forms)}")
    return form


def _form(source: Source, kind: PolicyKind | None) -> _Form:
    """Return a text's form, found from its beginning, else a distinctive word, else the suffix, else its layout."""
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
    # Only the blank lines between blocks distinguish a value function from a table of two columns.
    table = len(lines) > 2 and all(len(line) == len(lines[0]) for line in lines)
    if len(lines[0]) == 1:
        return "alpha"
    if format_of("madp.q_table").are_vectors(lines):
        return "vectors"
    return "value function" if len(lines[0]) == 2 and not table else "q-table"


def _read(source: Source, form: _Form, model: MDP | None, kind: PolicyKind | None, seed: int | None) -> Policy:
    path = source.path
    num_actions = None if model is None else len(model.action_space)
    policy: Policy
    match form:
        case "array":
            array = format_of("mdm1").read(path)
            policy = format_of("mdm1").table(source, array, model, kind, seed)
        case "q-table":
            policy = format_of("mdm1").table(source, format_of("madp.q_table").read(path), model, kind or "q", seed)
        case "sarsop" | "zmdp" | "joint":
            policy = format_of(_BY_FORM[form]).read(path, model)
        case "graph":
            space = None if model is None else model.observation_space
            sizes = {"num_actions": num_actions, "num_observations": None if space is None else len(space)}
            policy = format_of("cassandra.policy_graph").read(path, **sizes)
        case "alpha":
            policy = format_of("cassandra.alpha").read(path, actions=None if model is None else model.action_space)
        case "vectors":
            rows = format_of("madp.q_table").read(path)
            policy = AlphaVectors(rows[:, 1:], rows[:, 0].astype(int), num_actions)
        case "value function":
            policy = format_of("madp.value_function").read(path, num_actions=num_actions)
    return policy
