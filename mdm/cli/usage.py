"""Wrong usage, found only after the arguments were parsed."""

from __future__ import annotations

import argparse

from mdm.errors import Error

__all__ = ["UsageError", "count"]


class UsageError(Error):
    """The arguments do not go together; the command shows its usage and exits with 2."""


def count(text: str) -> int:
    """Return an argument as a whole number of 1 or more."""
    try:
        number = int(text)
    except ValueError:
        number = 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"a whole number of 1 or more was expected, not {text!r}")
    return number
