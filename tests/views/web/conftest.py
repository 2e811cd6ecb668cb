"""The browser of the session."""

from __future__ import annotations

import browsers


def pytest_sessionfinish() -> None:
    """End it: no test waits for it, nor is charged with it."""
    browsers.SHARED.close()
