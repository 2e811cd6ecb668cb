"""Running a program of actors from outside asyncio: event loop, virtual time, signals."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from typing import TYPE_CHECKING, Any, TypeVar

from mdm.errors import Error
from mdm.runtime.virtual import DeadlockError, VirtualEventLoop

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

__all__ = ["run"]

T = TypeVar("T")

_PATIENCE = 0.5


def run(
    main: Callable[[], Coroutine[Any, Any, T]], *, virtual: bool = False, uvloop: bool = False, debug: bool = False
) -> T:
    """Run a coroutine function to its end, as ``asyncio.run`` does, and stop it cleanly on Ctrl-C and SIGTERM.

    Either signal cancels ``main``, so that every ``async with Runtime()`` in it stops its actors in order; a second
    Ctrl-C breaks off at once.

    Args:
        main: The program.
        virtual: Run in virtual time, for a `Runtime` with a `VirtualClock`.
        uvloop: Run on uvloop (the extra ``mdm[uvloop]``).
        debug: asyncio's debug mode.

    Raises:
        KeyboardInterrupt: After Ctrl-C.
        SystemExit: With status 143 after SIGTERM.
        DeadlockError: In virtual time, when nothing is left to do; ``main`` is cancelled first.
    """
    terminated = False

    task: asyncio.Task[Any] | None = None

    async def guarded() -> T:
        nonlocal task
        task = asyncio.current_task()

        def terminate() -> None:
            nonlocal terminated
            terminated = True
            if task is not None:
                task.cancel()

        # Only the main thread may listen to signals; elsewhere the program above us does.
        with contextlib.suppress(NotImplementedError, RuntimeError, ValueError):
            asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, terminate)
        return await main()

    with asyncio.Runner(loop_factory=_factory(virtual, uvloop), debug=debug or None) as runner:
        try:
            return runner.run(guarded())
        except asyncio.CancelledError:
            if terminated:
                raise SystemExit(143) from None
            raise
        except DeadlockError:
            if task is not None:
                _end(task)
            raise
        finally:
            _leave(runner.get_loop())


def _end(task: asyncio.Task[Any]) -> None:
    """Let a program that waits for ever end in order, as after Ctrl-C."""
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError, DeadlockError):
        task.get_loop().run_until_complete(task)


def _leave(loop: asyncio.AbstractEventLoop) -> None:
    """Cancel what is left, and wait for it no longer than a moment: what ignores being cancelled may never end."""
    left = asyncio.all_tasks(loop)
    if not left:
        return
    for task in left:
        task.cancel()
    _, stubborn = loop.run_until_complete(asyncio.wait(left, timeout=_PATIENCE))
    for task in stubborn:
        # The runtime has reported it; asyncio's runner would wait for it, and its end complain.
        asyncio._unregister_task(task)  # noqa: SLF001 - meant for event loops' authors
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
            raise Error("uvloop is not installed: pip install 'markov-decision-making[uvloop]'") from None
        return package.new_event_loop
    return None
