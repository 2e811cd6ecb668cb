"""Output that sub-commands share: JSON, and names from files."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

__all__ = ["as_json", "printable"]


def as_json(value: Any) -> str:
    """Return one line of JSON; arrays become lists."""
    return msgspec.json.encode(value, enc_hook=_encode).decode()


def printable(name: str, room: int = 80) -> str:
    """Return a name from a file for a terminal: unprintable characters are escaped, and a long end is cut off."""
    shown = name if name.isprintable() else repr(name)[1:-1]
    return shown if len(shown) <= room else f"{shown[: room - 1]}…"


def _encode(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a {type(value).__name__} cannot be encoded as JSON")
