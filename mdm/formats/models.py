"""Loading and saving models in any format, chosen by content and suffix."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from mdm.errors import FormatError, ModelError, ModelWarning
from mdm.formats.archive import npz
from mdm.formats.recognition import PARTS, SETS, beginning, format_of, is_policy, root
from mdm.formats.source import Source, suffixes
from mdm.models import MDP
from mdm.models.validation import collect_problems

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.models import POMDP

__all__ = ["MODEL_SUFFIXES", "load_model", "save_model"]

_AGENTS = re.compile(r"^[ \t]*agents[ \t]*:", re.MULTILINE)
_SETS = "madp.toi"
_BY_SUFFIX = {
    ".pomdp": "cassandra.model",
    ".mdp": "cassandra.model",
    ".dpomdp": "madp.dpomdp",
    ".pgmx": "openmarkov.reader",
    ".pomdpx": "sarsop.reader",
    ".npz": "archive.model",
    **dict.fromkeys(SETS, _SETS),
}
"""The module of each suffix's format, which reads files."""
_WRITTEN = tuple(suffix for suffix in _BY_SUFFIX if suffix not in SETS)
"""Suffixes of files that are written."""
MODEL_SUFFIXES = frozenset(_BY_SUFFIX)
"""Suffixes of model files; a ``.npz`` may also hold a policy."""
_BY_ROOT = {"probmodelxml": "openmarkov.reader", "pomdpx": "sarsop.reader"}


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
        FormatError: If the file cannot be read or is malformed, with the place and what was expected.
    """
    reader: _Reader = format_of(_form(Path(path))).read
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
    if suffix not in _WRITTEN or (suffix == ".npz" and Path(path).suffix == ".gz"):
        raise ModelError(f"{Path(path).name!r} has no suffix of a model format: {', '.join(_WRITTEN)}")
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
    write: Callable[[MDP, str | Path], None] = format_of(_BY_SUFFIX[suffix]).write
    write(model, path)


def _form(path: Path) -> str:
    """Return the module of a file's format, chosen by unmistakable content, else by suffix."""
    suffix = suffixes(path)
    if suffix in PARTS:
        raise FormatError("this file is part of a set: read the set by its .base file", file=path)
    if suffix == ".toml":
        raise FormatError("this is a TOML file of ensembles; a model was expected", file=path)
    by_suffix = _BY_SUFFIX.get(suffix)
    if npz.is_archive(path):
        return "archive.model"
    if is_policy(path):
        raise FormatError("the file holds a policy; a model was expected", file=path)
    if beginning(path).startswith("<"):
        return _BY_ROOT.get(root(Source(path).text), by_suffix or "openmarkov.reader")
    if by_suffix is not None:
        return by_suffix
    return "madp.dpomdp" if _AGENTS.search(Source(path).text) else "cassandra.model"
