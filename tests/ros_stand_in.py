"""As much of rclpy as the page on ROS uses: one executor on a thread, which ends where a callback raises, and goals."""

from __future__ import annotations

import queue
from types import ModuleType, SimpleNamespace

__all__ = ["Robot", "modules"]


class Future:
    """One of rclpy's: its callbacks are called on the executor's thread."""

    def __init__(self, executor):
        self._executor = executor
        self._callbacks = []
        self._outcome = None

    def add_done_callback(self, callback):
        self._callbacks.append(callback)
        if self._outcome is not None:
            self._executor.call(callback, self)

    def settle(self, result=None, error=None):
        self._outcome = (result, error)
        for callback in self._callbacks:
            self._executor.call(callback, self)

    def result(self):
        return self._outcome[0]

    def exception(self):
        return self._outcome[1]


class Executor:
    def __init__(self, *, context):
        self._calls = queue.Queue()
        context.executor = self

    def add_node(self, node):
        node.executor = self

    def call(self, function, *arguments):
        self._calls.put(lambda: function(*arguments))

    def spin(self):
        while (call := self._calls.get()) is not None:
            call()

    def shutdown(self):
        self._calls.put(None)


class Handle:
    """A goal, as its client sees it."""

    def __init__(self, robot, accepted):
        self._robot = robot
        self.accepted = accepted
        self.ended = Future(robot.node.executor)

    def get_result_async(self):
        return self.ended

    def cancel_goal_async(self):
        self._robot.cancelled.put(self)
        answer = Future(self._robot.node.executor)
        answer.settle()
        return answer


class Robot:
    """What the program talks to: its topics, and the goals that were sent, which the test answers.

    Attributes:
        sent: The futures of goals that were sent and not answered yet.
        cancelled: Goals whose cancellation was asked for.
    """

    def __init__(self):
        self.options = None
        self.open = False
        self.node = None
        self.heard = {}
        self.errors = []
        self.sent = queue.Queue()
        self.cancelled = queue.Queue()

    def init(self, *, context, signal_handler_options):
        self.options, self.open = signal_handler_options, True

    def shutdown(self, *, context):
        self.open = False

    def create_node(self, name, *, context):
        self.node = SimpleNamespace(
            create_subscription=lambda kind, topic, callback, qos: self.heard.update({topic: callback}),
            get_logger=lambda: SimpleNamespace(error=self.errors.append),
        )
        return self.node

    def say(self, topic, **fields):
        """Send a message on a topic."""
        self.node.executor.call(self.heard[topic], SimpleNamespace(**fields))

    def client(self, node, kind, name):
        return SimpleNamespace(send_goal_async=lambda goal: self._sent())

    def _sent(self):
        future = Future(self.node.executor)
        self.sent.put(future)
        return future

    def answer(self, future, *, accepted=True):
        """Accept a goal, or reject it."""
        handle = Handle(self, accepted)
        future.settle(handle)
        return handle


def modules(robot):
    """Return the modules by name."""
    options = SimpleNamespace(NO="no", ALL="all")
    status = type("GoalStatus", (), {"STATUS_SUCCEEDED": 4, "STATUS_CANCELED": 5})
    contents = {
        "rclpy": {"init": robot.init, "shutdown": robot.shutdown, "create_node": robot.create_node},
        "rclpy.action": {"ActionClient": robot.client},
        "rclpy.context": {"Context": SimpleNamespace},
        "rclpy.executors": {"SingleThreadedExecutor": Executor},
        "rclpy.signals": {"SignalHandlerOptions": options},
        "action_msgs": {},
        "action_msgs.msg": {"GoalStatus": status},
        "nav2_msgs": {},
        "nav2_msgs.action": {"DockRobot": type("DockRobot", (), {"Goal": SimpleNamespace})},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"BatteryState": SimpleNamespace},
    }
    found = {}
    for name, names in contents.items():
        found[name] = ModuleType(name)
        vars(found[name]).update(names)
    return found
