"""A model from a map: where a robot is, and factors of its users' own, under the ways of the graph as actions.

The state has the factor `POSITION`, the place, and the users' factors behind it. An action of a way's label leads to
the next place with its probability of success, else the robot stays; where there is no such way it stays, at a small
cost, or the action would tie with those that lead nowhere either. Users' factors change with the place
where the robot is next.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import scipy

from mdm.checks import check_metres, is_number
from mdm.errors import MapError
from mdm.maps.map import Floors
from mdm.maps.paths import Paths, drivable
from mdm.models import Durations, Factor, FactoredMDP, FactoredPOMDP, Node, Space, Table, TwoSliceNetwork

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy.typing as npt

    from mdm.maps.graph import Graph
    from mdm.maps.map import Map
    from mdm.models.matrices import Vector

POSITION = "position"
"""The factor of the place."""
NEXT = "next"
"""The factor of the place of a tour to which a robot is to come next."""
_ROUNDING = 1e-6
_REACH = 4.0
"""Standard deviations beyond which a pose's error is left out."""


@dataclass(frozen=True, eq=False)
class FloorFactor:
    """A factor of a floor's model beside the place.

    Args:
        name: Its name.
        values: Its symbols.
        transitions: P(next value | next place, value): places x values x values.
        rewards: Of the change to a value: places x values x values, of the next place, the value, and the next.
        initial: The distribution of the first value; the first one by default.
    """

    name: str
    values: Sequence[str]
    transitions: npt.NDArray[np.float64]
    rewards: npt.NDArray[np.float64] | None = None
    initial: Sequence[float] | None = None


def latch(graph: Graph, name: str, *, on: str, off: str, reward: float = 1.0) -> FloorFactor:
    """Return a factor that remembers which of two places the robot has been in last, as a patrol needs.

    Args:
        graph: The places.
        name: Its name; its values are ``no``, the first, and ``yes``.
        on: The place that makes it ``yes``.
        off: The place that makes it ``no``.
        reward: Of each change.

    Raises:
        MapError: If there is no such place, both are the same, or the reward is no number.
    """
    if graph.node(on).name == graph.node(off).name:
        raise MapError(f"{name!r} would be switched on and off in {on!r}: give it two places")
    transitions = np.tile(np.eye(2), (len(graph.nodes), 1, 1))
    rewards = np.zeros_like(transitions)
    for place, value in ((on, 1), (off, 0)):
        index = graph.names.index(place)
        transitions[index] = np.eye(2)[value]
        rewards[index, 1 - value, value] = _number(reward, f"the reward of {name!r}")
    return FloorFactor(name, ("no", "yes"), transitions, rewards)


def visits(graph: Graph, order: Sequence[str], *, reward: float = 1.0) -> FloorFactor:
    """Return the factor `NEXT`: to which place of a tour a robot is to come next, as a patrol of all places needs.

    It changes where the robot comes to that place. `Places` tells the same of a robot that drives, see its `tour`.

    Args:
        graph: The places.
        order: The places of the tour, after the last of which it begins again.
        reward: Of each place that is come to in its turn.

    Raises:
        MapError: If there are fewer than two places, one is unknown or given twice, or the reward is no number.
    """
    if len(set(order)) < max(len(order), 2):
        raise MapError(f"a tour takes two places or more, each of them once, not {', '.join(order) or 'none'}")
    transitions = np.tile(np.eye(len(order)), (len(graph.nodes), 1, 1))
    rewards = np.zeros_like(transitions)
    for value, name in enumerate(order):
        place, then = graph.names.index(graph.node(name).name), (value + 1) % len(order)
        transitions[place, value] = np.eye(len(order))[then]
        rewards[place, value, then] = _number(reward, "the reward of a visit")
    return FloorFactor(NEXT, tuple(order), transitions, rewards)


