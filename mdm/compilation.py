"""Compilation of kernels by numba (the extra ``mdm[fast]``); without numba they run as plain Python.

numba is slow to import, so a module with kernels is imported only when one of them is chosen. Compiled code is cached
on disk, beside the module or in the user's cache. ``MDM_COMPILE=0`` turns compilation off. To compile the first time
takes many seconds, and so short work is done by the same functions as plain Python (`plain`).

The time that compilation takes is not the work's own, and is reported to those who wait. A function from the cache
takes none. The time goes on while something is compiled, and while the compiler itself is loaded.
"""

from __future__ import annotations

import os
import warnings
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from importlib import import_module
from importlib.util import find_spec, module_from_spec
from time import perf_counter
from typing import TYPE_CHECKING, Any, TypeVar, cast

from mdm.errors import ModelWarning

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import ModuleType

__all__ = [
    "COMPILE_TIME",
    "CompileTime",
    "can_compile",
    "compiled",
    "direct",
    "is_sparing",
    "kernels",
    "may_compile",
    "plain",
    "sparing",
    "working_time",
]

_Function = TypeVar("_Function", bound="Callable[..., Any]")

_COMPILATION, _PASS = "numba:compile", "numba:run_pass"
"""What numba reports: functions that are not in its cache, and the passes over each of them."""

_uncompiled: list[str] = []
"""The modules that are being imported as plain Python."""

_sparing: ContextVar[bool] = ContextVar("sparing", default=False)
"""Whether what is made now is for a process whose memory counts for more than microseconds."""


@contextmanager
def sparing(*, wanted: bool = True) -> Iterator[None]:
    """Have functions with a counterpart in numpy use that, if it is wanted: the compiler takes more than 100 MB."""
    before = _sparing.set(wanted)
    try:
        yield
    finally:
        _sparing.reset(before)


def is_sparing() -> bool:
    """Whether objects made now should use numpy where they can, see `sparing`."""
    return _sparing.get()


@cache
def may_compile() -> bool:
    """Whether numba is installed, and ``MDM_COMPILE`` is not 0; numba is not imported for it."""
    return os.environ.get("MDM_COMPILE", "1") != "0" and find_spec("numba") is not None


def can_compile() -> bool:
    """Whether kernels are compiled: numba can be imported, and ``MDM_COMPILE`` is not 0."""
    return may_compile() and _is_loaded()


@cache
def _is_loaded() -> bool:
    """Load the compiler, and return whether that was possible."""
    try:
        with COMPILE_TIME.loading():
            import numba  # noqa: F401, PLC0415 - see above
    except Exception as error:  # what a broken library, or one that is too old, raises
        text = f"numba is installed, but cannot be imported ({error}): the work goes on uncompiled, and slower"
        warnings.warn(f"{text}; reinstall it, or set MDM_COMPILE=0", ModelWarning, stacklevel=2)
        return False
    _measure()
    return True


@cache
def _measure() -> None:
    """Measure how long the compiler takes from now on."""
    from numba.core.event import Listener, register  # noqa: PLC0415 - see above

    class Stopwatch(Listener):
        def on_start(self, event: Any) -> None:
            if event.kind == _COMPILATION:
                COMPILE_TIME.begin()
            COMPILE_TIME.go_on()

        def on_end(self, event: Any) -> None:
            if event.kind == _COMPILATION:
                COMPILE_TIME.end()

    for kind in (_COMPILATION, _PASS):
        register(kind, Stopwatch())  # type: ignore[no-untyped-call]


@cache
def plain(name: str) -> ModuleType:
    """Return a module of kernels, by its name, with its functions as plain Python.

    It is another module than the one that ``import`` gives, and shares nothing with it.
    """
    spec = find_spec(name)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    _uncompiled.append(name)
    try:
        spec.loader.exec_module(module)
    finally:
        _uncompiled.pop()
    return module


def kernels(name: str) -> ModuleType:
    """Return a module of kernels, by its name: compiled, or as plain Python where nothing is compiled."""
    return import_module(name) if can_compile() else plain(name)


def compiled(function: _Function) -> _Function:
    """Compile a function of numbers and arrays at its first call; without numba, return it unchanged.

    Each type of an argument is compiled by itself, and to numba a number in a caller's code is a type of its own. So
    kernels hand indices to each other as ``int(np.int64(...))``, of one width.
    """
    if function.__module__ in _uncompiled or not can_compile():
        return function
    import numba  # noqa: PLC0415 - see above

    return cast("_Function", numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def direct(function: Callable[..., Any], *arguments: Any) -> Callable[..., Any]:
    """Return a compiled function for arguments of the types of these, compiled now; a plain one unchanged.

    A call does not look at types, which takes half the time of a short one. A call with other types gets
    wrong numbers or worse: so keep it with the arrays that it is for.
    """
    compile_ = getattr(function, "compile", None)
    if compile_ is None:
        return function
    import numba  # noqa: PLC0415 - see above

    typeof: Any = numba.typeof
    entry: Callable[..., Any] = compile_(tuple(map(typeof, arguments)))
    return entry


_LONG = 1.0
"""Seconds of compilation, in all, from which on somebody is told."""


class CompileTime:
    """A stopwatch for the compiler.

    Args:
        clock: Returns seconds.
    """

    def __init__(self, clock: Callable[[], float] = perf_counter) -> None:
        self._clock = clock
        self._depth = 0
        self._began = 0.0
        self._loading = 0.0
        self._compiling = 0.0
        self._tell: Callable[[], object] | None = None

    @property
    def seconds(self) -> float:
        """How long it took so far."""
        return self._loading + self._compiled

    @property
    def _compiled(self) -> float:
        return self._compiling + (self._clock() - self._began if self._depth else 0.0)

    @property
    def is_told(self) -> bool:
        """Whether somebody is told when it takes long."""
        return self._tell is not None

    @contextmanager
    def told(self, tell: Callable[[], object]) -> Iterator[None]:
        """Call a function within, once, when compilation has taken a second."""
        before, self._tell = self._tell, tell
        try:
            yield
        finally:
            self._tell = before

    @contextmanager
    def loading(self) -> Iterator[None]:
        """Count the time within as that of loading the compiler, of which nobody is told."""
        began = self._clock()
        try:
            yield
        finally:
            self._loading += self._clock() - began

    def begin(self) -> None:
        """Something is compiled from now on; functions that it calls may be compiled within."""
        if not self._depth:
            self._began = self._clock()
        self._depth += 1

    def go_on(self) -> None:
        """Tell, if it is time to, that the compilation takes long."""
        if self._tell is not None and self._depth and self._compiled > _LONG:
            tell, self._tell = self._tell, None
            tell()

    def end(self) -> None:
        """The compilation that was begun last has ended."""
        self._depth -= 1
        if not self._depth:
            self._compiling += self._clock() - self._began


COMPILE_TIME = CompileTime()
"""That of this process."""


def working_time() -> float:
    """Return seconds that do not go on while something is compiled."""
    return perf_counter() - COMPILE_TIME.seconds
