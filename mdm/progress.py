"""How far long work has come, from where it is done to those who wait for it.

Reading a large file and drafting a large map report the share that is done; nobody hears it unless somebody follows,
as the command does on a terminal. What is known of the work, and when it is worth a line, is for them to say. Solvers
and simulations, which can also be interrupted, have arguments of their own instead.
"""

from __future__ import annotations

from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = ["followed", "report_share"]

_follower: ContextVar[Callable[[str, float], object] | None] = ContextVar("follower", default=None)


@contextmanager
def followed(tell: Callable[[str, float], object]) -> Iterator[None]:
    """Have work that is done within, in this thread or task, reported.

    Args:
        tell: Called with the work, such as ``reading tiger.pomdp``, and the share of it that is done: 0 where it begins
            and 1 where it ends, which it does not reach where it fails.
    """
    before = _follower.set(tell)
    try:
        yield
    finally:
        _follower.reset(before)


def report_share(work: str, share: float) -> None:
    """Report the share of a piece of work that is done, from 0 to 1, to the follower, if there is one."""
    tell = _follower.get()
    if tell is not None:
        tell(work, share)