def model(
    graph: Graph,
    *,
    factors: Sequence[FloorFactor] = (),
    success: float | npt.NDArray[np.float64] = 0.9,
    rewards: Mapping[str, float] | None = None,
    idle_cost: float = 0.01,
    sightings: npt.NDArray[np.float64] | None = None,
    discount: float = 0.95,
    start: str | None = None,
    stay: str | None = None,
) -> FactoredMDP | FactoredPOMDP:
    """Return the model of a robot that goes the ways of a graph.

    Args:
        graph: The places and ways; the labels of ways are the actions.
        factors: The users' factors, most significant first, behind the place.
        success: The probability that a way is gone in one step: one for all, or places x labels, as of `chances`.
        rewards: Of a step that ends in a place, by its name.
        idle_cost: The cost of an action that leads nowhere.
        sightings: P(place that is seen | place), as of `sightings`; without it places are known, and it is an MDP.
        discount: In (0, 1].
        start: Where the robot is first; anywhere by default.
        stay: The name of one more action, which stays at no cost.

    Returns:
        A factored MDP, or POMDP whose observation is the place that is seen.

    Raises:
        MapError: If there are no ways, there is no such place, or a probability is none.
    """
    if not graph.labels:
        raise MapError("the graph has no ways, so that there is nothing to decide")
    labels = graph.labels if stay is None else (*graph.labels, stay)
    if stay is not None and not stay.strip():
        raise MapError("the action that stays has no name")
    if len(set(labels)) < len(labels):
        raise MapError(f"{stay!r} is a way of the map: give the action that stays another name")
    places = len(graph.nodes)
    moves, costs = _moves(graph, labels, chances(graph, success), _number(idle_cost, "the idle cost"))
    earned = np.zeros(places)
    for name, reward in (rewards or {}).items():
        earned[graph.names.index(graph.node(name).name)] = _number(reward, f"the reward of {name!r}")
    action, here, there = Node("action", 0), Node("state", 0), Node("next_state", 0)
    first = np.full(places, 1 / places) if start is None else np.eye(places)[graph.names.index(graph.node(start).name)]
    initial = [Table([here], first)]
    transitions = [Table([action, here, there], moves)]
    utilities = [Table([action, here], moves @ earned - costs)]
    for index, factor in enumerate(factors, 1):
        _check_names(factor)
        now, later = Node("state", index), Node("next_state", index)
        size = len(factor.values)
        shape = places, size, size
        changes = _numbers(factor.transitions, shape, f"the transitions of {factor.name!r}")
        if (changes < 0).any() or (abs(changes.sum(axis=2) - 1) > _ROUNDING).any():
            raise MapError(f"the transitions of {factor.name!r} are no distributions over the next value")
        begins = np.eye(size)[0] if factor.initial is None else factor.initial
        initial.append(Table([now], _numbers(begins, (size,), f"the first values of {factor.name!r}")))
        transitions.append(Table([there, now, later], changes))
        if factor.rewards is not None:
            expected = (changes * _numbers(factor.rewards, shape, f"the rewards of {factor.name!r}")).sum(axis=2)
            utilities.append(Table([action, here, now], np.einsum("apq,qv->apv", moves, expected)))
    names = [POSITION, *(factor.name for factor in factors)]
    twice = [name for index, name in enumerate(names) if name in names[:index]]
    if twice:
        raise MapError(f"two factors are called {twice[0]!r}: each needs a name of its own")
    states = Space([Factor(POSITION, graph.names), *(Factor(factor.name, factor.values) for factor in factors)])
    network = partial(TwoSliceNetwork, states, Space.single("robot", labels), initial=initial, transitions=transitions)
    if sightings is None:
        return FactoredMDP(network(utilities=utilities), discount=discount)
    seen = [Table([there, Node("observation", 0)], sightings)]
    places_seen = Space.single("robot", graph.names)
    return FactoredPOMDP(network(places_seen, observation=seen, utilities=utilities), discount=discount)


