"""The goals of an action's server: each is carried to its end, and none begins beside one that may move the robot.

A goal outlives the action that sent it where its end is not heard. It is then cancelled every five seconds, and when
its server is heard of, until it ends or its server does not know it.
"""

from __future__ import annotations

import asyncio
import math
from typing import TYPE_CHECKING, Any, NamedTuple

from mdm.actors import AbandonedError
from mdm.errors import Error
from mdm.ros2.wire import ABORTED, CANCELED, SUCCEEDED, UNKNOWN
from mdm.runtime.supervision import describe

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from mdm.ros2.wire import Goals, Handle

_AGAIN, _POLL = 5.0, 0.1
_MOMENT = 1.0
"""Seconds for what follows at once: a result its status, the abort of a goal the newer one that replaces it."""
_LOST = 10.0
"""Seconds in which a server that does not know a goal may still be about to answer it."""

_BROKEN, _FORGOTTEN, _REJECTED = -2, -1, 0
_WORDS = {
    _BROKEN: "is out of reach",
    _FORGOTTEN: "does not know the goal, as after a restart",
    _REJECTED: "rejected the goal",
    SUCCEEDED: "reached the goal",
    CANCELED: "cancelled the goal (status 5), as somebody else asked",
    ABORTED: "aborted the goal (status 6)",
}


class End(NamedTuple):
    """How a goal has ended: its status or a code of ours, and its result or an error."""

    status: int
    result: Any = None

    def __str__(self) -> str:
        """Return it in words, with the code and message of the result where it has them."""
        told = [f"{name} {value!r}" for name in ("error_code", "error_msg") if (value := getattr(self.result, name, 0))]
        told += [describe(self.result)] if isinstance(self.result, Exception) else []
        words = _WORDS.get(self.status, f"ended the goal with status {self.status}")
        return f"{words}: {', '.join(told)}" if told else words


