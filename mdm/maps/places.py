"""Places: from the poses of a robot to predicates and events about where it is."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal, TypedDict, Unpack

from msgspec import Meta

from mdm.actors.predicates.declarations import ACTION_END
from mdm.checks import is_number
from mdm.errors import ConfigError, Error, MapError
from mdm.maps.graph import Pose
from mdm.maps.map import Floors, Map
from mdm.maps.raster import Labels, border_distance, lookup
from mdm.messages import Journey, PoseUpdate
from mdm.options import Options, Seconds
from mdm.runtime import Actor
from mdm.texts import FINITE

if TYPE_CHECKING:
    from mdm.actors import PredicateManager
    from mdm.runtime import Supervision, Timer

_QUIET = round(10e9)
_SETTLES = round(10e9)
"""Nanoseconds near its goal after which a drive that has not ended counts as there all the same."""


Metres = Annotated[float, Meta(ge=0, le=FINITE, extra={"unit": "metres"})]


class PlacesSettings(Options, frozen=True, kw_only=True):
    """When a robot counts as being in a place.

    Attributes:
        margin: In metres; three standard deviations of the poses' error are right.
        max_age: In seconds.
        tolerance: How near to a goal counts as there, in metres, where the graph does not say.
        prefix: The beginning of all names, as ``IsIn`` in ``IsInKitchen`` and ``IsInKitchen.entered``.
        outside: What counts in cells of no place after the ``max_age``: the place is ``unknown``, or ``keep`` the last
            one until another is entered, as for zones that are islands.
        tour: Places to come to one after the other, again and again.
    """

    margin: Metres = 0.3
    max_age: Seconds = 0.5
    tolerance: Metres = 0.3
    prefix: str = ""
    outside: Literal["unknown", "keep"] = "unknown"
    tour: Sequence[str] = ()


class PlacesOptions(TypedDict, total=False):
    """The keyword arguments of `PlacesSettings`."""

    margin: float
    max_age: float
    tolerance: float
    prefix: str
    outside: Literal["unknown", "keep"]
    tour: Sequence[str]


PlacesOptions.__doc__ = PlacesSettings.__doc__


class Places(Actor):
    """Tells predicates where a robot is, from its poses on `see`, or on the channel ``places/pose``.

    Of each place ``Kitchen`` of the map there are, in the predicate manager:

    - the predicate ``Kitchen``: the robot is in it. One is true and all others are false, or all are unknown;
    - the events ``Kitchen.entered`` and ``Kitchen.left``: when that changes. The first place known is entered, too;
    - where there is a graph, the predicate ``Kitchen.at_goal``: the robot is within the tolerance of the place's goal;
      and the event ``Kitchen.arrived``: when it comes there;
    - with that, the predicate ``Kitchen.reached``: of all goals this is the last one where the robot was; before it was
      at any, that of the place where it is, or of the nearest one by path. From the first pose on one is true: a state
      factor over these tells where the robot comes from while it drives;
    - for a `tour`, of each of its places the predicate ``Kitchen.next``: of the tour, this place is the next. One is
      true; when it is reached, that of the place after it.

    A border has a margin: the robot is in another place only where that is at least so far inside it. A cell of no
    place is of the last one, for at most the ``max_age``. A goal is left at the tolerance and the margin. Without a
    pose for as long as the ``max_age``, and at a pose that is not finite, all is unknown; the first pose after that
    counts wherever it is. A robot that starts in a cell of no place counts as in the one whose goal is nearest by path
    until it enters any, since nothing would move it there else. All changes are one update of the predicate
    manager; a pose that changes nothing costs it none.

    While a drive of `Navigation` is under way, its goal does not count as one where the robot is before the drive has
    ended, for at most ten seconds, and no other goal is reached.

    Args:
        floor: The map; or its labels alone, without goals; or several floors, of which each pose names one.
        predicates: The predicate manager, where all is declared; started with this actor unless it already runs.
        name: Its name among actors.
        supervision: The meaning of its failure.
        options: See `PlacesOptions`.

    Raises:
        ConfigError: If a name is taken, or stands for something else in formulas; or if the tour has fewer than two
            places, one twice, or one without a goal.
        MapError: If a place has no cell as deep as the margin: it could not be entered.

    Attributes:
        floor: The map, the labels, or the floors.
        labels: Which place each cell belongs to; of several floors, on that of the last pose.
        predicates: The predicate manager.
        prefix: The beginning of all names.
        late: How many poses were older than the last one, or than the ``max_age``.
    """

    def __init__(
        self,
        floor: Map | Labels | Floors,
        predicates: PredicateManager,
        *,
        name: str = "places",
        supervision: Supervision = "escalate",
        **options: Unpack[PlacesOptions],
    ) -> None:
        super().__init__(name, supervision=supervision)
        settings = PlacesSettings.from_keywords(options)
        margin, prefix = settings.margin, settings.prefix
        self.floor = floor
        if isinstance(floor, Floors):
            self._levels = {
                name: _Level(labels, [f"{name}.{place}" for place in floor.maps[name].labels.names], margin)
                for name, labels in floor.labels.items()
            }
        else:
            labels = floor.labels if isinstance(floor, Map) else floor
            self._levels = {"": _Level(labels, labels.names, margin)}
        self._change(next(iter(self._levels)))
        self.predicates = predicates
        self.prefix = prefix
        self.late = 0
        self._keeps = settings.outside == "keep"
        self._max_age = round(settings.max_age * 1e9)
        nodes = () if isinstance(floor, Labels) else floor.graph.nodes
        self._goals = tuple(
            (node.goal.x, node.goal.y, near * near, (near + margin) * (near + margin))
            for node in nodes
            for near in [float(settings.tolerance if node.tolerance is None else node.tolerance)]
        )
        self._rooms = tuple(prefix + name for name in self.labels.names)
        for index, node in enumerate(nodes):
            if node.goal.floor in self._levels:
                self._levels[node.goal.floor].goals.append((index, *self._goals[index]))
        self._goal_names = tuple(prefix + node.name for node in nodes)
        self._nodes = {node.name: index for index, node in enumerate(nodes)}
        self._tour = _tour(settings.tour, [node.name for node in nodes])
        self._declare(settings.max_age)
        self._forget()

    def _declare(self, max_age: float) -> None:
        goals = (
            *(f"{name}.{what}" for name in self._goal_names for what in ("at_goal", "reached")),
            *(f"{self._goal_names[index]}.next" for index in self._tour),
        )
        for name in self._rooms:
            if "/" in name or ACTION_END.fullmatch(name):
                stands = "another agent's predicate" if "/" in name else "the end of an action"
                raise ConfigError(f"the place {name!r} reads as {stands}: give it another name", key=name)
        for name in (*self._rooms, *goals):
            self.predicates.sensor(name)
        self.predicates.declared.age((*self._rooms, *goals), max_age, "the robot's pose on the map")
        for name in self._rooms:
            self.predicates.event(f"{name}.entered")
            self.predicates.event(f"{name}.left")
        for name in self._goal_names:
            self.predicates.event(f"{name}.arrived")

    def _forget(self) -> None:
        self._room = 0  # the label of the place that predicates are told; 0 where that is unknown
        self._last = 0  # the last one that was known
        self._located = False  # whether there is a pose that counts
        self._between = False  # whether the place is the nearest, since the robot was in none yet
        self._at: frozenset[int] = frozenset()  # the goals where it is
        self._last_at: frozenset[int] = frozenset()
        self._reached: int | None = None  # the last goal where it was
        self._turn = 0  # how many places of the tour it has come to, without whole rounds
        self._heads_for: int | None = None  # the goal of the drive that is under way
        self._near_since: int | None = None  # since when it is near that
        self._arrives: asyncio.Future[bool] | None = None  # waits for a pose there
        self._pose: Pose | None = None  # the last one that counts
        # When there was a pose that counts, one that told a place, one that was not finite, and one that was too old.
        self._seen = self._placed = self._bad = self._delayed = -(1 << 62)
        self._told: dict[str, bool | None] = {}
        self._witness: tuple[str, bool] | None = None  # a predicate that is as told, unless the manager began again
        self._timer: Timer | None = None

    # -- What users call -----------------------------------------------------------------------------------------

    def see(self, pose: Pose, stamp: float | None = None) -> None:
        """Take a pose of the robot, in the frame of the map. From any thread.

        Args:
            pose: Where it is.
            stamp: When it was there, in seconds of the runtime's clock; by default now.

        Raises:
            Error: If this has not started, or the pose or the stamp is none.
        """
        now = self.runtime.clock.now()
        if stamp is not None:
            if not is_number(stamp) or not math.isfinite(stamp):
                raise Error(f"a stamp is a time in seconds of the runtime's clock, not {stamp!r}")
            now = round(min(now, stamp * 1e9))
        try:
            update = PoseUpdate(now, float(pose.x), float(pose.y), float(pose.yaw), getattr(pose, "floor", ""))
        except (AttributeError, TypeError, ValueError, OverflowError):
            raise Error(f"a Pose of x, y and yaw was expected, not {pose!r}") from None
        self.channel("pose", PoseUpdate).publish(update)

    @property
    def place(self) -> str | None:
        """The name of the place where the robot is, without the prefix; None where that is unknown."""
        return self.labels.names[self._room - 1] if self._room else None

    @property
    def between(self) -> str | None:
        """The name of the place that counts since it is the nearest, as long as the robot was in none; else None."""
        return self.place if self._between else None

    def nearest(self) -> str | None:
        """Return the name of the place whose goal is nearest to the robot by path; None where no path is known."""
        return None if self._pose is None or isinstance(self.floor, Labels) else self._nearest(self._pose)

    @property
    def pose(self) -> Pose | None:
        """The last pose that counts; None where there is none."""
        return self._pose

    @property
    def heading_for(self) -> str | None:
        """The name of the place to whose goal a drive is under way; None where there is no drive."""
        return None if self._heads_for is None else self._goal_names[self._heads_for].removeprefix(self.prefix)

    # -- What navigation calls -----------------------------------------------------------------------------------

    def set_out(self, place: str | None) -> None:
        """Note that a drive to a place's goal is under way, or none."""
        self._travel(place)

    def _travel(self, place: str | None, *, arrived: bool = False) -> None:
        """Publish how a drive stands: it is input, which a record keeps."""
        journey = Journey(self.runtime.now(), place, arrived)
        if self.life == "running":
            self.channel("journeys", Journey).publish(journey)
        else:
            self._on_journey(journey)

    def _on_journey(self, journey: Journey) -> None:
        goal = None if journey.place is None else self._nodes.get(journey.place)
        if journey.arrived and goal is not None:
            self._heads_for = None
            if goal not in self._at or self._reached != goal:
                self._at |= {goal}
                self._reached = goal
                self._tell()
        else:
            self._heads_for = goal
            self._near_since = None

    async def arrive(self, place: str) -> None:
        """Let a drive have come to a place's goal: by the last pose, or by one that comes within ``max_age``.

        Where no pose counts, nobody knows better than what has driven.

        Raises:
            Error: If the robot is farther from the goal than the tolerance and the margin.
        """
        goal = self._heads_for
        if goal is None or goal != self._nodes.get(place) or self._pose is None:
            return
        if self._is_near(goal, self._pose):
            self._travel(place, arrived=True)
            return
        self._arrives = arrives = asyncio.get_running_loop().create_future()

        def give_up() -> None:
            if not arrives.done():
                arrives.set_result(False)

        timer = self.call_later(self._max_age / 1e9, give_up)
        try:
            if await arrives:
                # Only now: what is decided there comes after the end of the drive, and does not pre-empt it.
                self._travel(place, arrived=True)
            elif self._pose is not None:
                far = self._distance(goal, self._pose)
                if math.isinf(far):
                    raise Error(
                        f"the drive to {place!r} has ended, and the robot is on the floor {self._pose.floor!r} by its "
                        f"poses"
                    )
                most = math.sqrt(self._goals[goal][3])
                raise Error(
                    f"the drive to {place!r} has ended, and the robot is {far:.2g} m from the goal: at most {most:g} m "
                    f"(the tolerance and the margin) count as there"
                )
        finally:
            timer.cancel()
            self._arrives = None

    def _is_near(self, goal: int, pose: Pose) -> bool:
        """Whether a robot at a pose counts as come to a goal when its drive has ended."""
        return self._distance(goal, pose) <= math.sqrt(self._goals[goal][3])

    def _distance(self, goal: int, pose: Pose) -> float:
        if not any(index == goal for index, *_ in self._levels[pose.floor].goals):
            return math.inf  # it is on another floor
        x, y, *_ = self._goals[goal]
        return math.hypot(pose.x - x, pose.y - y)

    # -- Life ----------------------------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Listen; all is unknown until a pose comes."""
        self._forget()
        self.share(self.predicates)
        poses = self.channel("pose", PoseUpdate)
        poses.input = True
        poses.supersedes = lambda _: "pose"  # of those that wait in another thread the newest counts
        self.subscribe(poses, self._on_pose)
        journeys = self.channel("journeys", Journey)
        journeys.input = True
        self.subscribe(journeys, self._on_journey)

    def on_failing(self, error: BaseException) -> None:
        """Let all be unknown at once."""
        self._lose()

    def on_stop(self) -> None:
        """Let all be unknown, unless all ends."""
        if not self.runtime.ending:
            self._lose()

    # -- Poses ---------------------------------------------------------------------------------------------------

    def _on_pose(self, pose: PoseUpdate) -> None:
        now = self.runtime.now()
        here = Pose(pose.x, pose.y, pose.yaw, floor=pose.floor)
        if not here.is_finite or (pose.floor != self._floor and pose.floor not in self._levels):
            self._on_bad_pose(here, now)
            return
        time = min(pose.time, now)
        if time < self._seen or now - time >= self._max_age:
            self._on_late_pose(time, now)
            return
        self._seen, self._pose = time, here
        before = self._room if pose.floor == self._floor else self._change(pose.floor)
        code = self._look_up(pose.x, pose.y)
        room, between = self._room_of(code, before)
        if code >> 1 or ((self._keeps or between) and room):
            self._placed = time  # in the margin of another place it is in the last one all the same
        at, reached = self._at, self._reached
        if self._goals:
            at = self._goals_at(pose.x, pose.y, time)
            reached = self._reached_at(at, room, here)
        if (room, at, reached, between) != (self._room, self._at, self._reached, self._between) or not self._located:
            self._between, self._room, self._at, self._reached, self._located = between, room, at, reached, True
            self._tell()
        elif self._witness is not None and self.predicates.value(self._witness[0]) is not self._witness[1]:
            self._told.clear()  # the predicate manager has started again
            self._tell()
        if self._timer is None:
            self._wait()
        if self._arrives is not None:
            goal = self._heads_for
            if goal is not None and not self._arrives.done() and self._is_near(goal, here):
                self._arrives.set_result(True)

    def _room_of(self, code: int, before: int) -> tuple[int, bool]:
        """Return the label of the place where the robot is, by that of the cell, and whether it is only the nearest."""
        label = code >> 1
        if code & 1 or (label and (self._between or not before)):
            return label, False
        if not (before or self._located) and (near := self.nearest()) is not None:
            return self.labels.names.index(near) + 1, True
        return before, self._between

    def _change(self, floor: str) -> int:
        """Be on another floor, where the robot is in no place yet, of whose borders there would be a margin."""
        level = self._levels[floor]
        self._between = False
        self._floor, self.labels, self._look_up, self._goals_here = floor, level.labels, level.look_up, level.goals
        return 0

    def _goals_at(self, x: float, y: float, time: int) -> frozenset[int]:
        """Return the goals where the robot is: within the tolerance, and the margin where it was there before.

        That of a drive which is under way counts when it has ended, or has been near for long.
        """
        before, goal = self._at, self._heads_for
        at = frozenset(
            index
            for index, goal_x, goal_y, near, far in self._goals_here
            # Products, not powers, which raise where a pose is too far away for its square.
            if (x - goal_x) * (x - goal_x) + (y - goal_y) * (y - goal_y) <= (far if index in before else near)
        )
        if goal is None or goal not in at or goal in before:
            self._near_since = None
            return at
        if self._near_since is None:
            self._near_since = time
        return at if time - self._near_since >= _SETTLES else at - {goal}

    def _reached_at(self, at: frozenset[int], room: int, pose: Pose) -> int | None:
        """Return of all goals the last one where the robot was; while a drive is under way, none but its own is new."""
        goal, reached = self._heads_for, self._reached
        if goal is not None and reached is not None:
            return goal if goal in at else reached
        if at:
            return min(at - self._at, default=min(at) if reached not in at else reached)
        if reached is None:
            return self._nodes[self.labels.names[room - 1] if room else str(self._nearest(pose, straight=True))]
        return reached

    def _nearest(self, pose: Pose, *, straight: bool = False) -> str | None:
        """Return the place whose goal is nearest: by path, or straight where the floor has no grid, or on request."""
        assert not isinstance(self.floor, Labels)
        floor = self.floor.maps[pose.floor] if isinstance(self.floor, Floors) else self.floor
        nodes, grid = [node for node in self.floor.graph.nodes if node.goal.floor == pose.floor], floor.grid
        lengths = [math.inf] * len(nodes)
        here = None if grid is None else grid.frame.cell(pose.x, pose.y)
        if grid is not None and here is not None and grid.free[here]:
            from mdm.maps.paths import Paths  # noqa: PLC0415 - it is seldom needed

            ends = [grid.frame.cell(node.goal.x, node.goal.y) for node in nodes]
            distances, _ = Paths(grid.frame, grid.free).distances([here])
            lengths = [math.inf if end is None else float(distances[end]) for end in ends]
        straight = straight or (grid is None and self.labels.frame.cell(pose.x, pose.y) is not None)
        if straight and not math.isfinite(min(lengths, default=math.inf)):
            lengths = [math.hypot(pose.x - node.goal.x, pose.y - node.goal.y) for node in nodes]
        near = min(lengths, default=math.inf)
        return nodes[lengths.index(near)].name if math.isfinite(near) else None

    def _on_bad_pose(self, pose: Pose, now: int) -> None:
        self._lose()
        if now - self._bad >= _QUIET:
            where = f"x = {pose.x}, y = {pose.y}, yaw = {pose.yaw}"
            told = f"a pose is not finite ({where}): places are unknown until one is"
            if pose.is_finite:
                several = isinstance(self.floor, Floors)
                floors = f"there are {', '.join(self._levels)}" if several else "the map is of one floor without a name"
                told = f"a pose is on the floor {pose.floor!r}, which there is not ({floors}): places are unknown"
            self.report("pose", told)
        self._bad = now

    def _on_late_pose(self, time: int, now: int) -> None:
        """Leave a pose out; tell where nothing is known since all that come are so old."""
        self.late += 1
        if not self._located and now - time >= self._max_age:
            if now - self._delayed >= _QUIET:
                age, most = (now - time) / 1e9, self._max_age / 1e9
                self.report(
                    "late",
                    f"a pose is {age:.3g} s old, and none counts that is {most:g} s old: places are unknown until "
                    f"newer ones come; are the stamps those of the runtime's clock?",
                )
            self._delayed = now

    # -- Telling -------------------------------------------------------------------------------------------------

    def _lose(self) -> None:
        """Let all be unknown."""
        self._pose = None
        self._between = False
        self._room, self._at, self._located = 0, frozenset(), False
        if self._told:
            self._tell()

    def _tell(self) -> None:
        """Give the predicate manager all changes as one update."""
        values: dict[str, bool | None] = {
            name: label == self._room if self._room else None for label, name in enumerate(self._rooms, 1)
        }
        for index, name in enumerate(self._goal_names):
            values[f"{name}.at_goal"] = index in self._at if self._located else None
            known = self._located and self._reached is not None
            values[f"{name}.reached"] = index == self._reached if known else None
        if self._tour and self._located and self._reached == self._tour[self._turn]:
            self._turn = (self._turn + 1) % len(self._tour)
        for turn, index in enumerate(self._tour):
            values[f"{self._goal_names[index]}.next"] = turn == self._turn if self._located else None
        told = self._told
        changes = tuple((name, value) for name, value in values.items() if told.get(name, told) is not value)
        self._told = values
        self._witness = next(((name, value) for name, value in values.items() if value is not None), None)
        events = []
        if self._room and self._room != self._last and not self._between:
            if self._last:
                events.append(f"{self._rooms[self._last - 1]}.left")
            events.append(f"{self._rooms[self._room - 1]}.entered")
            self._last = self._room
        if self._located:
            events += [f"{self._goal_names[index]}.arrived" for index in sorted(self._at - self._last_at)]
            self._last_at = self._at
        if changes or events:
            self.predicates.derive(changes, tuple(events))

    def _wait(self) -> None:
        """Wait until all knowledge is too old; the timer is moved on lazily, not at each pose."""
        if self._room or self._located:
            since = self._placed if self._room else self._seen
            self._timer = self.call_at(since + self._max_age, self._look)

    def _look(self) -> None:
        now, seconds = self.runtime.now(), f"{self._max_age / 1e9:g} s"
        if self._located and now >= self._seen + self._max_age:
            self.report("stale", f"there was no pose for {seconds} that counts: places are unknown")
            self._lose()
        elif self._room and now >= self._placed + self._max_age:
            self.report("stale", f"the robot has been outside of all places for {seconds}: its place is unknown")
            self._room = 0
            self._tell()
        self._timer = None
        self._wait()


