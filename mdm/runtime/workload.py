"""The workload of an actor: what it has at work, how that ends with it, and what is done where it does not."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any

from mdm.errors import Error
from mdm.runtime.channel import Subscription
from mdm.runtime.handler import check_plain
from mdm.runtime.supervision import LEAVING, ActorFailure
from mdm.runtime.work import Work, wait_all

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from mdm.runtime.actor import Actor
    from mdm.runtime.executors import Jobs

__all__ = ["Workload"]


class Workload:
    """The work of one actor, whose ends are turns of it.

    Args:
        actor: Whose.

    Attributes:
        open: Whether more may begin.
    """

    __slots__ = ("_actor", "_work", "open")

    def __init__(self, actor: Actor) -> None:
        self._actor = actor
        self._work: dict[Work, None] = {}
        self.open = False

    def __len__(self) -> int:
        return len(self._work)

    def begin(
        self, awaitable: Awaitable[Any], ended: Callable[[Work], object] | None, name: str, jobs: Jobs | None
    ) -> Work:
        """Run a coroutine as a task; see `Actor.spawn`."""
        actor = self._actor
        try:
            if not self.open:
                raise Error(f"actor {actor.path!r} does not run, so it cannot begin work {name!r}")
            if not inspect.isawaitable(awaitable):
                raise Error(f"work is an awaitable, such as what an async function returns, not {awaitable!r}")
            if ended is not None:
                check_plain(ended, f"what is called at the end of work {name!r}")
        except Error:
            if inspect.iscoroutine(awaitable):
                awaitable.close()
            raise
        turn = Subscription(None, actor, ended if ended is not None else _judge)
        runtime = actor.runtime
        dispatcher = runtime.dispatcher

        def done(work: Work) -> None:
            self._work.pop(work, None)
            if not work.abandoned:
                dispatcher.deliver(turn, work)
            else:  # a list of its own: whoever goes through the old one, awaiting each, misses none
                runtime.abandoned = [other for other in runtime.abandoned if other is not work]
            if isinstance(work.error, LEAVING):
                runtime.abort(work.error)

        work = Work(awaitable, f"mdm:{actor.path}/{name or 'work'}", done, jobs)
        self._work[work] = None
        return work

    def abandon(self, work: Work) -> None:
        """Own a piece of it no longer."""
        work.abandon()
        self._work.pop(work, None)
        if not work.done:
            self._actor.runtime.abandoned.append(work)

    async def end(self, grace: float) -> None:
        """Cancel all of it, wait for so many seconds, and abandon what has not ended; when cancelled, at once."""
        clock = self._actor.runtime.clock
        began = clock.now()
        asked: set[Work] = set()
        try:
            while self._work:
                for work in self._work:  # the end of one may have begun another
                    if work not in asked:
                        asked.add(work)
                        work.cancel()
                remaining = grace - (clock.now() - began) / 1e9
                if remaining <= 0:
                    break
                await wait_all(self._work, remaining)
        finally:
            waited = (clock.now() - began) / 1e9
            for work in tuple(self._work):
                self.abandon(work)
                self._actor.report("abandoned", f"{work.name} did not end within {waited:.3g} s of being cancelled")


def _judge(work: Work) -> None:
    if work.error is not None:
        raise work.error
    if work.cancelled and not work.interrupted:
        raise ActorFailure(f"work {work.name!r} was cancelled, but not by its actor")