def _check_names(factor: FloorFactor) -> None:
    """Refuse a factor without a name, or without names of its values; users' own functions return them."""
    if not isinstance(factor, FloorFactor):
        raise MapError(f"{factor!r} is no factor: give a list of FloorFactor objects")
    if not isinstance(factor.name, str) or not factor.name:
        raise MapError(f"a factor is called {factor.name!r}: give it a name, as text")
    values: object = factor.values
    if isinstance(values, str) or not isinstance(values, Sequence) or not values:
        raise MapError(f"the values of {factor.name!r} are {values!r}: give a list of names")
    for value in values:
        if not isinstance(value, str) or not value:
            raise MapError(f"a value of {factor.name!r} is {value!r}: give it a name, as text")


def _number(given: object, what: str) -> float:
    """Return a finite number, after a check that it is one."""
    if not is_number(given) or not math.isfinite(given):
        raise MapError(f"{what} is {given!r}: give a number")
    return float(given)


def _numbers(given: npt.ArrayLike, shape: tuple[int, ...], what: str) -> Vector:
    """Return numbers as an array, after a check of their shape."""
    try:
        array = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise MapError(f"{what} are no array of numbers") from None
    if array.shape != shape:
        raise MapError(f"{what} have the shape {array.shape}, not {shape}")
    if not np.isfinite(array).all():
        raise MapError(f"{what} are not all finite")
    return array


def _moves(graph: Graph, labels: Sequence[str], taken: Vector, idle_cost: float) -> tuple[Vector, Vector]:
    """Return P(next place | action, place), actions x places x places, and the costs of actions, actions x places."""
    places = len(graph.nodes)
    moves = np.tile(np.eye(places), (len(labels), 1, 1))
    costs = np.zeros((len(labels), places))
    for place, name in enumerate(graph.names):
        for label, chance in enumerate(taken[place]):
            target = graph.target(name, labels[label])
            if target is None:
                costs[label, place] = idle_cost
            else:
                moves[label, place, place] -= chance
                moves[label, place, graph.names.index(target)] += chance
    return moves, costs


def chances(graph: Graph, success: float | npt.NDArray[np.float64]) -> Vector:
    """Return the probability that each way is gone in a step, places x labels.

    Raises:
        MapError: If one is not between 0 and 1, or the shape is another.
    """
    shape = len(graph.nodes), len(graph.labels)
    given = np.full(shape, success) if is_number(success) else success
    taken = _numbers(given, shape, "the probabilities of success")
    if not ((taken >= 0) & (taken <= 1)).all():
        raise MapError(f"{taken[~((taken >= 0) & (taken <= 1))].flat[0]:g} is no probability of success")
    return taken


def arrivals(floor: Map | Floors, *, speed: float, radius: float = 0.25) -> Vector:
    """Return the seconds that each way takes, places x labels: the length of the path between goals, by the speed.

    Lifts take their own seconds.

    Where there is no such way, the seconds of the shortest way from that place; of all where there is none at all.

    Args:
        floor: The map, with its grid; or several floors.
        speed: In metres a second.
        radius: Of the robot, which keeps so far from walls, and 5 cm more.

    Raises:
        MapError: If there is no grid, a robot does not fit at a goal, there is no path, the speed is not above 0, or
            the radius is no length.
    """
    check_metres(radius, "the radius")
    if not is_number(speed) or not (math.isfinite(speed) and speed > 0):
        raise MapError(f"a speed of {speed!r} brings no robot anywhere: give metres a second above 0")
    if isinstance(floor, Floors):
        taken = {
            (f"{name}.{source}", label): seconds
            for name, each in floor.maps.items()
            for (source, label), seconds in _driven(each, speed, radius).items()
        }
        taken |= {(edge.source, edge.label): edge.seconds for edge in floor.graph.edges if edge.seconds is not None}
    else:
        taken = _driven(floor, speed, radius)
    graph = floor.graph
    seconds = np.full((len(graph.nodes), len(graph.labels)), np.nan)
    for (source, label), time in taken.items():
        seconds[graph.names.index(source), graph.labels.index(label)] = time
    least = np.nanmin(seconds) if np.isfinite(seconds).any() else 1.0
    for row in seconds:
        known = row[np.isfinite(row)]
        row[np.isnan(row)] = known.min() if len(known) else least
    return seconds


