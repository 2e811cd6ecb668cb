"""Navigation: the ways of a map as actions, whose goals depend on the place that a decision was made on."""

from __future__ import annotations

import asyncio
import inspect
import math
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol, Unpack

import numpy as np

from mdm.actors.actions.binding import Binding
from mdm.checks import check_flag
from mdm.errors import ConfigError, Error
from mdm.logic import similar
from mdm.maps.graph import Graph
from mdm.maps.map import rides
from mdm.maps.places import Places
from mdm.messages import Heading, Progress
from mdm.runtime.handler import kind_of
from mdm.runtime.work import Work

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable, Sequence

    from mdm.actors import PredicateManager
    from mdm.actors.ensemble import Ensemble
    from mdm.actors.options import DriveOptions
    from mdm.maps.graph import Edge, Node, Pose
    from mdm.maps.map import Floors, Map
    from mdm.messages import Action
    from mdm.models.matrices import Vector


class Navigator(Protocol):
    """Drives a robot: an ``async`` method that ends when the robot is there.

    It raises where the robot cannot get there, with a sentence, and stops the robot when it is cancelled. A navigator
    whose robot may go on to a new goal without a stop says so by an attribute ``replaces = True``. Then a new call may
    come while another one runs, which is cancelled at once: that one ends, and leaves the robot to the newer goal.
    """

    def go(self, goal: Pose, /) -> Awaitable[None]:
        """Drive to a pose, in the frame of the map."""


class ReportingNavigator(Protocol):
    """A `Navigator` that tells how far it is."""

    def go(self, goal: Pose, feedback: Callable[[float], object], /) -> Awaitable[None]:
        """Drive to a pose; call the feedback with the metres that remain, from any thread, as often as it likes.

        Of reports that wait in another thread the newest counts.
        """


class LiftNavigator(Protocol):
    """A navigator of a robot that goes to other floors, too: `Floors`, or a graph with lifts, take one."""

    def go(self, goal: Pose, /) -> Awaitable[None]:
        """Drive to a pose on the floor where the robot is."""

    def ride(self, lift: str, goal: Pose, /) -> Awaitable[None]:
        """Take a lift, before which the robot is, to a pose on another floor: that of its stop there."""