class Pursuit:
    """A goal from its sending to its end, at the `Server` that is given.

    Attributes:
        heard, asked: When it was last heard of, and asked to end, in seconds of the loop; None for never.
        secured: How often the safe action had run by then.
        over: Done with its `End`.
    """

    def __init__(self, server: Server, message: Any, hear: Callable[[Any], object], group: object) -> None:
        self._loop = asyncio.get_running_loop()
        self.heard = self._cancelled = self._loop.time()
        self.asked: float | None = None
        self.secured = 0
        self.group = group
        self.over: asyncio.Future[End] = self._loop.create_future()
        self._server, self._hear = server, hear
        self._answered = False
        self._unknown: float | None = None  # when its server first said so
        self._again: asyncio.TimerHandle | None = None
        self._goal = server.goals.send(message, self._feedback, self._status)
        server.open.append(self)
        server.run(self._carry())

    async def ended(self, silence: float | None) -> End | None:
        """Return how it ends; None where nothing is heard for so many seconds, from when it was asked to end."""
        while not self.over.done():
            since = max(self.heard, self.asked or self.heard)
            left = None if silence is None else since + silence - self._loop.time()
            if left is not None and left <= 0:
                return None
            await asyncio.wait([self.over], timeout=left)
        return self.over.result()

    async def release(self, secured: int) -> bool:
        """Have it end, but for its server to end it for a newer goal of the group; return whether that was so."""
        began, pursuits = self._loop.time(), self._server.open
        later = pursuits[pursuits.index(self) + 1 if self in pursuits else 0 :]
        newer = [other.over for other in later if self.group is not None and other.group == self.group]
        try:
            if newer and not self.over.done():
                await asyncio.wait([self.over, *newer], timeout=_MOMENT, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self.ask(secured, began)
        return bool(newer) and self.over.done()

    def ask(self, secured: int, time: float, *, silent: bool = False) -> None:
        """Have it end, as was decided at a time: when the server has answered, or at once where it is silent."""
        if not self.over.done():
            self.asked, self.secured = time, secured
            self._recall(silent)

    async def _carry(self) -> None:
        try:
            accepted = await self._goal.accepted()
            self._answered, self.heard = True, self._loop.time()
            if accepted and self.over.done():  # it was given up
                self.over = self._loop.create_future()
                self._server.open.append(self)
            if self.asked is not None:
                self._recall()
            self._finish(End(*await self._goal.end()) if accepted else End(_REJECTED))
        except Exception as error:  # of the wire: whoever waits is told
            self._finish(End(_BROKEN, error))

    def _feedback(self, message: Any) -> None:
        self._news()
        if self.asked is None:
            self._hear(message)

    def _status(self, status: int) -> None:
        self._news()
        if status in {SUCCEEDED, CANCELED, ABORTED}:  # no result comes of a server that has forgotten it
            self._loop.call_later(_MOMENT, self._finish, End(status))

    def _news(self) -> None:
        self.heard = self._loop.time()
        if self.asked is not None and self.heard - self._cancelled >= _MOMENT:
            self._recall()

    def _recall(self, unanswered: bool = False) -> None:
        """Cancel it, unanswered too or when its server has answered, and every while until its end is heard."""
        if self._again is not None:
            self._again.cancel()
        if not self.over.done():
            self._again = self._loop.call_later(_AGAIN, self._recall, True)
            if self._answered or unanswered:
                self._cancelled = self._loop.time()
                self._server.run(self._cancel())

    async def _cancel(self) -> None:
        try:
            async with asyncio.timeout(_AGAIN):
                code = await self._goal.cancel()
        except TimeoutError:
            return  # it is asked again
        except Exception as error:
            self._server.report("action", f"a goal of {self._server.name} cannot be cancelled: {describe(error)}")
            return
        now = self._loop.time()
        if code != UNKNOWN or self._answered:
            self.heard = now
        if code == UNKNOWN and self._answered:
            self._loop.call_later(_MOMENT, self._finish, End(_FORGOTTEN))
        elif code == UNKNOWN:
            self._unknown = self._unknown or now
            if now - self._unknown >= _LOST:
                self._finish(End(_FORGOTTEN))

    def _finish(self, end: End) -> None:
        if not self.over.done():
            self._server.open.remove(self)
            self.over.set_result(end)


class Server:
    """The server of an action: its name, how goals are sent there, and how a fault of it is told.

    Attributes:
        open: The goals whose end was not heard, in the order in which they were sent.
    """

    def __init__(self, name: str, goals: Goals, report: Callable[[str, str], None]) -> None:
        self.name, self.goals, self.report = name, goals, report
        self.open: list[Pursuit] = []
        self._tasks: set[asyncio.Task[None]] = set()

    def run(self, work: Coroutine[Any, Any, None]) -> None:
        """Run work until `close`."""
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def close(self) -> None:
        """Leave all goals as they are."""
        for task in tuple(self._tasks):
            task.cancel()

    async def pursue(
        self,
        message: Any,
        hear: Callable[[Any], object],
        silence: float | None,
        group: object,
        secured: Callable[[], int],
        *,
        secures: bool = False,
    ) -> None:
        """Have the server pursue a goal to its end; cancelled, return where it has succeeded all the same.

        Args:
            message: The goal's.
            hear: Hears its feedback, on the event loop.
            silence: Seconds without feedback, status or server, after which it has failed; None for never.
            group: Of goals of one group, the server aborts an older one for a newer one.
            secured: Says how often the safe action has run.
            secures: Whether this is the safe action's own, sent also where the end of an older one was not heard.

        Raises:
            Error: If it fails, or an older goal may still move the robot.
            CancelledError: If it was cancelled, and has ended so.
        """
        self._check(group, secured, secures=secures)
        await found(self.goals, self.name, self.report, silence)
        self._check(group, secured, secures=secures)
        pursuit, asked = Pursuit(self, message, hear, group), ""
        try:
            end = await pursuit.ended(silence)
        except asyncio.CancelledError:
            replaced = await pursuit.release(secured())
            end = await pursuit.ended(silence)
            if end is not None and end.status in {CANCELED, _REJECTED, *([ABORTED] if replaced else ())}:
                raise
            asked = " was asked to cancel the goal, and"
        if end is None:
            pursuit.group = None  # no other is sent beside it
            pursuit.ask(secured(), asyncio.get_running_loop().time(), silent=True)
            failure = AbandonedError if asked else Error  # the safe action runs first
            raise failure(f"the server of {self.name}{asked} told nothing for {silence:g} s: it may be held, or gone")
        if end.status != SUCCEEDED:
            raise Error(f"the server of {self.name}{asked} {end}")

    def _check(self, group: object, secured: Callable[[], int], *, secures: bool) -> None:
        lost = 0
        for old in self.open:
            if old.asked is not None and old.heard <= old.asked and (secures or secured() > old.secured):
                lost += 1  # nothing was heard since, and the robot is stopped
                continue
            if group is not None and old.group == group:
                continue
            if old.asked is None:
                raise Error(f"another action's goal at {self.name} is still open: let it end, or give both one group")
            raise Error(
                f"the server of {self.name} may go on with an older goal, whose end was not heard: no new one is sent "
                f"until it is, or the safe action has run"
            )
        if lost > 1 and not secures:
            raise Error(f"the server of {self.name} may go on with two older goals: no third is sent until one ends")


async def ready(handle: Handle, seconds: float | None) -> bool:
    """Wait until somebody is at the other end; return whether that was so within so many seconds."""
    loop = asyncio.get_running_loop()
    end = math.inf if seconds is None else loop.time() + seconds
    while loop.time() < end:
        if handle.ready:
            return True
        await asyncio.sleep(min(_POLL, end - loop.time()))
    return handle.ready


async def found(handle: Handle, name: str, report: Callable[[str, str], None], seconds: float | None = None) -> None:
    """Wait for the server of a service or an action, with a fault where it is not there yet; an `Error` in the end."""
    if not handle.ready:
        report("unmatched", f"the server of {name} is not there: an action waits for it")
        if not await ready(handle, seconds):
            raise Error(f"the server of {name} was not there for {seconds:g} s")
