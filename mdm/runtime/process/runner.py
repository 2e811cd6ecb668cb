"""Running a program of actors from outside asyncio: event loop, virtual time, signals."""

from __future__ import annotations

import asyncio
import contextlib
import inspect
from typing import TYPE_CHECKING, Any, TypeVar, overload

import anyio

from mdm.errors import Error
from mdm.runtime.actor import Actor
from mdm.runtime.process.signals import Signals
from mdm.runtime.runtime import Runtime, end_all
from mdm.runtime.supervision import LEAVING, ActorFailure
from mdm.runtime.time.clock import check_seconds
from mdm.runtime.time.virtual import DeadlockError, VirtualEventLoop
from mdm.runtime.work import hide

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Coroutine

    from mdm.messages import StateChange

T = TypeVar("T")

_PATIENCE = 0.5
_LIMIT = 10.0


@overload
def run(
    program: Callable[[], Awaitable[T]] | Coroutine[Any, Any, T],
    *,
    virtual: bool = ...,
    uvloop: bool = ...,
    debug: bool = ...,
) -> T: ...


@overload
def run(
    program: Actor, *, seconds: float | None = ..., virtual: bool = ..., uvloop: bool = ..., debug: bool = ...
) -> None: ...


def run(
    program: Actor | Callable[[], Awaitable[Any]] | Coroutine[Any, Any, Any],
    *,
    seconds: float | None = None,
    virtual: bool = False,
    uvloop: bool = False,
    debug: bool = False,
) -> Any:
    """Run a robot or an async function to its end, and stop it cleanly on Ctrl-C, SIGTERM and SIGHUP.

    An actor, such as an ensemble or a system, runs in a `Runtime` of its own until it ends or so many seconds have
    passed; in virtual time also until nothing is left to do. A function runs as by ``asyncio.run``. A signal ends
    every open `Runtime`, see there; where there is none, or time is virtual, it cancels the program.

    Args:
        program: An actor, an async function without arguments, or its coroutine.
        seconds: Of an actor: how long it runs, by the event loop's time; None for no end.
        virtual: Run in virtual time.
        uvloop: Run on uvloop (the extra ``mdm[uvloop]``).
        debug: asyncio's debug mode.

    Returns: The function's result.

    Raises:
        Error: If the program is none, or an event loop runs already.
        ActorFailure: If the actor failed.
        KeyboardInterrupt: After Ctrl-C, when all has ended; Python prints it as a traceback where nobody catches it.
        SystemExit: With status 143 after SIGTERM, 129 after SIGHUP; or the one raised by an actor or its work.
        DeadlockError: In virtual time, when nothing is left to do; the function is cancelled first.

    Example:
        >>> mdm.run(mdm.load_system("robot.toml"), seconds=60)
    """
    wrong = _misuse(program, seconds)
    if wrong is not None:
        if inspect.iscoroutine(program):
            program.close()
        raise Error(wrong)
    guard = _Guard(program, seconds)
    signals = Signals(guard.leave, guard.cancel, last=True)
    with asyncio.Runner(loop_factory=_factory(virtual, uvloop), debug=debug or None) as runner:
        signals.open(runner.get_loop())
        try:
            return runner.run(guard.run())
        except asyncio.CancelledError:
            if guard.asked is not None:
                raise guard.asked from None
            raise
        except DeadlockError:
            if guard.task is not None:  # it waits for ever: it ends in order, as after Ctrl-C
                guard.task.cancel()
                with contextlib.suppress(asyncio.CancelledError, DeadlockError):
                    runner.get_loop().run_until_complete(guard.task)
            if isinstance(program, Actor):
                return None
            raise
        finally:
            try:
                _leave(runner.get_loop())
            finally:
                signals.close()


class _Guard:
    """A program under way, which a signal cancels."""

    def __init__(
        self, program: Actor | Callable[[], Awaitable[Any]] | Coroutine[Any, Any, Any], seconds: float | None
    ) -> None:
        self._program = program
        self._seconds = seconds
        self.task: asyncio.Task[Any] | None = None
        self.asked: BaseException | None = None

    async def run(self) -> Any:
        self.task = asyncio.current_task()
        if self.asked is not None:
            raise asyncio.CancelledError
        return await _call(self._program, self._seconds)

    def leave(self, error: BaseException) -> float:
        """End the program, and keep the exception to raise then."""
        self.asked = error
        self.cancel()
        return _LIMIT

    def cancel(self) -> None:
        if self.task is not None:
            self.task.cancel()


