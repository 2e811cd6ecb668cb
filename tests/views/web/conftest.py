"""The browser of a file of tests."""

from __future__ import annotations

import browsers
import pytest


@pytest.fixture(autouse=True, scope="module")
def _browser_ends():
    yield
    browsers.SHARED.close()
