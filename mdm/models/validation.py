"""Collecting what is wrong with a model, to tell it all at once, where otherwise the first problem is refused."""

from __future__ import annotations

from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["Problem", "collecting", "forgive", "forgiving"]


class Problem(NamedTuple):
    """Something wrong with a model.

    Attributes:
        text: What, in a sentence.
        is_sum: Whether it is that a distribution does not sum to 1, though to more than 0: it can be normalised.
    """

    text: str
    is_sum: bool


class _Collection(NamedTuple):
    problems: list[Problem]
    sums_only: bool


_COLLECTION: ContextVar[_Collection | None] = ContextVar("collection", default=None)


@contextmanager
def collecting(*, sums_only: bool = False) -> Iterator[list[Problem]]:
    """Collect problems, and put right what can be, while a model is read or made.

    Args:
        sums_only: Whether only rows that do not sum to 1 are forgiven, and normalised.

    Yields:
        The problems, which grow.
    """
    collection = _Collection([], sums_only)
    token = _COLLECTION.set(collection)
    try:
        yield collection.problems
    finally:
        _COLLECTION.reset(token)


def forgive(problem: str, *, is_sum: bool = False) -> bool:
    """Collect a problem; return whether it was, so that whoever found it goes on instead of raising an error."""
    collection = _COLLECTION.get()
    if collection is None or (collection.sums_only and not is_sum):
        return False
    collection.problems.append(Problem(problem, is_sum))
    return True


def forgiving() -> bool:
    """Whether problems are collected."""
    return _COLLECTION.get() is not None