def _misuse(program: object, seconds: float | None) -> str | None:
    """Return the reason why an object cannot be run, if there is one."""
    if _loop_runs():
        return "an event loop runs already: await the program there, or enter `async with mdm.Runtime()`"
    if isinstance(program, type):
        return f"a program is an actor itself, not its class: make one, {program.__name__}(...)"
    if not isinstance(program, Actor):
        if not callable(program) and not inspect.iscoroutine(program):
            return f"a program is an ensemble, a system, another actor or an async function, not {program!r}"
        if seconds is not None:
            return "seconds is for an actor: a function ends by itself, or by asyncio.timeout"
    elif seconds is not None:
        check_seconds(seconds, "seconds")
    return None


async def _call(program: Actor | Callable[[], Awaitable[Any]] | Coroutine[Any, Any, Any], seconds: float | None) -> Any:
    """Run the program, a coroutine or an actor, to its end."""
    if isinstance(program, Actor):
        return await _live(program, seconds)
    result = program() if callable(program) else program
    if not inspect.isawaitable(result):
        raise Error(f"{program!r} returned {result!r} in place of a coroutine: define it with `async def`")
    return await result


def _loop_runs() -> bool:
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return False
    return True


async def _live(actor: Actor, seconds: float | None) -> None:
    """Run an actor in a runtime of its own until it has ended, or for some time."""
    async with Runtime() as runtime:

        def look(change: StateChange) -> None:
            if change.actor == actor.path and change.state in {"stopped", "failed"}:
                runtime.shut_down()

        await runtime.start(actor)
        runtime.lives.subscribe(look)
        with anyio.move_on_after(seconds):
            await runtime.wait()
        if actor.life == "failed":
            raise ActorFailure(f"actor {actor.path!r} failed: its faults say why")


def _leave(loop: asyncio.AbstractEventLoop) -> None:
    """End everything that is left, even if something raises meanwhile: first all runtimes, then other tasks."""
    ending = loop.create_task(_end_rest())
    leaving: BaseException | None = None
    while not ending.done():
        try:
            loop.run_until_complete(ending)
        except LEAVING as error:  # of a task that it waits for: the others have yet to end
            leaving = leaving or error
    if leaving is not None:
        raise leaving


async def _end_rest() -> None:
    """Let robots be made safe, within their limits, by tasks that live as before; then cancel these.

    It waits for them no longer than a moment: a task that ignores being cancelled may never end.
    """
    loop = asyncio.get_running_loop()
    others = asyncio.all_tasks() - {asyncio.current_task()}
    await end_all()
    others |= asyncio.all_tasks() - {asyncio.current_task()}
    for task in others:
        task.cancel()
    if others:
        await asyncio.wait(others, timeout=_PATIENCE)
    stubborn = {task for task in others if not task.done()}
    for task in others - stubborn:
        error = task.exception() if task.done() and not task.cancelled() else None
        if error is not None and not isinstance(error, LEAVING):  # the loop itself raises errors that end a program
            loop.call_exception_handler({"message": "a task failed while the program ended", "exception": error})
    for task in stubborn:
        # The runtime has reported it; asyncio's runner would wait for it, and its end complain.
        hide(task)
        task._log_destroy_pending = False  # type: ignore[attr-defined] # noqa: SLF001


def _factory(virtual: bool, uvloop: bool) -> Callable[[], asyncio.AbstractEventLoop] | None:
    if virtual and uvloop:
        raise Error("uvloop keeps real time: choose virtual=True or uvloop=True")
    if virtual:
        return VirtualEventLoop
    if uvloop:
        try:
            import uvloop as package  # noqa: PLC0415 - an optional extra
        except ImportError:
            raise Error("uvloop is not installed: pip install uvloop") from None
        return package.new_event_loop
    return None