class _Level:
    """A floor: its labels, the look-up in them, and the goals there.

    Raises:
        MapError: If no pose could enter a place of the floor: it has no cell as deep as the margin.
    """

    __slots__ = ("goals", "labels", "look_up")

    def __init__(self, labels: Labels, places: Sequence[str], margin: float) -> None:
        distances = border_distance(labels)
        for name in places:
            cells = labels.cells(name)
            deepest = float(distances[cells].max(initial=0.0))
            if not cells.any():
                raise MapError(f"the place {name!r} has no cells: label some, or leave it out")
            if deepest < margin - 1e-9:
                raise MapError(
                    f"the place {name!r} could not be entered: its deepest cell is {deepest:.3g} m from other places, "
                    f"and the margin is {margin:g} m; give a smaller margin, or let the place be larger"
                )
        self.labels = labels
        self.look_up = lookup(labels, margin)
        self.goals: list[tuple[int, float, float, float, float]] = []


def _tour(tour: Sequence[str], names: Sequence[str]) -> tuple[int, ...]:
    """Return the goals of a tour by their numbers, after a check."""
    for name in tour:
        if name not in names:
            raise ConfigError(
                f"the tour comes to {name!r}, and there are goals in {', '.join(names) or 'none'}", key="tour"
            )
    if tour and len(set(tour)) < max(len(tour), 2):
        raise ConfigError(f"a tour takes two places or more, each of them once, not {', '.join(tour)}", key="tour")
    return tuple(names.index(name) for name in tour)