class Navigation:
    """Makes actions of the ways of a map: ``Up`` goes where the way ``Up`` leads from the place where the robot is.

    The place is the one that was decided on, so that decision and goal agree: of a state it is the value of its factor
    over places, of a belief the likeliest place that has such a way. Where what was decided on does not say, it is the
    one whose predicate is true when the action begins. From a place without such a way the robot finishes its way to
    the place's goal, as the model has it stay there; where it is at the goal already, or no place is known, the action
    fails with a sentence, and the robot is not moved. Chosen again, an action goes on to its goal; where it leads
    elsewhere by now, as in the next room, it starts again. A robot between places first goes to the nearest.

    After a failure it is decided again, see `Sequel`, unless ``then`` says otherwise: nothing but a drive would change
    the place that is decided on.

    A drive has succeeded when its navigator says so and, by `Places`, the robot is at the goal; until then that goal
    does not count as reached, so that what is decided there does not end the drive short of it.

    Of several floors, a drive to another one takes the lifts that lead there: to the stop by `go`, on by the
    navigator's method `ride`, and from the stop by `go` again. The robot's floor is that of its last pose; where none
    counts, that of the place that was decided on, or whose predicate is true.

    Where each drive leads and why is on the channel ``navigation/headings``, and the reports of a navigator are on
    ``navigation/progress``.

    Args:
        floor: The map, or its graph alone; or several floors.
        navigator: Drives the robot.
        places: Where the robot is: `Places`; or the predicate manager, which has a predicate for each place.
        prefix: Of a predicate manager, the text of predicates before the names of places.
        name: The beginning of its channel.

    Raises:
        ConfigError: If there is no predicate for a place, or the navigator cannot be called, or has no `ride` where
            there are lifts, or ``replaces`` is neither True nor False.

    Attributes:
        heading: Where the drive under way leads, and why; None where there is none.
        prefix: The text of predicates before the names of places.
        replaces: Whether the navigator's robot goes on to a new goal without a stop.

    Example::

        places = mdm.maps.Places(floor, predicates)
        navigation = mdm.maps.Navigation(floor, navigator, places)
        actions = {**navigation.actions(stay="Stay"), "Charge": navigation.go_to("Dock")}
    """

    def __init__(
        self,
        floor: Map | Graph | Floors,
        navigator: Navigator | ReportingNavigator | LiftNavigator,
        places: Places | PredicateManager,
        *,
        prefix: str = "",
        name: str = "navigation",
    ) -> None:
        self.graph = floor if isinstance(floor, Graph) else floor.graph
        self.navigator = navigator
        self._places: Places | None = None
        if isinstance(places, Places):
            self._places = places
            if prefix:
                raise ConfigError("navigation takes the prefix of its places: give it to them alone", key="prefix")
            self.predicates, prefix = places.predicates, places.prefix
        else:
            self.predicates = places
        self.name = name
        self.prefix = prefix
        self.heading: Heading | None = None
        self._drives = 0
        self._reports = _takes_feedback(navigator)
        self._has_floors = len({node.goal.floor for node in self.graph.nodes}) > 1
        if self._has_floors and not callable(getattr(navigator, "ride", None)):
            raise ConfigError(
                f"there are several floors, and the navigator has no async method 'ride', which takes the name of a "
                f"lift and the pose of its stop on another floor: {navigator!r}"
            )
        self.replaces = getattr(navigator, "replaces", False)
        check_flag(self.replaces, "replaces, of a navigator,", key="replaces")
        self._rooms = {node.name: prefix + node.name for node in self.graph.nodes}
        declared = self.predicates.declared
        for place, room in self._rooms.items():
            if declared.knows(room) != "predicate":
                hint = similar(room, declared.names)
                raise ConfigError(f"the place {place!r} needs a predicate {room!r}, which is not declared{hint}")

    # -- What users call -----------------------------------------------------------------------------------------

    def actions(
        self,
        *,
        stay: str | None = None,
        **options: Unpack[DriveOptions],
    ) -> dict[str, Binding]:
        """Return an action for each label of the graph's ways, to be bound in an ensemble.

        Args:
            stay: The name of one more action, which stops the robot where it is.
            options: See `DriveOptions`. A failure is followed by another decision where ``then`` says nothing.

        Raises:
            ConfigError: If a way has the name of the action that stays.
        """
        bound = {label: self.way(label, **options) for label in self.graph.labels}
        if stay is not None:
            if stay in bound:
                raise ConfigError(f"{stay!r} is a way of the map: give the action that stays another name", key="stay")
            bound[stay] = Binding(_stay)
        return bound

    def way(self, label: str, **options: Unpack[DriveOptions]) -> Binding:
        """Return the action that takes the way of a label, from wherever the robot is.

        Args:
            label: Of one way at least.
            options: See `DriveOptions`. A failure is followed by another decision where ``then`` says nothing.

        Raises:
            ConfigError: If no way has this label.
        """
        if label not in self.graph.labels:
            raise ConfigError(f"no way is called {label!r}; there are {', '.join(map(repr, self.graph.labels))}")
        return _Way(self, label, None, options)

    def go_to(self, name: str, **options: Unpack[DriveOptions]) -> Binding:
        """Return the action that goes to a place, wherever the robot is.

        Args:
            name: The place's.
            options: See `DriveOptions`. A failure is followed by another decision where ``then`` says nothing.

        Raises:
            MapError: If there is no such place.
        """
        node = self.graph.node(name)

        def go() -> Awaitable[None]:
            return self._drive(node, Heading(self._now(), "", None, name, "told to go there from anywhere"))

        _call(go, "go_to", name)
        bound = Binding(go, group=self if self.replaces else None, **options)
        bound.retries = bound.sequel.then != "wait"
        bound.lasts = True
        return bound

    async def navigate(self, place: str) -> None:
        """Drive to a place, within an action of your own; cancelled, it ends when the robot stands.

        Raises:
            MapError: If there is no such place.
            Error: If a drive is under way that this one does not replace, or the robot comes elsewhere; or the error
                of the navigator.
        """
        node = self.graph.node(place)
        if self.heading is not None and not self.replaces:
            raise Error(f"the robot cannot go to {place!r} yet: its drive to {self.heading.target!r} has not ended")
        heading = Heading(self._now(), "", None, place, "an action goes there, to work")
        # Not within the action's own steps: a decision for the action that they bring about would mean once more.
        drive = Work(self._drive(node, heading), f"mdm:{self.name}", lambda _: None)
        try:
            await asyncio.wait([drive.over])
        except asyncio.CancelledError:
            drive.cancel()
            await asyncio.wait([drive.over])
            raise
        if drive.error is not None:
            raise drive.error

    def task(self, function: Callable[..., Awaitable[object]], **options: Any) -> Binding:
        """Return the action of an async function that drives and works: its argument ``navigate`` is `navigate`.

        Args:
            function: The function. It may take the `Action` message besides, before that.
            options: See `Binding`. A failure is followed by another decision where ``then`` says nothing.

        Raises:
            ConfigError: If it takes no such argument.
        """
        name = getattr(function, "__qualname__", repr(function))
        if not callable(function) or "navigate" not in inspect.signature(function).parameters:
            raise ConfigError(f"{name} needs an argument 'navigate' to drive by")
        driving: Any = partial(function, navigate=self.navigate)
        driving.__name__ = driving.__qualname__ = name
        driving.__module__ = function.__module__
        bound = Binding(driving, **options)
        bound.retries = bound.sequel.then != "wait"
        return bound

    def place(self) -> str:
        """Return the name of the place where the robot is, as the predicates have it.

        Raises:
            Error: If none of them is true, or several are.
        """
        found = [place for place, room in self._rooms.items() if self.predicates.value(room) is True]
        if len(found) == 1:
            return found[0]
        if found:
            raise Error(f"the robot is in several places at once, by their predicates: {', '.join(found)}")
        unknown = [room for room in self._rooms.values() if self.predicates.value(room) is None]
        why = f"{', '.join(unknown)}: unknown" if unknown else f"{', '.join(self._rooms.values())}: all are false"
        raise Error(f"it is not known in which place the robot is ({why})")

    def target(self, label: str) -> Node:
        """Return where a way leads from the place where the robot is, as the predicates have it.

        Raises:
            Error: If that place is not known, or no way from there has this label and the robot is at its goal.
        """
        return self._resolved(label, self.place(), "where the robot is")[0]

    # -- Resolving -----------------------------------------------------------------------------------------------

    def resolve(
        self, label: str, action: Action | None = None, position: Position | None = None
    ) -> tuple[Node, Heading]:
        """Return where a way leads, and why: from the place that was decided on, or else where the robot is.

        Args:
            label: The way's.
            action: The decided action.
            position: Tells which place it was decided on.

        Raises:
            Error: If no place is known, or no way from there has this label and the robot is at its goal.
        """
        if action is not None and position is not None:
            decided = position.of(action)
            if decided is not None:
                return self._resolved(label, decided, "decided on")
            likely = position.likely() if action.state is None and action.epoch >= 0 else ()
            if likely:
                places = [place for place in likely if self.graph.target(place, label) is not None]
                return self._resolved(label, (places or likely)[0], "believed in")
        try:
            place = self.place()
        except Error:
            near = None if self._places is None else self._places.nearest()
            if near is None:
                raise
            return self.graph.node(near), Heading(self._now(), label, None, near, "in no place: it goes to the nearest")
        return self._resolved(label, place, "where the robot is")

    def _resolved(self, label: str, place: str, why: str) -> tuple[Node, Heading]:
        name = self.graph.target(place, label)
        if name is not None:
            first = ", the nearest place, where it goes first" if self._begins_between(place) else ""
            heading = Heading(self._now(), label, place, name, f"{label} from {place}, {why}{first}")
            return self.graph.node(name), heading
        ways = [f"{edge.label!r} to {edge.target!r}" for edge in self.graph.edges if edge.source == place]
        others = f"there are {', '.join(ways)}" if ways else "there is none at all"
        if self._is_at(place) is not False:
            raise Error(f"from {place!r} no way is called {label!r}; {others}")
        # In the model such an action stays in the place, and so does the robot: it finishes its way there.
        why = f"no way from {place}, {why}, is called {label}: it finishes its way there"
        return self.graph.node(place), Heading(self._now(), label, place, place, why)

    def _begins_between(self, place: str | None) -> bool:
        """Whether a place counts as where the robot is since it is the nearest: it was in none yet."""
        return place is not None and self._places is not None and self._places.between == place

    def _is_at(self, place: str) -> bool | None:
        """Whether the robot is at a place's goal; None where nobody tells."""
        predicate = f"{self._rooms[place]}.at_goal"
        if self.predicates.declared.knows(predicate) != "predicate":
            return None
        return self.predicates.value(predicate)

    def _rides(self, goal: Node, heading: Heading) -> tuple[Edge, ...]:
        """Return the lifts to take, in their order, from where the robot is; none where it is on the goal's floor.

        Raises:
            Error: If it is not known on which floor the robot is, or no ways lead to the other one.
        """
        if not self._has_floors:
            return ()
        here = self._nearest(heading)
        if here.goal.floor == goal.goal.floor:
            return ()
        way = None if heading.source is None else self.graph.way(heading.source, heading.label)
        if way is not None and way.lift is not None and self.graph.node(way.source).goal.floor == here.goal.floor:
            return (way,)
        return rides(self.graph, here.name, goal.name)

    def _nearest(self, heading: Heading) -> Node:
        """Return the place where the robot is; or else, on its floor, the one whose goal is nearest."""
        pose = None if self._places is None else self._places.pose
        if pose is None:
            return self.graph.node(self.place() if heading.source is None else heading.source)
        room = None if self._places is None else self._places.place
        if room is not None and (node := self.graph.node(room)).goal.floor == pose.floor:
            return node
        there = [node for node in self.graph.nodes if node.goal.floor == pose.floor]
        return min(there, key=lambda node: math.dist((node.goal.x, node.goal.y), (pose.x, pose.y)))

    def _now(self) -> int:
        return self.predicates.runtime.now() if self.predicates.life == "running" else 0

    # -- Lives ---------------------------------------------------------------------------------------------------

    async def _travel(self, node: Node, heading: Heading, go: Callable[[Pose], Awaitable[None]]) -> None:
        """Go to a place's goal, by the lifts that lead to its floor."""
        navigator: Any = self.navigator
        taken = self._rides(node, heading)
        if self._begins_between(heading.source) and heading.source != node.name:
            await go(self.graph.node(str(heading.source)).goal)
        for ride in taken:
            await go(self.graph.node(ride.source).goal)
            await _awaitable(navigator.ride(ride.lift, self.graph.node(ride.target).goal), "ride")
        if not taken or taken[-1].target != node.name:
            await go(node.goal)

    async def _drive(self, node: Node, heading: Heading) -> None:
        navigator: Any = self.navigator
        runtime = self.predicates.runtime
        self._drives = number = self._drives + 1
        self.heading = heading
        runtime.channel(f"{self.name}/headings", Heading).publish(heading)
        if self._places is not None:
            self._places.set_out(node.name)
        under_way = True

        def feedback(remaining: float) -> None:
            if under_way:  # else it comes late, of a drive that has ended
                channel.publish(Progress(runtime.clock.now(), node.name, float(remaining)))

        async def go(goal: Pose) -> None:
            await _awaitable(navigator.go(goal, feedback) if self._reports else navigator.go(goal), "go")

        try:
            if self._reports:
                channel = runtime.channel(f"{self.name}/progress", Progress)
                channel.supersedes = lambda _: "progress"
            await self._travel(node, heading, go)
            if self._places is not None:
                await self._places.arrive(node.name)
        finally:
            under_way = False
            if self._drives == number:  # else a newer drive has replaced it
                self.heading = None
                if self._places is not None:
                    self._places.set_out(None)


