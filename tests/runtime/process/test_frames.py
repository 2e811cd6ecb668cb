"""Frames: a length, and as many bytes."""

from __future__ import annotations

import numpy as np
import pytest

from mdm.runtime.process.frames import HEADER, frame, unframed


@pytest.mark.parametrize("content", [None, (3, "é", 0.5), np.arange(5.0), b"x" * 100_000])
def test_what_is_framed_is_unframed(content):
    data = frame(content)
    assert int.from_bytes(data[:HEADER], "big") == len(data) - HEADER
    again = unframed(data[HEADER:])
    assert type(again) is type(content)
    assert np.array_equal(again, content) if isinstance(content, np.ndarray) else again == content
