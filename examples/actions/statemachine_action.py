"""A state machine of python-statemachine as an action.

States do their work as they are entered, and send what has come of it as an event. The action ends in a final state.
"""

import asyncio
import inspect
from collections.abc import Awaitable, Callable, Collection
from typing import Any

from errand import Feedback, Robot, play
from statemachine import State, StateMachine
from statemachine.statemachine import StateChart


class Listener:
    """Hears which states a machine enters."""

    def __init__(self, feedback: Feedback | None) -> None:
        self.feedback = feedback
        self.final: asyncio.Future[str] = asyncio.get_running_loop().create_future()

    def on_enter_state(self, target: State) -> None:
        """Take a state that is entered."""
        if target.final:
            self.final.set_result(target.id)
        elif self.feedback is not None:
            # Not from here: what an action brings about in its own task counts as its last step.
            asyncio.get_running_loop().call_soon(self.feedback, target.id)


def machine_action(
    make: Callable[[], StateChart[Any]], feedback: Feedback | None = None, *, succeeds: Collection[str] = ("done",)
) -> Callable[[], Awaitable[None]]:
    """Return an async function that runs a machine until it is in a final state.

    Args:
        make: Makes a new machine, for each run; its callbacks are async functions.
        feedback: Takes the name of each state that is entered.
        succeeds: Final states that mean success; in any other one the action fails.
    """

    async def act() -> None:
        machine = make()
        if machine.catch_errors_as_events:
            raise TypeError(f"{machine.name} keeps errors to itself: it needs catch_errors_as_events = False")
        listener = Listener(feedback)
        machine.add_listener(listener)
        activated = machine.activate_initial_state()
        if not inspect.isawaitable(activated):
            raise TypeError(f"{machine.name} waits for nothing: one of its callbacks at least is an async function")
        await activated
        final = await listener.final
        if final not in succeeds:
            raise RuntimeError(f"{machine.name} ended in {final}")

    return act


class FetchMachine(StateMachine):
    """The errand as a state machine."""

    approach = State(initial=True)
    take = State()
    bring = State()
    put_down = State()
    done = State(final=True)
    no_box = State(final=True)
    arrived = approach.to(take) | bring.to(put_down)
    taken = take.to(bring)
    missed = take.to(no_box)
    released = put_down.to(done)

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        super().__init__()

    async def on_enter_approach(self) -> None:
        """Drive to the shelf."""
        await self.robot.drive("the shelf")
        await self.arrived()

    async def on_enter_take(self) -> None:
        """Take a box."""
        await (self.taken() if await self.robot.take() else self.missed())

    async def on_enter_bring(self) -> None:
        """Drive to the dock."""
        await self.robot.drive("the dock")
        await self.arrived()

    async def on_enter_put_down(self) -> None:
        """Put the box down."""
        await self.robot.put_down()
        await self.released()


def fetch(robot: Robot, feedback: Feedback) -> Callable[[], Awaitable[None]]:
    """Return the errand as a state machine."""
    return machine_action(lambda: FetchMachine(robot), feedback)


if __name__ == "__main__":
    play(fetch)