def _driven(floor: Map, speed: float, radius: float) -> dict[tuple[str, str], float]:
    """Return the seconds that each way takes that is driven, by the place where it begins and its label."""
    if floor.grid is None:
        raise MapError("the lengths of ways need a map with a grid")
    paths = Paths(floor.grid.frame, drivable(floor.grid, radius))
    goals = {}
    for node in floor.graph.nodes:
        try:
            goals[node.name] = paths.cell(node.goal.x, node.goal.y)
        except MapError:
            raise MapError(f"a robot with a radius of {radius:g} m does not fit at the goal of {node.name!r}") from None
    taken = {}
    for edge in floor.graph.edges:
        length = paths.length(goals[edge.source], goals[edge.target])
        if not math.isfinite(length):
            raise MapError(f"there is no path from {edge.source!r} to {edge.target!r} for a robot of {radius:g} m")
        taken[edge.source, edge.label] = max(length, floor.grid.frame.resolution) / speed
    return taken


def durations(model: FactoredMDP | FactoredPOMDP, seconds: npt.NDArray[np.float64], *, stages: int = 4) -> Durations:
    """Return how long the actions of a floor's model take, for solving in real time.

    Args:
        model: A model from `model`.
        seconds: Of each place and label, as of `arrivals`; one more action, which stays, takes the mean of them.
        stages: How little they vary: the standard deviation is the mean divided by the root of this.

    Raises:
        MapError: If the seconds are those of another map.
        ModelError: If they are not above 0, or the stages no whole number from 1.
    """
    actions = len(model.action_space)
    places = len(model.state_space.factors[0])
    if np.ndim(seconds) != 2 or len(seconds) != places or np.shape(seconds)[1] not in {actions - 1, actions}:
        raise MapError(
            f"the seconds have the shape {np.shape(seconds)}; the model has {places} places, {actions} actions"
        )
    means = np.full((len(seconds), actions), seconds.mean())
    means[:, : seconds.shape[1]] = seconds
    each = len(model.state_space) // len(seconds)
    return Durations(np.repeat(means, each, axis=0), stages)


def sightings(floor: Map | Floors, noise: float, *, radius: float = 0.25) -> Vector:
    """Return P(place that is seen | place): a robot may be anywhere in a place, and its poses have a normal error.

    Poses outside all places are left out, in proportion: rows sum to 1.

    Args:
        floor: The map, or several floors; where it has a grid, a robot is only where it fits. Of a floor's places none
            is seen from another one.
        noise: The standard deviation of its poses in each direction, in metres.
        radius: Of the robot, in metres.

    Raises:
        MapError: If the noise is negative, or a place has no room for the robot.
    """
    if not is_number(noise) or not (math.isfinite(noise) and noise >= 0):
        raise MapError(f"a noise of {noise!r} is no standard deviation: give metres, 0 or more")
    check_metres(radius, "the radius")
    if isinstance(floor, Floors):
        seen: Vector = scipy.linalg.block_diag(*(_seen(each, noise, radius) for each in floor.maps.values()))
        return seen
    return _seen(floor, noise, radius)


def _seen(floor: Map, noise: float, radius: float) -> Vector:
    labels = floor.labels
    across = math.hypot(*labels.frame.shape) * labels.frame.resolution
    if noise > across:
        raise MapError(f"a noise of {noise:g} m is more than the map is across, {across:.1f} m: give metres")
    fits = np.ones(labels.frame.shape, dtype=bool) if floor.grid is None else floor.grid.fits(radius)
    cells = noise / labels.frame.resolution
    seen = np.zeros((len(floor.graph.nodes), len(floor.graph.nodes)))
    blurred = [
        scipy.ndimage.gaussian_filter(labels.cells(name).astype(np.float64), cells, mode="constant", truncate=_REACH)
        for name in floor.graph.names
    ]
    for place, name in enumerate(floor.graph.names):
        inside = labels.cells(name) & fits
        if not inside.any():
            raise MapError(f"a robot with a radius of {radius:g} m fits nowhere in {name!r}")
        seen[place] = [mask[inside].mean() for mask in blurred]
    seen /= seen.sum(axis=1, keepdims=True)
    return seen
