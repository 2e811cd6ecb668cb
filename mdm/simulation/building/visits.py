"""Visits: people, intruders, fires and the like, which come to places and go again; and bystanders, their bodies."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mdm.checks import is_number
from mdm.errors import ConfigError
from mdm.messages import Message
from mdm.simulation.building.body import Body

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.maps.paths import Paths

_AWAY = -1e5
"""Metres east and north of the map, and of each other: where bodies are for which there is no visit."""


@dataclass(frozen=True)
class Visits:
    """How often something comes, and how long it stays: exponential times.

    Args:
        kind: Its kind, such as ``person``.
        every: The expected seconds from one coming to the next, in the whole building; infinite for never by itself.
        stay: The expected seconds until it goes by itself; infinite for something that has to be seen to.
        places: Where, each as often as the others; by default everywhere.
        radius: Of its body, in metres, around which robots drive; 0 for no obstacle.

    Raises:
        ConfigError: If a time is not above 0, the radius not from 0, or there is no place.
    """

    kind: str
    every: float = math.inf
    stay: float = math.inf
    places: Sequence[str] | None = None
    radius: float = 0.2

    def __post_init__(self) -> None:
        for what, seconds in (("every", self.every), ("stay", self.stay)):
            if not is_number(seconds) or not seconds > 0:
                raise ConfigError(f"{what} is a number of seconds above 0, not {seconds!r}", key=what)
        if not is_number(self.radius) or not 0 <= self.radius < math.inf:
            raise ConfigError(f"the radius is a number of metres, 0 or more, not {self.radius!r}", key="radius")
        if self.places is not None and (isinstance(self.places, str) or not self.places):
            raise ConfigError(f"places are names, one at least, not {self.places!r}", key="places")


@dataclass(frozen=True)
class Visit:
    """Something that is there now.

    Attributes:
        number: Which one, counted from 1 in its building.
        kind: Its kind.
        place: Where.
        x: The same, in metres.
        y: The same.
    """

    number: int
    kind: str
    place: str
    x: float
    y: float


class VisitChange(Message, frozen=True):
    """Something has come or gone, told on ``<building>/visits``.

    Attributes:
        time: When.
        number: Which one, as in `Visit`.
        kind: Its kind.
        place: Where.
        x: The same, in metres.
        y: The same.
        came: Whether it has come.
    """

    time: int
    number: int
    kind: str
    place: str
    x: float
    y: float
    came: bool


class Bystander(Body):
    """A body in a `Building` that stands where a visit is; afterwards another visit may have it.

    Args:
        number: Which one, from 0.
        agent: Its agent in navground.
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
