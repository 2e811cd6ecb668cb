"""A state machine of SMACH as an action.

SMACH runs in a thread. Pre-empted, it is asked for its end, and the action ends when the thread has. States have to
look at that request; the one here hands it on to the work that it waits for, in the event loop. Time is real: a thread
that waits for virtual time would wait for ever.
"""

import asyncio
import logging
import threading
from collections.abc import Awaitable, Callable, Collection
from concurrent.futures import ThreadPoolExecutor

import smach
from errand import Feedback, Robot, play

log = logging.getLogger("smach")
smach.set_loggers(log.info, log.warning, log.debug, log.error)  # in place of lines on the screen


class Work(smach.State):
    """A state that awaits an async function in the event loop: False is ``failed``."""

    def __init__(self, work: Callable[[], Awaitable[object]]) -> None:
        super().__init__(outcomes=["succeeded", "failed", "preempted"])
        self.loop = asyncio.get_running_loop()
        self.work = work
        self.task: asyncio.Future[object] | None = None

    def execute(self, userdata: smach.UserData) -> str:
        """Have it run, and wait for its end, in SMACH's thread."""
        ended = threading.Event()

        def begin() -> None:
            if self.preempt_requested():
                ended.set()
                return
            self.task = asyncio.ensure_future(self.work())
            self.task.add_done_callback(lambda _: ended.set())

        self.loop.call_soon_threadsafe(begin)
        ended.wait()
        task, self.task = self.task, None
        error = None if task is None or task.cancelled() else task.exception()
        if error is not None:
            raise error
        if self.preempt_requested():
            self.service_preempt()
            return "preempted"
        return "failed" if task is None or task.result() is False else "succeeded"

    def request_preempt(self) -> None:
        """Cancel the work, once: a second time would cut off what it does to come to its end."""
        if not self.preempt_requested():
            super().request_preempt()
            self.loop.call_soon_threadsafe(self._cancel)

    def _cancel(self) -> None:
        if self.task is not None:
            self.task.cancel()


def machine_action(
    make: Callable[[], smach.StateMachine],
    feedback: Feedback | None = None,
    *,
    succeeds: Collection[str] = ("succeeded",),
) -> Callable[[], Awaitable[None]]:
    """Return an async function that runs a machine to its outcome.

    Args:
        make: Makes a new machine, for each run: one that was pre-empted keeps the request.
        feedback: Takes the name of each state that is entered, in the event loop.
        succeeds: Outcomes that mean success; with any other one the action fails.
    """

    async def act() -> None:
        loop, machine = asyncio.get_running_loop(), make()

        def entered(userdata: smach.UserData, states: list[str], *_: object) -> None:  # noqa: ARG001 - as of SMACH
            if feedback is not None:
                loop.call_soon_threadsafe(feedback, states[0])

        machine.register_start_cb(entered)
        machine.register_transition_cb(entered)
        # Its own thread: those of the event loop are few, and a state that does not end would keep one from others.
        own = ThreadPoolExecutor(1, "smach")
        # Its own data: without them all machines of a program share what SMACH takes in place of none.
        thread = loop.run_in_executor(own, machine.execute, smach.UserData())
        own.shutdown(wait=False)
        try:
            await asyncio.wait([thread])
        except asyncio.CancelledError:
            machine.request_preempt()
            await asyncio.wait([thread])
            if thread.exception() is None:
                raise
        error = thread.exception()
        while isinstance(error, smach.InvalidUserCodeError) and error.__context__ is not None:
            error = error.__context__  # what a state has raised
        if error is not None:
            raise error
        if thread.result() not in succeeds:
            raise RuntimeError(f"the machine ended with {thread.result()}")

    return act


def fetch(robot: Robot, feedback: Feedback) -> Callable[[], Awaitable[None]]:
    """Return the errand as a state machine."""

    def make() -> smach.StateMachine:
        machine = smach.StateMachine(outcomes=["succeeded", "failed", "preempted"])
        with machine:
            add = smach.StateMachine.add
            add("approach", Work(lambda: robot.drive("the shelf")), {"succeeded": "take"})
            add("take", Work(robot.take), {"succeeded": "bring"})
            add("bring", Work(lambda: robot.drive("the dock")), {"succeeded": "put_down"})
            add("put_down", Work(robot.put_down))
        return machine

    return machine_action(make, feedback)


if __name__ == "__main__":
    play(fetch, virtual=False, pace=0.02)
