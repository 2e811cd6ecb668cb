"""Loading and saving models and policies in any format, chosen by content and suffix.

A format is imported where a file has it.
"""

from __future__ import annotations

import importlib
import re
import warnings
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from mdm.errors import FormatError, ModelError, ModelWarning
from mdm.formats.archive import npz, policy as policy_archive
from mdm.formats.source import Source, suffixes
from mdm.formats.target import check_place
from mdm.models import MDP
from mdm.models.validation import collect_problems
from mdm.policies import (
    PACKABLE,
    AlphaVectors,
    DeterministicPolicy,
    FiniteStateController,
    JointController,
    MaskedAlphaVectors,
    MixedAlphaVectors,
    QTable,
    StatePolicy,
    StochasticPolicy,
    mismatch,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.models import POMDP
    from mdm.policies import Policy

PLANES = re.compile(r"^[^#\n]*\bpolicyType\s*=>", re.MULTILINE)
"""Occurs in ZMDP's policies only."""
JOINT = re.compile(r"^[ \t]*(JointPolicyPureVector\b|Policy for agent \d)", re.MULTILINE)
"""Occurs in MADP's joint policies only."""
SETS = frozenset({".base", ".toi-dpomdp"})
"""Suffixes by which a set of files is read, that are a model together."""
PARTS = frozenset({".rewards", ".interactionstates", ".interactionreward"})
"""Suffixes of files that belong to a set and are not models alone."""
_MODELS = frozenset({".pomdp", ".mdp", ".dpomdp", ".pgmx", ".pomdpx", *SETS, *PARTS})
_POLICIES = frozenset({".vf", ".policy", ".policyx", ".alpha", ".pg"})
_OTHERS = {
    "a model of SPUDD or Symbolic Perseus": re.compile(r"\(\s*variables\b"),
    "a model in PPDDL": re.compile(r"\(\s*define\b"),
    "a model in RDDL": re.compile(r"(domain|non-fluents|instance)\s+\w+\s*\{"),
    "a model of PRISM": re.compile(r"(p?o?mdp|dtmc|ctmc)\s+(\w[^:]*\s)?(module|const|formula|observables|global)\b"),
    "JSON": re.compile(r"\{"),
    "a map of ROS": re.compile(r"image\s*:"),
}
"""Other content that a text's beginning tells, after comments."""
_SECTION = re.compile(r"^\s*(agents|discount|states|actions|observations)\b\s*:", re.MULTILINE)
_STATEMENT = re.compile(r"(agents|discount|values|states|actions|observations|start)\b[^\n:]*:")
_NUMBER = re.compile(r"[-+]?\.?\d")
_COMMENTS = re.compile(r"(?:\s+|#[^\n]*)+")
_ROOT = re.compile(r"<(?:\w+:)?(\w+)")
_LENGTH = 1 << 14


def format_of(name: str) -> Any:
    """Return the module of a format, such as ``cassandra.model``. Programs that read one format load no others."""
    return importlib.import_module(f"mdm.formats.{name}")


def beginning(path: str | Path) -> str:
    """Return the first characters of a text, decompressed; empty if unreadable, an error left to the reader."""
    if not Path(path).is_file():  # a pipe would be waited on
        return ""
    try:
        with Path(path).open("rb") as file:
            data = file.read(_LENGTH)
        if data[:2] == b"\x1f\x8b":
            data = zlib.decompressobj(wbits=31).decompress(data, _LENGTH)
    except (OSError, zlib.error):
        return ""
    return data.removeprefix(b"\xef\xbb\xbf").decode("latin-1").lstrip()


def root(text: str) -> str:
    """Return the tag of an XML document's first element, in lower case; empty if there is none."""
    found = _ROOT.search(text)
    return found[1].lower() if found else ""


def holds_policy(text: str) -> bool | None:
    """Return True for a policy, False for a model, None if the beginning does not decide.

    Lines of numbers count as a policy. MADP's ``.base`` files begin with numbers too; callers recognise these by name.
    """
    if text.startswith("["):
        return True
    if text.startswith("<"):
        return {"policy": True, "pomdpx": False, "probmodelxml": False}.get(root(text))
    if PLANES.search(text) or JOINT.search(text):
        return True
    comments = _COMMENTS.match(text)
    text = text[comments.end() :] if comments else text
    if _NUMBER.match(text):
        return True
    return False if _STATEMENT.match(text) else None


def is_policy(path: str | Path) -> bool:
    """Return whether a text holds a policy, as all who read a model or a policy tell it; else it holds a model.

    Content counts more than the suffix. A file that cannot be read is left to the reader that the suffix names.

    Raises:
        FormatError: If it is neither.
    """
    suffix, text = suffixes(path), beginning(path)
    known = False if suffix in SETS else holds_policy(text)
    if known is not None:
        return known
    comments = _COMMENTS.match(text)
    start = text[comments.end() :] if comments else text
    readers = "models and policies are read in the formats that docs/formats.md lists"
    for what, begins in _OTHERS.items():
        if begins.match(start):
            raise FormatError(f"this is {what}, which is not read: {readers}", file=Path(path))
    if suffix in _MODELS | _POLICIES or not start or start.startswith("<") or "\0" in start:
        return suffix in _POLICIES
    if not _SECTION.search(text):
        shown = start.partition("\n")[0][:40]
        raise FormatError(
            f"this is no model and no policy of a known form, it begins with {shown!r}: {readers}", file=Path(path)
        )
    return False


# -- Models ------------------------------------------------------------------------------------------------------------

_AGENTS = re.compile(r"^[ \t]*agents[ \t]*:", re.MULTILINE)
_SETS = "madp.toi"
_MODEL_READERS = {
    ".pomdp": "cassandra.model",
    ".mdp": "cassandra.model",
    ".dpomdp": "madp.dpomdp",
    ".pgmx": "openmarkov",
    ".pomdpx": "sarsop.model",
    ".npz": "archive.model",
    **dict.fromkeys(SETS, _SETS),
}
"""The module of each suffix's format, which reads files."""
_MODEL_SUFFIXES = tuple(suffix for suffix in _MODEL_READERS if suffix not in SETS)
"""Suffixes of files that are written."""
MODEL_SUFFIXES = frozenset(_MODEL_READERS)
"""Suffixes of model files; a ``.npz`` may also hold a policy."""
_BY_ROOT = {"probmodelxml": "openmarkov", "pomdpx": "sarsop.model"}


class _Reader(Protocol):
    def __call__(self, path: str | Path, *, sparse: bool | None = None) -> MDP | POMDP: ...


def load_model(path: str | Path, *, sparse: bool | None = None, normalize: bool = False) -> MDP | POMDP:
    """Read a model in any format.

    The formats are Cassandra's ``.pomdp`` and ``.mdp``; MADP's ``.dpomdp``, and its ``.toi-dpomdp`` sets by their
    ``.base`` file; ProbModelXML (``.pgmx``); ``.pomdpx``; and mdm's own ``.npz``. Text files may be gzipped.

    Example::

        model = mdm.load_model("tiger.pomdp")
        model.transition("listen", "tiger-left")  # [1, 0]

    Args:
        path: The file.
        sparse: Force CSR (True) or dense (False) matrices; None chooses by size and density.
        normalize: Normalise rows of probabilities whatever their sum, with one warning that counts them. Without it,
            only rows within 1e-4 of 1 are normalised, and others are an error.

    Raises:
        FormatError: If the file cannot be read or is malformed, with the place and the expected form.
    """
    reader: _Reader = format_of(_model_form(Path(path))).read
    if not normalize:
        return reader(path, sparse=sparse)
    with collect_problems(sums_only=True) as problems:
        model = reader(path, sparse=sparse)
        model.flatten()  # while problems are still collected
    if problems:
        text = f"{path}: {len(problems)} distributions did not sum to 1 and were normalised; first: {problems[0].text}"
        warnings.warn(text, ModelWarning, stacklevel=2)
    return model


def save_model(model: MDP | POMDP, path: str | Path) -> None:
    """Write a model in the format of the file's suffix; a further ``.gz`` compresses a text format.

    Example::

        mdm.save_model(model, "tiger.pomdpx")

    Args:
        model: The model. ``.pgmx`` and ``.pomdpx`` keep its factors, ``.dpomdp`` its agents, ``.npz`` everything.
        path: The file.

    Raises:
        ModelError: If it is no model, the suffix is unknown, or the format cannot hold this model.
        FormatError: If the file cannot be written.
    """
    if not isinstance(model, MDP):
        raise ModelError(f"a model is an MDP or a POMDP, not {type(model).__name__}: save_policy() writes policies")
    suffix = suffixes(path)
    if suffix not in _MODEL_SUFFIXES or (suffix == ".npz" and Path(path).suffix == ".gz"):
        raise ModelError(f"{Path(path).name!r} has no suffix of a model format: {', '.join(_MODEL_SUFFIXES)}")
    if model.false_negative is not None and suffix != ".npz":
        raise ModelError(
            f"{suffix} files cannot mark an observation as a false negative: write a .npz, or "
            f"model.with_false_negatives(None)"
        )
    if model.available is not None and suffix != ".npz":
        raise ModelError(f"{suffix} files cannot say which actions are available in which states: write a .npz")
    if model.discount_of == "second" and suffix != ".npz":
        text = f"{suffix} files cannot say that a discount is of a second: it is read as of a step; .npz keeps it"
        warnings.warn(text, ModelWarning, stacklevel=2)
    write: Callable[[MDP, str | Path], None] = format_of(_MODEL_READERS[suffix]).write
    write(model, path)


def _model_form(path: Path) -> str:
    """Return the module of a file's format, chosen by unmistakable content, else by suffix."""
    suffix = suffixes(path)
    if suffix in PARTS:
        raise FormatError("this file is part of a set: read the set by its .base file", file=path)
    if suffix == ".toml":
        raise FormatError("this is a TOML file of ensembles; a model was expected", file=path)
    by_suffix = _MODEL_READERS.get(suffix)
    if npz.is_archive(path):
        return "archive.model"
    if is_policy(path):
        raise FormatError("the file holds a policy; a model was expected", file=path)
    if beginning(path).startswith("<"):
        return _BY_ROOT.get(root(Source(path).text), by_suffix or "openmarkov")
    if by_suffix is not None:
        return by_suffix
    return "madp.dpomdp" if _AGENTS.search(Source(path).text) else "cassandra.model"


# -- Policies ----------------------------------------------------------------------------------------------------------

_Form: TypeAlias = Literal["array", "sarsop", "zmdp", "joint", "graph", "alpha", "value function", "vectors", "q-table"]
PolicyKind: TypeAlias = Literal["table", "stochastic", "q"]
_TABLES: dict[str, type] = {"table": DeterministicPolicy, "stochastic": StochasticPolicy, "q": QTable}
_POLICY_FORMS: dict[str, _Form] = {".pg": "graph", ".alpha": "alpha", ".vf": "value function"}
_BY_FORM = {
    "sarsop": "sarsop.policy",
    "zmdp": "zmdp",
    "joint": "madp.joint_policy",
}
"""The modules that read these forms."""

_ARCHIVE, _JOINT = "archive.policy", "madp.joint_policy"
_TABLE = {".policy": "mdm1"}
_VECTORS = {".policy": "sarsop.policy", ".policyx": "sarsop.policy"}
_POLICY_WRITERS: dict[type, dict[str, str]] = {
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
        return _named(policy, model)
    source = Source(path)
    if suffixes(path) == ".toml":
        source.fail("this is a TOML file of ensembles; a policy was expected")
    if kind is None and not is_policy(path):
        source.fail("the file holds a model; a policy was expected")
    form = _policy_form(source, kind)
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
    return _named(policy, model)


def _named(policy: Policy, model: MDP | None) -> Policy:
    """Return a policy that knows the names of its model's states."""
    if isinstance(policy, StatePolicy) and model is not None:
        policy.state_space = model.state_space
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
    if hasattr(policy, "wanted") and getattr(policy, "kind", None) not in PACKABLE:
        raise ModelError(
            f"a {type(policy).__name__} is not saved in files: save its original, and let the ensemble's key shield "
            f"make it again, shield = {{ avoid = {getattr(policy, 'avoid', '')!r} }}"
        )
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
    for other, more in _POLICY_WRITERS.items():
        if issubclass(kind, other):
            forms |= more
    form = forms.get(path.suffix.lower() or ".policy")
    if form is None:
        raise ModelError(f"{kind.__name__} cannot be written as {path.name!r}: its files end in {', '.join(forms)}")
    return form


def _policy_form(source: Source, kind: PolicyKind | None) -> _Form:
    """Return a text's form, found from its beginning, else a distinctive word, else the suffix, else its layout."""
    text = source.text.lstrip()
    if text[0] in "[<":
        return "array" if text[0] == "[" else "sarsop"
    if PLANES.search(text):
        return "zmdp"
    if JOINT.search(text):
        return "joint"
    by_suffix = _POLICY_FORMS.get(suffixes(source.path))
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
