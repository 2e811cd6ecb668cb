"""A state machine of transitions as an action.

An `AsyncMachine` takes the cancellation of a trigger for its own business: the trigger returns False, whichever way the
machine queues. So the action looks whether it was cancelled, and goes on with that.
"""

import asyncio
from collections.abc import Awaitable, Callable, Collection

from errand import Feedback, Robot, play
from transitions.extensions.asyncio import AsyncMachine


def machine_action(
    make: Callable[[], AsyncMachine],
    feedback: Feedback | None = None,
    *,
    begin: str = "begin",
    succeeds: Collection[str] = ("done",),
) -> Callable[[], Awaitable[None]]:
    """Return an async function that runs a machine until it is in a final state.

    Args:
        make: Makes a new machine, its own model, for each run.
        feedback: Takes the name of each state that is entered.
        begin: The trigger that sets the machine going.
        succeeds: Final states that mean success; in any other one the action fails.
    """

    async def act() -> None:
        machine = make()
        loop, ended = asyncio.get_running_loop(), asyncio.Event()

        begun = False

        def entered() -> None:
            nonlocal begun
            begun = True
            if feedback is not None and not machine.get_state(machine.state).final:
                # Not from here: what an action brings about in its own task counts as its last step.
                loop.call_soon(feedback, machine.state)

        for state in machine.states.values():
            state.on_enter.insert(0, entered)
        machine.on_final.append(ended.set)
        await machine.trigger(begin)
        task = asyncio.current_task()
        if task is not None and task.cancelling():
            raise asyncio.CancelledError
        if not begun:
            raise RuntimeError(f"{type(machine).__name__} stays in {machine.state}: nothing lets it {begin}")
        await ended.wait()
        if machine.state not in succeeds:
            raise RuntimeError(f"{type(machine).__name__} ended in {machine.state}")

    return act


class FetchMachine(AsyncMachine):
    """The errand as a state machine: triggers that a state makes wait in the queue until it has been entered."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        names = ("waiting", "approach", "take", "bring", "put_down")
        final = [{"name": name, "final": True} for name in ("done", "no_box")]
        super().__init__(states=[*names, *final], initial="waiting", auto_transitions=False, queued=True)
        for trigger, source, target in (
            ("begin", "waiting", "approach"),
            ("arrived", "approach", "take"),
            ("taken", "take", "bring"),
            ("missed", "take", "no_box"),
            ("arrived", "bring", "put_down"),
            ("released", "put_down", "done"),
        ):
            self.add_transition(trigger, source, target)

    async def on_enter_approach(self) -> None:
        """Drive to the shelf."""
        await self.robot.drive("the shelf")
        await self.trigger("arrived")

    async def on_enter_take(self) -> None:
        """Take a box."""
        await self.trigger("taken" if await self.robot.take() else "missed")

    async def on_enter_bring(self) -> None:
        """Drive to the dock."""
        await self.robot.drive("the dock")
        await self.trigger("arrived")

    async def on_enter_put_down(self) -> None:
        """Put the box down."""
        await self.robot.put_down()
        await self.trigger("released")


def fetch(robot: Robot, feedback: Feedback) -> Callable[[], Awaitable[None]]:
    """Return the errand as a state machine."""
    return machine_action(lambda: FetchMachine(robot), feedback)


if __name__ == "__main__":
    play(fetch)
