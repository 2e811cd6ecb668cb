"""The same four layers as others would write them: asyncio tasks, pykka actors, a direct call.

Each is what a competent user would write for the one task at hand: sensors A and B, a predicate by formula, a state of
three factors (3 x 2 x 2), a policy table, a callback.
"""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Direct", "Pykka", "Queues", "Tight"]


PREDICATES: dict[str, Callable[[dict[str, bool]], bool]] = {"Neither": lambda p: not p["A"] and not p["B"]}
FACTORS = (("Room0", "Room1", "Room2"), ("A",), ("B",))
FIRST = {"Room0": True, "Room1": False, "Room2": False, "A": False, "B": False, "Neither": True}


@dataclass(frozen=True, slots=True)
class Update:
    """Predicates that changed, and when."""

    time: float
    values: dict[str, bool]


@dataclass(frozen=True, slots=True)
class Index:
    """A state or an action, and when its stimulus came."""

    time: float
    index: int


def sense(values: dict[str, bool], name: str, value: bool) -> dict[str, bool]:
    """Set a sensor, evaluate the formulas, and return what changed."""
    before = dict(values)
    values[name] = value
    for derived, formula in PREDICATES.items():
        values[derived] = formula(values)
    return {key: values[key] for key in values if values[key] != before[key]}


def joint(known: dict[str, bool]) -> int:
    """Return the joint state of the factors, row-major."""
    index = 0
    for names in FACTORS:
        if len(names) == 1:
            index = index * 2 + known[names[0]]
        else:
            index = index * len(names) + next(i for i, name in enumerate(names) if known[name])
    return index


class Queues:
    """Predicates, state, policy and action as tasks with an ``asyncio.Queue`` between each two."""

    def __init__(self, policy: list[int], callback: Callable[[], object]) -> None:
        self.policy, self.callback = policy, callback
        self.sensed: asyncio.Queue[tuple[str, bool]] = asyncio.Queue()
        self.updates: asyncio.Queue[Update] = asyncio.Queue()
        self.states: asyncio.Queue[Index] = asyncio.Queue()
        self.actions: asyncio.Queue[Index] = asyncio.Queue()
        self.called = asyncio.Event()

    def start(self) -> list[asyncio.Task[None]]:
        """Start the four tasks."""
        return [asyncio.create_task(layer()) for layer in (self.predicates, self.state, self.control, self.action)]

    async def predicates(self) -> None:
        """Sensors to predicates."""
        values = dict(FIRST)
        while True:
            name, value = await self.sensed.get()
            changed = sense(values, name, value)
            if changed:
                self.updates.put_nowait(Update(time.monotonic(), changed))

    async def state(self) -> None:
        """Predicates to states."""
        known = dict(FIRST)
        last = -1
        while True:
            update = await self.updates.get()
            known.update(update.values)
            index = joint(known)
            if index != last:
                last = index
                self.states.put_nowait(Index(update.time, index))

    async def control(self) -> None:
        """States to actions."""
        while True:
            state = await self.states.get()
            self.actions.put_nowait(Index(state.time, self.policy[state.index]))

    async def action(self) -> None:
        """Actions to callbacks."""
        while True:
            await self.actions.get()
            self.callback()
            self.called.set()

    async def decide(self, value: bool) -> None:
        """Set sensor A and wait for the callback."""
        self.called.clear()
        self.sensed.put_nowait(("A", value))
        await self.called.wait()


class Tight:
    """The same four tasks as tight as they can be: nothing is copied, and only what has changed is looked at."""

    def __init__(self, policy: list[int], callback: Callable[[], object]) -> None:
        self.policy, self.callback = policy, callback
        self.sensed: asyncio.Queue[tuple[str, bool]] = asyncio.Queue()
        self.updates: asyncio.Queue[tuple[float, str, bool]] = asyncio.Queue()
        self.states: asyncio.Queue[tuple[float, int]] = asyncio.Queue()
        self.actions: asyncio.Queue[tuple[float, int]] = asyncio.Queue()
        self.called = asyncio.Event()

    def start(self) -> list[asyncio.Task[None]]:
        """Start the four tasks."""
        return [asyncio.create_task(layer()) for layer in (self.predicates, self.state, self.control, self.action)]

    async def predicates(self) -> None:
        """Sensors to predicates."""
        a = b = False
        neither = True
        get, put = self.sensed.get, self.updates.put_nowait
        while True:
            name, value = await get()
            if name == "A" and value != a:
                a = value
            elif name == "B" and value != b:
                b = value
            else:
                continue
            now = time.monotonic()
            put((now, name, value))
            if neither != (not a and not b):
                neither = not neither

    async def state(self) -> None:
        """Predicates to states."""
        index, strides = 0, {"A": 2, "B": 1}
        get, put = self.updates.get, self.states.put_nowait
        while True:
            stamp, name, value = await get()
            index += strides[name] if value else -strides[name]
            put((stamp, index))

    async def control(self) -> None:
        """States to actions."""
        policy, get, put = self.policy, self.states.get, self.actions.put_nowait
        while True:
            stamp, index = await get()
            put((stamp, policy[index]))

    async def action(self) -> None:
        """Actions to callbacks."""
        get, callback, called = self.actions.get, self.callback, self.called.set
        while True:
            await get()
            callback()
            called()

    async def decide(self, value: bool) -> None:
        """Set sensor A and wait for the callback."""
        self.called.clear()
        self.sensed.put_nowait(("A", value))
        await self.called.wait()


class Direct:
    """The same work as one function that calls the next: the floor, with no layers at all."""

    def __init__(self, policy: list[int], callback: Callable[[], object]) -> None:
        self.policy, self.callback = policy, callback
        self.a = self.b = False

    def decide(self, value: bool) -> None:
        """Set sensor A, which calls the callback."""
        self.a = value
        self.state(2 * self.a + self.b)

    def state(self, index: int) -> None:
        """Choose the action."""
        self.action(self.policy[index])

    def action(self, _: int) -> None:
        """Call the callback."""
        self.callback()


class Pykka:
    """Four pykka actors, each in a thread of its own."""

    def __init__(self, policy: list[int], callback: Callable[[], object]) -> None:
        import threading  # noqa: PLC0415

        import pykka  # noqa: PLC0415

        called = self.called = threading.Event()
        known, values = dict(FIRST), dict(FIRST)

        class Action(pykka.ThreadingActor):
            def on_receive(self, _: Any) -> None:
                callback()
                called.set()

        class Control(pykka.ThreadingActor):
            def on_receive(self, message: Any) -> None:
                action.tell(Index(message.time, policy[message.index]))

        class State(pykka.ThreadingActor):
            def on_receive(self, message: Any) -> None:
                known.update(message.values)
                control.tell(Index(message.time, joint(known)))

        class Predicates(pykka.ThreadingActor):
            def on_receive(self, message: Any) -> None:
                state.tell(Update(time.monotonic(), sense(values, "A", message)))

        action, control, state = Action.start(), Control.start(), State.start()
        self.first = Predicates.start()
        self.actors = (self.first, state, control, action)

    def decide(self, value: bool) -> None:
        """Set sensor A and wait for the callback."""
        self.called.clear()
        self.first.tell(value)
        self.called.wait()

    def stop(self) -> None:
        """Stop the threads."""
        for actor in self.actors:
            actor.stop()
