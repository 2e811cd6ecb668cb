"""A behaviour tree of py_trees as an action.

The tree is ticked when work of one of its leaves has ended, and once more, for what repeats it: nothing polls.
Pre-empted, it is stopped at its root, and the action ends when the work of its leaves has ended.
`BehaviourTree.interrupt` would not do: it ends py_trees' own loop, and stops no leaf.
"""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import py_trees
from errand import Feedback, Robot, play
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from tasks import Tasks, cancel


class Work(Behaviour):
    """A leaf that awaits an async function: False is failure, and what it raises ends the whole tree."""

    def __init__(self, name: str, work: Callable[[], Awaitable[object]]) -> None:
        super().__init__(name)
        self.work = work
        self.task: asyncio.Task[object] | None = None

    def setup(self, **kwargs: Any) -> None:
        """Take the tasks of the tree."""
        self.tasks: Tasks = kwargs["tasks"]

    def initialise(self) -> None:
        """Begin."""
        self.task = self.tasks.begin(self.work)

    def update(self) -> Status:
        """Look at what has become of it."""
        assert self.task is not None
        if not self.task.done():
            return Status.RUNNING
        self.tasks.taken()
        return Status.FAILURE if self.task.result() is False else Status.SUCCESS

    def terminate(self, new_status: Status) -> None:
        """Cancel the work where the tree goes elsewhere."""
        if new_status is Status.INVALID and self.task is not None:
            cancel(self.task)


def tree_action(
    make: Callable[[], Behaviour], feedback: Feedback | None = None, *, period: float | None = None
) -> Callable[[], Awaitable[None]]:
    """Return an async function that runs a tree to its end.

    Args:
        make: Makes the root of a new tree, for each run.
        feedback: Takes the name of the tree's tip, when that changes.
        period: Seconds after which the tree is ticked also where no work has ended: for leaves that look at something,
            as timers and conditions do.
    """

    async def act() -> None:
        root, tasks, tip = make(), Tasks(), ""
        tree = py_trees.trees.BehaviourTree(root)
        tree.setup(tasks=tasks)
        try:
            while True:
                tree.tick()
                last, tip = tip, getattr(root.tip(), "name", "")
                if root.status is Status.SUCCESS:
                    return
                if root.status is Status.FAILURE:
                    raise RuntimeError(f"{root.name} failed at {tip}")
                if feedback is not None and tip != last:
                    # Not from here: what an action brings about in its own task counts as its last step.
                    asyncio.get_running_loop().call_soon(feedback, tip)
                await tasks.change(period)
        finally:
            root.stop(Status.INVALID)
            await tasks.end()
            tree.shutdown()

    return act


def fetch(robot: Robot, feedback: Feedback) -> Callable[[], Awaitable[None]]:
    """Return the errand as a tree."""

    def make() -> Behaviour:
        root = py_trees.composites.Sequence("fetch", memory=True)
        root.add_children(
            [
                Work("approach", lambda: robot.drive("the shelf")),
                Work("take", robot.take),
                Work("bring", lambda: robot.drive("the dock")),
                Work("put_down", robot.put_down),
            ]
        )
        return root

    return tree_action(make, feedback)


if __name__ == "__main__":
    play(fetch)
