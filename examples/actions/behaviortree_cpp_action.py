"""A behaviour tree of BehaviorTree.CPP as an action, through its wheel, behaviortreepy.

The tree is ticked when work of one of its leaves has ended, and once more, for what repeats it. A Python function that
raises within a tick is a node that fails, and the error a text on the screen; so leaves keep the errors of their work,
and the action raises them.
"""

import asyncio
from collections.abc import Awaitable, Callable, Mapping

from behaviortreepy import BehaviorTreeFactory, NodeStatus, TreeNode
from errand import Feedback, Robot, play
from tasks import Tasks, cancel


class Work:
    """The leaves of one kind, which await an async function: False is failure.

    Args:
        work: The function.
        tasks: The tasks of the tree.
        feedback: Takes the name of a leaf that begins.
    """

    def __init__(self, work: Callable[[], Awaitable[object]], tasks: Tasks, feedback: Feedback | None) -> None:
        self.work = work
        self.tasks = tasks
        self.feedback = feedback
        self.running: dict[int, asyncio.Task[object]] = {}
        self.failed = ""
        self.error: BaseException | None = None

    def start(self, node: TreeNode) -> NodeStatus:
        """Begin."""
        if self.feedback is not None:
            # Not from here: what an action brings about in its own task counts as its last step.
            asyncio.get_running_loop().call_soon(self.feedback, node.name())
        self.failed = ""
        self.running[node.uid()] = self.tasks.begin(self.work)
        return NodeStatus.RUNNING

    def run(self, node: TreeNode) -> NodeStatus:
        """Look at what has become of it."""
        task = self.running[node.uid()]
        if not task.done():
            return NodeStatus.RUNNING
        self.tasks.taken()
        self.error = asyncio.CancelledError() if task.cancelled() else task.exception()
        if self.error is None and task.result() is not False:
            return NodeStatus.SUCCESS
        self.failed = node.name()
        return NodeStatus.FAILURE

    def halt(self, node: TreeNode) -> None:
        """Cancel the work: the tree goes elsewhere."""
        cancel(self.running[node.uid()])


def tree_action(
    text: str,
    work: Mapping[str, Callable[[], Awaitable[object]]],
    feedback: Feedback | None = None,
    *,
    period: float | None = None,
) -> Callable[[], Awaitable[None]]:
    """Return an async function that runs a tree to its end.

    Args:
        text: The tree, in the library's XML.
        work: By the names of the tree's own actions, what they await.
        feedback: Takes the name of each leaf that begins.
        period: Seconds after which the tree is ticked also where no work has ended: for nodes of the library that
            look at the time, which is always real.
    """

    async def act() -> None:
        tasks, factory = Tasks(), BehaviorTreeFactory()
        leaves = {name: Work(function, tasks, feedback) for name, function in work.items()}
        for name, leaf in leaves.items():
            factory.register_simple_stateful_action(name, leaf.start, leaf.run, leaf.halt)
        tree = factory.create_tree_from_text(text)
        try:
            while True:
                status = tree.tick_once()
                for leaf in leaves.values():
                    if leaf.error is not None:
                        raise leaf.error
                if status == NodeStatus.SUCCESS:
                    return
                if status == NodeStatus.FAILURE:
                    failed = ", ".join(leaf.failed for leaf in leaves.values() if leaf.failed)
                    raise RuntimeError(f"the tree failed; leaves that did: {failed or 'none with work'}")
                await tasks.change(period)
        finally:
            tree.halt_tree()
            await tasks.end()

    return act


TREE = """
<root BTCPP_format="4">
  <BehaviorTree ID="fetch">
    <Sequence>
      <Approach name="approach"/>
      <Take name="take"/>
      <Bring name="bring"/>
      <PutDown name="put_down"/>
    </Sequence>
  </BehaviorTree>
</root>
"""


def fetch(robot: Robot, feedback: Feedback) -> Callable[[], Awaitable[None]]:
    """Return the errand as a tree."""
    work = {
        "Approach": lambda: robot.drive("the shelf"),
        "Take": robot.take,
        "Bring": lambda: robot.drive("the dock"),
        "PutDown": robot.put_down,
    }
    return tree_action(TREE, work, feedback)


if __name__ == "__main__":
    play(fetch)
