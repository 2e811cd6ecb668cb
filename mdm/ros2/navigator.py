"""The navigator over an action such as Nav2's ``NavigateToPose``: a new goal replaces the old one without a stop."""

from __future__ import annotations

import asyncio
import math
from functools import partial
from typing import TYPE_CHECKING, Any

from mdm.options import Options, Seconds

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.maps import Pose
    from mdm.ros2.actions import Actions


class NavigatorTable(Options, frozen=True, kw_only=True):
    """The navigator of a file's places.

    Attributes:
        action: The name of ROS' action.
        type: Its type; its goal has a field ``pose``, of ``geometry_msgs/PoseStamped``.
        frame: The frame of the map's poses.
        behavior_tree: The tree by which it drives; the server's own by default.
        silence: Seconds without feedback or status after which a drive has failed; none by default.
    """

    action: str = "/navigate_to_pose"
    type: str = "nav2_msgs/action/NavigateToPose"
    frame: str = "map"
    behavior_tree: str = ""
    silence: Seconds | None = None


class GoalNavigator:
    """Drives by goals: a `mdm.maps.ReportingNavigator`.

    Args:
        actions: Of the link.
        table: The action and its options.

    Raises:
        WireError: If the type or a field is wrong.
    """

    replaces = True

    def __init__(self, actions: Actions, table: NavigatorTable | None = None) -> None:
        self._table = NavigatorTable() if table is None else table
        self._actions = actions
        self._server = actions.server(self._table.action, self._table.type)
        self._goal(0.0, 0.0, 0.0)

    async def go(self, goal: Pose, feedback: Callable[[float], object]) -> None:
        """Drive to a pose; the feedback is ``distance_remaining``, where the action has it, in metres."""

        def hear(told: Any) -> object:
            return hasattr(told, "distance_remaining") and feedback(told.distance_remaining)

        message, secured = self._goal(goal.x, goal.y, goal.yaw), partial(self._actions.secured, None)
        await self._server.pursue(message, hear, self._table.silence, self, secured)
        task = asyncio.current_task()
        if task is not None and task.cancelling():  # there all the same: no next goal is driven to
            raise asyncio.CancelledError

    def _goal(self, x: float, y: float, yaw: float) -> Any:
        pose = {"position": {"x": x, "y": y}, "orientation": {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}}
        tree = {"behavior_tree": self._table.behavior_tree} if self._table.behavior_tree else {}
        fields = {"pose": {"header": {"frame_id": self._table.frame}, "pose": pose}, **tree}
        return self._actions.wire.make(self._table.type, fields)
