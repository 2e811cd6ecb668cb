"""A guard around what only watches a run, the record, the page and the log: nothing that it raises reaches a turn."""

from __future__ import annotations

from inspect import CO_VARKEYWORDS
from threading import get_ident
from typing import TYPE_CHECKING, Any

from mdm.messages import Fault
from mdm.runtime.supervision import describe

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.runtime.runtime import Runtime
    from mdm.runtime.tape import Tape

__all__ = ["Guard"]

_ANSWERS: dict[str, int | slice] = {"kept": slice(1, 3), "counts_from": 2, "latency": 3}
"""Which of its arguments a note of a tape returns where nothing is known better."""


class Guard:
    """Counts how often an observer fails, and makes one fault of it, of kind ``observer``.

    Args:
        runtime: The runtime that is observed.
        name: The observer, such as ``the page``.

    Attributes:
        lost: How often it has failed.
    """

    def __init__(self, runtime: Runtime, name: str) -> None:
        self.lost = 0
        self._runtime = runtime
        self._name = name
        self._told = False

    def __call__(self, hear: Callable[..., Any], answer: int | slice | None = None) -> Callable[..., Any]:
        """Return a function of an observer as one that never raises.

        Args:
            hear: The function; its arguments have no names, which would double what a call costs.
            answer: Which of its arguments is returned where it fails; by default None is.
        """

        def guarded(*arguments: Any) -> Any:
            try:
                return hear(*arguments)
            except Exception as error:
                self.lost += 1  # before any call, for which there may be no room
                try:  # noqa: SIM105 - which is a call
                    self.tell(error)
                except Exception:  # noqa: S110 - the next failure is told
                    pass
                return None if answer is None else arguments[answer]

        return guarded

    def lose(self, why: Exception | str) -> None:
        """Count a failure, and tell the first one."""
        self.lost += 1
        self.tell(why)

    def tell(self, why: Exception | str) -> None:
        """Make a fault of the first failure, behind the turn in which it came; from any thread."""
        if self._told:
            return
        dispatcher, self._told = self._runtime.dispatcher, True
        try:
            within = (dispatcher.active or dispatcher.time >= 0) and get_ident() == dispatcher.thread
            if within and dispatcher.loop is not None:
                dispatcher.loop.call_soon(self._publish, why)
            else:
                self._publish(why)
        except BaseException:
            self._told = False
            raise

    def _publish(self, why: Exception | str) -> None:
        runtime, text = self._runtime, why if isinstance(why, str) else describe(why)
        detail = f"{self._name} has failed: {text}; what it lacks by that is counted, and the run goes on"
        runtime.faults.publish(Fault(runtime.now(), "runtime", "observer", detail))

    def tape(self, tape: Tape) -> Any:
        """Return a tape that only watches as one that never raises."""
        return _Tape(tape, self)


class _Tape:
    """A tape of which nothing reaches a turn: each of its notes is guarded when it is first taken."""

    repeats = False

    def __init__(self, tape: Tape, guard: Guard) -> None:
        self._tape, self._guard = tape, guard
        self._asked = guard(tape.goes_on)

    def __getattr__(self, name: str) -> Any:
        note, guard, answer = getattr(self._tape, name), self._guard, _ANSWERS.get(name)
        code = getattr(note, "__code__", None)
        if code is None or code.co_kwonlyargcount or code.co_flags & CO_VARKEYWORDS:
            return lambda *given, **named: guard(lambda *same: note(*same, **named), answer)(*given)
        guarded = guard(note, answer)
        setattr(self, name, guarded)
        return guarded

    async def comes(self, actor: str, step: str) -> None:
        """Let an actor come to a step of its life: who watches holds nobody up."""

    def goes_on(self, ensemble: str, epoch: int, time: int, ask: Callable[[], bool]) -> bool:
        """Ask once whether a running action goes on, whatever becomes of the answer."""
        answer = bool(ask())
        self._asked(ensemble, epoch, time, lambda: answer)
        return answer
