"""The other way round: an ensemble as a leaf of a behaviour tree, and as a state of a state machine.

An ensemble that decides until something is achieved is an async function like any other. The adapters of this folder
await such functions in the leaves of trees of py_trees and BehaviorTree.CPP and in the states of machines.
"""

import asyncio
from collections.abc import Awaitable, Callable

import py_trees
from py_trees_action import Work, tree_action
from statemachine import State, StateMachine
from statemachine_action import machine_action

import mdm
from mdm.messages import Mode, PredicateUpdate


async def decide(runtime: mdm.Runtime, ensemble: mdm.Ensemble, until: str) -> bool:
    """Let an ensemble decide until a predicate is true; cancelled, its action has ended when this does.

    Args:
        runtime: Runs the ensemble's predicate manager, too, which was started before and stays.
        ensemble: Runs within this call alone, and starts again with each.
        until: A predicate of its manager.

    Returns:
        Whether the predicate is true; False if the ensemble went into its safe mode before.
    """
    predicates = ensemble.predicates
    assert predicates is not None
    ended: asyncio.Future[bool] = asyncio.get_running_loop().create_future()

    def end(*, achieved: bool) -> None:
        if not ended.done():
            ended.set_result(achieved)

    def take_update(update: PredicateUpdate) -> None:
        if until in update.rising:
            end(achieved=True)

    def take_mode(mode: Mode) -> None:
        if mode.mode == "safe":
            end(achieved=False)

    if predicates.value(until):
        return True
    subscriptions = [
        predicates.updates.subscribe(take_update),
        runtime.channel(f"{ensemble.name}/mode", Mode).subscribe(take_mode),
    ]
    try:
        await runtime.start(ensemble)
        return await ended
    finally:
        for subscription in subscriptions:
            subscription.cancel()
        await runtime.stop(ensemble)


class Cleaner:
    """A robot that goes through rooms and cleans what is dirty, as an ensemble decides.

    Args:
        tell: Takes what the robot does, as it does it.
    """

    def __init__(self, tell: Callable[[str], object] = print) -> None:
        self.tell = tell
        self.rooms = ["hall", "office", "lab"]
        self.predicates = mdm.PredicateManager()
        self.is_dirty = self.predicates.sensor("IsDirty", initial=False)
        self.is_done = self.predicates.sensor("IsDone", initial=False)
        self.ensemble = mdm.Ensemble(
            "cleaner",
            policy=mdm.policies.DeterministicPolicy([0, 1]),
            predicates=self.predicates,
            states=[mdm.StateFactor("floor", ["IsDirty"])],
            actions={"Search": self.search, "Clean": self.clean},
            safe_action=lambda: tell("brushes off"),
        )

    async def search(self) -> None:
        """Go from room to room until one is dirty, or there are no more."""
        self.tell("searches")
        while self.rooms:
            await asyncio.sleep(1)
            if self.rooms.pop(0) != "office":
                self.is_dirty.set(True)
                return
        self.is_done.set(True)

    async def clean(self) -> None:
        """Clean this room."""
        self.tell("cleans")
        await asyncio.sleep(2)
        self.is_dirty.set(False)

    async def dock(self) -> None:
        """Drive back."""
        await asyncio.sleep(1)
        self.tell("docks")


def as_leaf(runtime: mdm.Runtime, cleaner: Cleaner) -> Callable[[], Awaitable[object]]:
    """Return a tree, one leaf of which is the ensemble."""

    def make() -> py_trees.behaviour.Behaviour:
        root = py_trees.composites.Sequence("clean up", memory=True)
        root.add_children(
            [Work("rooms", lambda: decide(runtime, cleaner.ensemble, "IsDone")), Work("dock", cleaner.dock)]
        )
        return root

    return tree_action(make)


def as_state(runtime: mdm.Runtime, cleaner: Cleaner) -> Callable[[], Awaitable[object]]:
    """Return a state machine, one state of which is the ensemble."""

    class CleanUp(StateMachine):
        rooms = State(initial=True)
        docking = State()
        done = State(final=True)
        stuck = State(final=True)
        cleaned = rooms.to(docking)
        lost = rooms.to(stuck)
        docked = docking.to(done)

        async def on_enter_rooms(self) -> None:
            achieved = await decide(runtime, cleaner.ensemble, "IsDone")
            await (self.cleaned() if achieved else self.lost())

        async def on_enter_docking(self) -> None:
            await cleaner.dock()
            await self.docked()

    return machine_action(CleanUp)


async def main() -> None:
    for name, make in (("a tree", as_leaf), ("a state machine", as_state)):
        print(f"as part of {name}:")
        cleaner = Cleaner(lambda line: print(f"  {line}"))
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(cleaner.predicates)
            await make(runtime, cleaner)()


if __name__ == "__main__":
    mdm.run(main, virtual=True)
