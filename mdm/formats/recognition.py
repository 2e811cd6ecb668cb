"""Recognition of models and policies by the beginning of a file; a format is imported where a file has it."""

from __future__ import annotations

import importlib
import re
import zlib
from pathlib import Path
from typing import Any

__all__ = ["JOINT", "PARTS", "PLANES", "SETS", "beginning", "format_of", "holds_policy", "root"]

PLANES = re.compile(r"^[^#\n]*\bpolicyType\s*=>", re.MULTILINE)
"""Occurs in ZMDP's policies only."""
JOINT = re.compile(r"^[ \t]*(JointPolicyPureVector\b|Policy for agent \d)", re.MULTILINE)
"""Occurs in MADP's joint policies only."""
SETS = frozenset({".base", ".toi-dpomdp"})
"""Suffixes by which a set of files is read, that are a model together."""
PARTS = frozenset({".rewards", ".interactionstates", ".interactionreward"})
"""Suffixes of files that belong to a set and are not models alone."""
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
