"""Validation of models: the first problem is an error, unless the caller collects them all."""

from __future__ import annotations

from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["Problem", "collecting", "is_collecting", "report"]


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
    """Collect problems instead of raising errors while a model is read or made, and repair what can be repaired.

    Args:
        sums_only: Collect only rows that do not sum to 1, which are normalised; any other problem is an error.

    Yields:
        The problems, which grow.
    """
    collection = _Collection([], sums_only)
    token = _COLLECTION.set(collection)
    try:
        yield collection.problems
    finally:
        _COLLECTION.reset(token)


def report(problem: str, *, is_sum: bool = False) -> bool:
    """Report a problem to the collection. Return whether it was taken: the caller then repairs it, else it raises."""
    collection = _COLLECTION.get()
    if collection is None or (collection.sums_only and not is_sum):
        return False
    collection.problems.append(Problem(problem, is_sum))
    return True


def is_collecting() -> bool:
    """Whether problems are collected."""
    return _COLLECTION.get() is not None
