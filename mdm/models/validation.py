"""Validation of models: the first problem raises an error, unless the caller collects all problems."""

from __future__ import annotations

from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

__all__ = ["Problem", "collect_problems", "is_collecting", "placing", "remark", "report"]


class Problem(NamedTuple):
    """A problem of a model.

    Attributes:
        text: The problem, in a sentence.
        is_sum: Whether a distribution does not sum to 1, but can be normalised.
        is_remark: Whether it is an oddity, which is allowed.
        at: What it is of, by which the reader of a file finds its place; None once it says so.
    """

    text: str
    is_sum: bool
    is_remark: bool = False
    at: Any = None


class _Collection(NamedTuple):
    problems: list[Problem]
    sums_only: bool


_COLLECTION: ContextVar[_Collection | None] = ContextVar("collection", default=None)


@contextmanager
def collect_problems(*, sums_only: bool = False) -> Iterator[list[Problem]]:
    """Collect problems instead of raising errors while a model is read or made; what can be repaired is repaired.

    Args:
        sums_only: Collect only distributions that can be normalised; any other problem raises an error.

    Yields:
        The list of problems found so far.
    """
    collection = _Collection([], sums_only)
    token = _COLLECTION.set(collection)
    try:
        yield collection.problems
    finally:
        _COLLECTION.reset(token)


@contextmanager
def placing(texts: Callable[[Sequence[Problem]], Sequence[str]]) -> Iterator[None]:
    """Give the problems that are collected in the block their places in the file that is read.

    Args:
        texts: Returns the texts of problems with their places.
    """
    collection = _COLLECTION.get()
    before = 0 if collection is None else len(collection.problems)
    try:
        yield
    finally:
        if collection is not None:
            found = [place for place, problem in enumerate(collection.problems) if place >= before and problem.at]
            for place, text in zip(found, texts([collection.problems[place] for place in found]), strict=True):
                collection.problems[place] = collection.problems[place]._replace(text=text, at=None)


def report(problem: str, *, is_sum: bool = False, at: Any = None) -> bool:
    """Report a problem. Return whether it was collected: the caller then repairs it, else raises an error."""
    collection = _COLLECTION.get()
    if collection is None or (collection.sums_only and not is_sum):
        return False
    collection.problems.append(Problem(problem, is_sum, at=at))
    return True


def remark(oddity: str) -> None:
    """Note an oddity that is allowed, where all problems are collected; nothing is to be repaired."""
    collection = _COLLECTION.get()
    if collection is not None and not collection.sums_only:
        collection.problems.append(Problem(oddity, is_sum=False, is_remark=True))


def is_collecting() -> bool:
    """Whether problems are being collected."""
    return _COLLECTION.get() is not None
