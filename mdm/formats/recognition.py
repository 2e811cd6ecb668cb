"""Recognition of models and policies by the beginning of a file; a format is imported where a file has it."""

from __future__ import annotations

import importlib
import re
import zlib
from pathlib import Path
from typing import Any

from mdm.errors import FormatError
from mdm.formats.source import suffixes

__all__ = ["JOINT", "PARTS", "PLANES", "SETS", "beginning", "format_of", "holds_policy", "is_policy", "root"]

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

    Content counts more than the suffix. What cannot be read is left to the reader that the suffix names.

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
