"""Whether a text holds a model or a policy, told by how it begins."""

from __future__ import annotations

import re
import zlib
from pathlib import Path

__all__ = ["JOINT", "PLANES", "beginning", "holds_policy", "root"]

PLANES = re.compile(r"^[^#\n]*\bpolicyType\s*=>", re.MULTILINE)
"""What ZMDP's policies alone say."""
JOINT = re.compile(r"^[ \t]*(JointPolicyPureVector\b|Policy for agent \d)", re.MULTILINE)
"""What MADP's joint policies alone say."""
_STATEMENT = re.compile(r"(agents|discount|values|states|actions|observations|start)\b[^\n:]*:")
_NUMBER = re.compile(r"[-+]?\.?\d")
_COMMENTS = re.compile(r"(?:\s+|#[^\n]*)+")
_ROOT = re.compile(r"<(?:\w+:)?(\w+)")
_LENGTH = 1 << 14


def beginning(path: str | Path) -> str:
    """Return how a text begins, unpacked; nothing where it cannot be read, which its reader will tell."""
    try:
        with Path(path).open("rb") as file:
            data = file.read(_LENGTH)
        if data[:2] == b"\x1f\x8b":
            data = zlib.decompressobj(wbits=31).decompress(data, _LENGTH)
    except (OSError, zlib.error):
        return ""
    return data.removeprefix(b"\xef\xbb\xbf").decode("latin-1").lstrip()


def root(text: str) -> str:
    """Return the name of the first element of an XML document, in lower case; nothing where there is none."""
    found = _ROOT.search(text)
    return found[1].lower() if found else ""


def holds_policy(text: str) -> bool | None:
    """Return whether a text is a policy (True) or a model (False); None where its beginning does not tell.

    Lines of numbers are taken for a policy. So begin MADP's ``.base`` files, too, which their name tells.
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
