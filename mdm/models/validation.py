"""Validation of models: the first problem raises an error, unless the caller collects all problems."""

from __future__ import annotations

from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

from mdm.errors import FormatError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_PLACED = 12


class Problem(NamedTuple):
    """A problem of a model.

    Attributes:
        text: The problem, in a sentence.
        is_sum: Whether a distribution does not sum to 1, but can be normalised.
        is_remark: Whether it is an oddity, which is allowed.
        at: Its subject, by which the reader of a file finds its place; None once it says so.
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
    """Collect problems instead of raising errors while a model is read or made; repairing where possible.

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
def placing(fail: Callable[[Any, str], NoReturn]) -> Iterator[None]:
    """Give the first few problems that are collected in the block their places in the file that is read.

    Args:
        fail: Raises an error with the place of a problem's subject, and its text.
    """
    collection = _COLLECTION.get()
    problems = [] if collection is None else collection.problems
    before = len(problems)
    try:
        yield
    finally:
        placed = [place for place, problem in enumerate(problems) if place >= before and problem.at is not None]
        for place in placed[:_PLACED]:
            try:
                fail(problems[place].at, problems[place].text)
            except FormatError as error:
                problems[place] = problems[place]._replace(text=str(error), at=None)


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
