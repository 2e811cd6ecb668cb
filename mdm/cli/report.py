"""JSON as all sub-commands print it."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

__all__ = ["as_json"]


def as_json(value: Any) -> str:
    """Return one line of JSON; arrays become lists."""
    return msgspec.json.encode(value, enc_hook=_encode).decode()


def _encode(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a {type(value).__name__} cannot be encoded as JSON")