class _Way(Binding):
    """The action that takes the way of a label: from the place that its ensemble decided on."""

    __slots__ = ("_goal", "_navigation", "_options", "_position", "label")

    def __init__(self, navigation: Navigation, label: str, position: Position | None, options: DriveOptions) -> None:
        self.label = label
        self._navigation = navigation
        self._position = position
        self._goal: Node | None = None
        self._options = options

        def go(action: Action | None = None) -> Awaitable[None]:
            self._goal, heading = navigation.resolve(label, action, position)
            return navigation._drive(self._goal, heading)  # noqa: SLF001 - it is the navigation's own

        def goes_on(action: Action) -> bool:
            try:
                return navigation.resolve(label, action, position)[0] is self._goal
            except Error:
                return False  # it starts again, and says what is wrong

        _call(go, "way", label)
        group = navigation if navigation.replaces else None
        super().__init__(go, on_repeat="restart", goes_on=goes_on, group=group, **options)
        self.retries = self.sequel.then != "wait"
        self.takes_action = True  # though it can do without
        self.lasts = True

    def within(self, ensemble: Ensemble) -> Binding:
        """Return the way as an action of an ensemble, whose decisions say where it begins."""
        position = Position(ensemble, self._navigation.graph, self._navigation.prefix)
        return _Way(self._navigation, self.label, position, self._options)


