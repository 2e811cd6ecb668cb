"""Handlers: plain functions, called in turns that never await."""

from __future__ import annotations

import inspect
from contextlib import asynccontextmanager, contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

from mdm.errors import Error

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterator

_KINDS = {
    inspect.CO_COROUTINE: "an async function",
    inspect.CO_ITERABLE_COROUTINE: "an async function",
    inspect.CO_ASYNC_GENERATOR: "an async generator function",
    inspect.CO_GENERATOR: "a generator function",
}
_ANY = sum(_KINDS)


def _yield() -> Iterator[None]:
    yield


async def _yield_later() -> AsyncIterator[None]:
    yield


_HOLD, _HOLD_LATER = contextmanager(_yield), asynccontextmanager(_yield_later)
_CONTEXT_MANAGERS = (type(_HOLD()), type(_HOLD_LATER()))
# All functions that one of these decorators has made share their code.
_CONTEXTS = {_HOLD.__code__: "a @contextmanager function", _HOLD_LATER.__code__: "an @asynccontextmanager function"}


def kind_of(function: Callable[..., Any]) -> str | None:
    """Return the kind of a callable whose call runs none of its code, or None for a plain function.

    Methods, partial functions and objects with ``__call__`` are looked through.
    """
    while isinstance(function, partial):
        function = function.func
    code = getattr(function, "__code__", None) or getattr(type(function).__call__, "__code__", None)
    if code is None or code in _CONTEXTS:
        return None if code is None else _CONTEXTS[code]
    if not code.co_flags & _ANY:
        return None
    return next(kind for flag, kind in _KINDS.items() if code.co_flags & flag)


def has_not_run(result: object) -> bool:
    """Whether a call has returned the function's own code, of which nothing has run, and which is not to be awaited."""
    return inspect.isgenerator(result) or inspect.isasyncgen(result) or isinstance(result, _CONTEXT_MANAGERS)


def check_plain(function: Any, use: str) -> None:
    """Refuse an object that is no plain function.

    Args:
        function: The object.
        use: Its purpose, such as ``the handler of channel 'state'``.

    Raises:
        Error: If calling it would run none of its code.
    """
    if not callable(function):
        raise Error(f"{use} is a function, not {function!r}")
    kind = kind_of(function)
    if kind is not None:
        name = getattr(function, "__qualname__", repr(function))
        raise Error(
            f"{use} must be a plain function, but {name} is {kind}, and a call would run none of it: let a plain "
            f"function hand what takes time to Actor.spawn"
        )
