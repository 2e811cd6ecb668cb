"""Frames on a pipe between two processes of one program: a length and as many bytes of pickle."""

from __future__ import annotations

import pickle
from typing import Any

HEADER = 8
"""Bytes of the length."""


def frame(content: Any) -> bytes:
    """Return something as a frame."""
    data = pickle.dumps(content, protocol=5)
    return len(data).to_bytes(HEADER, "big") + data


def unframed(data: bytes) -> Any:
    """Return the content of a frame, without its length; only frames of this program's own processes are read."""
    return pickle.loads(data)  # noqa: S301 - from the process at the other end of our own pipe