def _call(go: Any, name: str, given: str) -> None:
    """Give an action the name by which it is listed."""
    go.__name__, go.__qualname__ = name, f"Navigation.{name}({given!r})"


def _stay() -> None:
    """Do nothing: that an action is chosen has ended the drive before it."""


def _awaitable(given: Any, method: str) -> Any:
    """Return the result of a navigator's method, if it can be awaited."""
    if not inspect.isawaitable(given):
        raise Error(
            f"a navigator's {method!r} is an async function, and this one returned {given!r}: the drive has no end"
        )
    return given


def _takes_feedback(navigator: object) -> bool:
    """Whether a navigator's method takes feedback besides the goal."""
    if isinstance(navigator, type):
        raise ConfigError(f"a navigator is an object, not its class: give {navigator.__name__}(…)")
    go = getattr(navigator, "go", None)
    if not callable(go):
        raise ConfigError(f"a navigator has an async method 'go', which takes a pose; {navigator!r} has none")
    kind = kind_of(go)
    if kind not in {None, "an async function"}:
        raise ConfigError(f"a navigator's 'go' is an async function without 'yield', not {kind}: {go!r}")
    try:
        signature = inspect.signature(go)
    except ValueError:  # compiled code need not tell
        return False
    for count in (2, 1):
        try:
            given = signature.bind(*range(count)).arguments
        except TypeError:
            continue
        if count == 1:
            return False
        second = signature.parameters[[*given][-1]]
        # An option of another name, such as a speed, is not meant.
        return second.name == "feedback" or second.default is second.empty
    raise ConfigError(f"a navigator's 'go' takes a pose, and may take a function for feedback; {go!r} does not")


