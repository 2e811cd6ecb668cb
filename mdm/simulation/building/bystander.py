"""Bystanders: the bodies of those who visit a building, which stand where they are, in the way or not."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.simulation.building.body import Body

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.maps.paths import Paths
    from mdm.simulation.building.visits import Visit

__all__ = ["Bystander"]

_AWAY = -1e5
"""Metres east and north of the map, and of each other: where bodies are for which there is no visit."""


class Bystander(Body):
    """A body in a `Building` that stands where a visit is; afterwards another visit may have it.

    Args:
        number: Which one, from 0.
        agent: What stands for it in navground.
        paths: Where robots may be.

    Attributes:
        visit: Whose body it is; None where it is nobody's, and away.
    """

    def __init__(self, number: int, agent: Any, paths: Paths) -> None:
        super().__init__("nobody", agent, paths)
        self._number = number
        self.visit: Visit | None = None
        self.leave()

    @property
    def remaining(self) -> float:
        """The metres to go: none."""
        return 0.0

    @property
    def turns(self) -> tuple[tuple[int, int], ...]:
        """The cells where its way turns: none."""
        return ()

    def steer(self, seconds: float, bodies: Sequence[Body] = ()) -> None:
        """Stay."""

    def come(self, visit: Visit) -> None:
        """Stand where a visit is."""
        self.visit = visit
        self.name = visit.kind
        self._place(visit.x, visit.y)

    def leave(self) -> None:
        """Be away."""
        self.visit = None
        self._place(_AWAY * (1 + self._number), _AWAY)

    def _place(self, x: float, y: float) -> None:
        from navground.core import Pose2  # noqa: PLC0415 - an extra

        self.agent.pose = Pose2((x, y), 0.0)
