"""Frames on a pipe between two processes of one program: a length and as many bytes of pickle."""

from __future__ import annotations

import pickle
from typing import Any

__all__ = ["HEADER", "frame", "unframed"]


HEADER = 8
"""Bytes of the length."""


def frame(content: Any) -> bytes:
    """Return something as a frame."""
    data = pickle.dumps(content, protocol=5)
    return len(data).to_bytes(HEADER, "big") + data


def unframed(data: bytes) -> Any:
    """Return what a frame holds, without its length; only what a process of our own wrote is read."""
    return pickle.loads(data)  # noqa: S301 - from the process at the other end of our own pipe