class Position:
    """Tells in which place a robot was when an ensemble decided, as far as its state or belief says so.

    A factor is about places where each of its values is one: by the predicates of a place (``Hall``, ``Hall.reached``,
    ``Hall.at_goal``), or by its name as a symbol of the model.

    Args:
        ensemble: The ensemble that decides.
        graph: The places.
        prefix: The text of predicates before the names of places.
    """

    def __init__(self, ensemble: Ensemble, graph: Graph, prefix: str) -> None:
        self._ensemble = ensemble
        symbols = {prefix + name + end: name for name in graph.names for end in ("", ".reached", ".at_goal")}
        self._symbols = {**symbols, **{name: name for name in graph.names}}
        self._decided: tuple[tuple[str, ...], int] | None = None
        self._believed: tuple[tuple[str, ...], tuple[int, ...], int] | None = None
        self._is_found = False

    def of(self, action: Action) -> str | None:
        """Return the place that the state says which an action was decided on; None where there is none."""
        self._find()
        if action.state is None or self._decided is None:
            return None
        places, stride = self._decided
        return places[int(action.state) // stride % len(places)]

    def likely(self) -> tuple[str, ...]:
        """Return the places by the present belief of the ensemble, the likeliest first, without impossible ones.

        None where it tracks no belief, or its states have no place.
        """
        self._find()
        belief = None if self._believed is None else self._ensemble.controller.belief
        if belief is None or self._believed is None:
            return ()
        places, shape, axis = self._believed
        joint: Vector = np.asarray(belief).reshape(shape)
        weights = joint.sum(axis=tuple(other for other in range(len(shape)) if other != axis))
        return tuple(places[place] for place in np.argsort(-weights, kind="stable").tolist() if weights[place] > 0)

    def _find(self) -> None:
        """Find the factor that is about places, once all is built and a team has shared out its factors."""
        if self._is_found:
            return
        self._is_found = True
        layer, model = self._ensemble.state, self._ensemble.controller.model
        if layer is not None:
            sizes = [factor.size for factor in layer.factors]
            for place, factor in enumerate(layer.factors):
                if factor in layer.own and (places := self._places(factor.predicates)) is not None:
                    self._decided = places, int(np.prod(sizes[place + 1 :], dtype=np.int64))
                    break
        if model is None:
            return
        factors = model.state_space.factors
        shape = tuple(len(factor) for factor in factors)
        found = [
            (places, place)
            for place, factor in enumerate(factors)
            if len(factor) <= len(self._symbols) and (places := self._places(factor.names)) is not None
        ]
        if len(found) == 1:  # those of several robots are of the same places
            (places, place), *_ = found
            self._believed = places, shape, place
            if self._decided is None and layer is None:
                self._decided = places, int(np.prod(shape[place + 1 :], dtype=np.int64))

    def _places(self, symbols: Sequence[str] | Iterable[str]) -> tuple[str, ...] | None:
        places = [self._symbols.get(symbol) for symbol in symbols]
        known = tuple(place for place in places if place is not None)
        return known if len(known) == len(places) > 1 else None
