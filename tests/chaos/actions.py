"""Actions of every kind: plain, async, stubborn, deaf, shielded, failing, meddling, in threads, as futures."""

from __future__ import annotations

import asyncio
from contextlib import suppress

import anyio
from chaos.journal import Panic

KINDS = (
    *("plain", "quick", "long", "long", "stubborn", "stubborn", "deaf", "failing", "spiteful", "pooled", "pooled"),
    *("future", "handed", "shielded", "scoped"),
)
"""Kinds of actions."""

SAFE_KINDS = ("plain", "quick", "braking", "braking", "failing", "failing", "pooled", "future", "handed")
"""Kinds of safe actions."""

HEEDING = ("long", "stubborn", "spiteful", "shielded", "scoped")
"""Kinds that end soon when they are cancelled."""

WHOLE = ("quick", "long", "stubborn", "deaf", "spiteful", "shielded", "scoped")
"""Kinds of which nothing goes on elsewhere when their coroutine has ended."""

ASYNC = ("quick", "long", "stubborn", "deaf", "spiteful", "pooled", "shielded", "scoped")
"""Kinds that run as tasks, and so may be of a group."""


class Actions:
    """Makes the functions.

    Args:
        random: Draws what they do.
        journal: Is told of it.
        pool: Takes what runs in threads.
    """

    def __init__(self, random, journal, pool):
        self._random, self._journal, self._pool = random, journal, pool

    def make(self, kind, robot, action, *, safe=False, both=False):
        """Return a function.

        Args:
            kind: One of `KINDS`.
            robot: Whose.
            action: Its name.
            safe: Whether it is the safe action.
            both: Whether it may be that and another one: the message says which.
        """
        function = getattr(self, f"_{kind}")

        def enter(safe):
            run = self._journal.enter(robot, action, safe=safe)
            self._journal.meddle(robot)
            return run

        if both:
            return lambda message: function(lambda: enter(message.epoch < 0), safe=True)
        if kind not in ASYNC and kind != "braking":
            return lambda: function(lambda: enter(safe), safe=safe)

        async def run():
            await function(lambda: enter(safe), safe=safe)

        return run

    def _plain(self, enter, *, safe):
        self._journal.leave(enter())

    def _failing(self, enter, *, safe):
        run = enter()
        try:
            if self._random.random() < 0.5:
                self._journal.throw([ValueError] if safe else (ValueError, asyncio.CancelledError, Panic, SystemExit))
        finally:
            self._journal.leave(run)

    async def _sleep(self, enter, seconds, rest, *, spiteful=False):
        run = enter()
        try:
            await asyncio.sleep(seconds)
            self._journal.meddle(run.robot)
        except asyncio.CancelledError:
            superseded = self._journal.is_superseded(run)
            self._journal.meddle(run.robot)
            await linger(rest)
            if spiteful:
                self._journal.throw([ValueError, Panic, SystemExit], superseded=superseded)
            raise
        finally:
            self._journal.leave(run)

    def _quick(self, enter, *, safe):
        return self._sleep(enter, 0.3, 0.0)

    def _braking(self, enter, *, safe):
        """Take longer than most pauses, and now and then longer than a safe action may."""
        return self._sleep(enter, self._random.choice([0.8, 2.5]), 0.0)

    def _long(self, enter, *, safe):
        return self._sleep(enter, 50.0, 0.0)

    def _stubborn(self, enter, *, safe):
        return self._sleep(enter, 50.0, 0.4)

    def _spiteful(self, enter, *, safe):
        return self._sleep(enter, 50.0, 0.2, spiteful=True)

    def _deaf(self, enter, *, safe):
        return self._sleep(enter, 50.0, 10.0)

    async def _shielded(self, enter, *, safe):
        """Wait behind a shield for a task of its own, which is ended at leisure."""
        run = enter()
        inner = asyncio.ensure_future(asyncio.sleep(50.0))
        try:
            await asyncio.shield(inner)
        except asyncio.CancelledError:
            await linger(0.2)
            inner.cancel()
            raise
        finally:
            self._journal.leave(run)

    async def _scoped(self, enter, *, safe):
        """Clean up within a scope that is shielded, and say that all is done."""
        run = enter()
        try:
            with suppress(asyncio.CancelledError):
                await asyncio.sleep(50.0)
        finally:
            with anyio.CancelScope(shield=True):
                await linger(0.3)
            self._journal.leave(run)

    def _handed(self, enter, *, safe):
        """Return the future of a thread, which goes on where that is cancelled."""
        loop, run = asyncio.get_running_loop(), enter()

        def work():
            job.wait()
            self._journal.leave(run)

        def step(rounds):
            if answer.done():
                loop.call_later(rest, job.release)
            elif rounds:
                loop.call_soon(step, rounds - 1)
            else:
                job.release()

        answer = self._hand_in(run, work)
        job, rest = self._pool.last, self._random.choice([0.1, 0.4, 5.0])
        job.begin()
        step(self._random.randint(0, 20))  # virtual time stands still meanwhile
        return answer

    def _hand_in(self, run, work):
        """Hand work to a thread, which may not be had: the work is queued all the same, and must not be done."""
        draw, loop = self._random, asyncio.get_running_loop()
        refused = draw.random() < 0.15

        def begin():
            if refused:
                self._journal.wrong.append(f"what no thread was had for in {run.action} of {run.robot} begins")
            else:
                work()

        if refused:
            self._pool.refusal = self._journal.text()
        try:
            return loop.run_in_executor(draw.choice([None, self._pool]), begin)
        except RuntimeError:
            loop.call_later(0.2, self._pool.last.release)  # by then there is a thread
            self._journal.leave(run)
            raise

    def _future(self, enter, *, safe):
        """Return a future, which somebody else ends."""
        loop, run = asyncio.get_running_loop(), enter()
        future = loop.create_future()
        future.add_done_callback(lambda _: self._journal.leave(run))
        loop.call_later(self._random.choice([0.3, 5.0]), lambda: future.done() or future.set_result(None))
        return future

    async def _pooled(self, enter, *, safe):
        """Wait for a thread, which goes on where the action is cancelled."""
        draw, loop, run = self._random, asyncio.get_running_loop(), enter()
        fails, begins, rest = draw.random() < 0.1, draw.random() < 0.7, draw.choice([0.1, 0.4, 10.0])
        heeded, shielded = False, draw.random() < 0.2
        fails = fails and not shielded  # else nobody hears of it

        def work():
            if begins:
                job.wait()
            self._journal.leave(run)
            if fails and heeded:
                self._journal.throw([ValueError] if safe else (ValueError, Panic, SystemExit))

        def step(rounds):
            nonlocal heeded
            if not answer.done():
                if rounds:
                    loop.call_soon(step, rounds - 1)
                else:
                    heeded = True
                    job.release()

        answer = self._hand_in(run, work)
        job = self._pool.last
        if begins:
            job.begin()
        loop.call_soon(step, draw.randint(0, 20 if shielded else 5))
        try:
            await (asyncio.shield(answer) if shielded else answer)
        except asyncio.CancelledError:
            if heeded:
                job.future.result()  # the cancellation has overtaken what it raised
            elif shielded:
                pass  # it goes on
            elif begins:
                loop.call_later(rest, job.release)
            elif run.left is None:
                self._journal.leave(run)  # nobody waits for it, so it never begins
            raise


async def linger(rest):
    """Sleep on, whoever cancels it."""
    while rest > 0:
        began = asyncio.get_running_loop().time()
        try:
            await asyncio.sleep(rest)
        except asyncio.CancelledError:
            rest -= asyncio.get_running_loop().time() - began
        else:
            return
