"""Rock sample: a rover that tells good rocks from bad ones at a distance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from mdm.checks import is_whole
from mdm.errors import ModelError
from mdm.models import Factor, FactoredPOMDP, Node, Potential, Space, Table, Tree, TwoSliceNetwork
from mdm.problems.parameters import checked

Place = tuple[int, int]

_MAPS: dict[Place, Sequence[Place]] = {
    (7, 8): [(2, 0), (0, 1), (3, 1), (6, 3), (2, 4), (3, 4), (5, 5), (1, 6)],
    (10, 10): [(0, 3), (0, 7), (1, 8), (3, 3), (3, 8), (4, 3), (5, 8), (6, 1), (9, 3), (9, 9)],
    (11, 11): [(0, 3), (0, 7), (1, 8), (2, 4), (3, 3), (3, 8), (4, 3), (5, 8), (6, 1), (9, 3), (9, 9)],
}
"""The rocks' positions in published instances, by size and number."""

_STEPS = {"north": (0, 1), "east": (1, 0), "south": (0, -1), "west": (-1, 0)}
_ACTION, _ROBOT, _ROBOT_THEN = Node("action", 0), Node("state", 0), Node("next_state", 0)


@checked
def rock_sample(
    size: int = 7,
    rocks: int = 8,
    *,
    positions: Sequence[Place] | None = None,
    start: Place | None = None,
    half_distance: float = 20.0,
    discount: float = 0.95,
) -> FactoredPOMDP:
    """Return rock sample: a rover on a square field samples rocks that may be good or bad, and leaves to the east.

    Moves are certain. Sampling a good rock pays 10 and makes it bad, sampling a bad one pays -10. Checking a rock tells
    whether it is good; it is right with a probability of (1 + 2^(-distance / half distance)) / 2. Leaving to the east
    pays 10 and ends the problem; leaving elsewhere, or sampling where no rock is, pays -100 and ends it, too.

    (size^2 + 1) x 2^rocks states (the rover's cell or the end, fully observed, and each rock's quality), rocks + 5
    actions, 2 observations: 12 800, 13 and 2 by default. The paper counts one state for the end, 12 545 in all.

    Source: T. Smith and R. Simmons, *Heuristic search value iteration for POMDPs*, Uncertainty in Artificial
    Intelligence, 2004, section 5.2.

    Args:
        size: How many cells the field has on each side.
        rocks: How many rocks there are.
        positions: For each rock its cell, as columns from the west and rows from the south, from 0. By default those of
            the published instances (7, 8), (10, 10) and (11, 11); for others they are drawn at random, but always the
            same.
        start: The rover's first cell; by default the middle of the west side.
        half_distance: The distance at which a check's efficiency 2^(-distance / half distance) is one half.
        discount: In (0, 1].

    Raises:
        ModelError: If there is no room for the rocks, or positions do not fit.
    """
    field = _Field(size, rocks, positions, start, half_distance)
    checks = [f"check-{rock}" for rock in range(rocks)]
    seen = Node("observation", 0)
    nothing = Table([seen], [1.0, 0.0])
    told: list[Potential] = [Table([_ROBOT_THEN, _rock_then(rock), seen], field.sight(rock)) for rock in range(rocks)]
    looks = [0, 0, 0, 0, *range(1, rocks + 1), 0]
    network = _network(field, checks, Space.single("rover", ["good", "bad"]), [Tree(_ACTION, looks, [nothing, *told])])
    return FactoredPOMDP(network, discount=discount)


@checked
def field_vision_rock_sample(
    size: int = 5,
    rocks: int = 5,
    *,
    positions: Sequence[Place] | None = None,
    start: Place | None = None,
    half_distance: float = 20.0,
    discount: float = 0.95,
) -> FactoredPOMDP:
    """Return field vision rock sample: as `rock_sample`, but the rover sees every rock after every action.

    There are no checks. Each rock looks good or bad, independently, and rightly so with the probability of a check.

    (size^2 + 1) x 2^rocks states, 5 actions, 2^rocks observations: 832, 5 and 32 by default. The paper counts one
    state for the end, 801 in all.

    Source: S. Ross and B. Chaib-draa, *AEMS: an anytime online search algorithm for approximate policy refinement in
    large POMDPs*, International Joint Conference on Artificial Intelligence, 2007, section 5.

    Args:
        size: How many cells the field has on each side.
        rocks: How many rocks there are.
        positions: For each rock its cell, as for `rock_sample`.
        start: The rover's first cell; by default the middle of the west side.
        half_distance: At which distance the efficiency of the sight is one half.
        discount: In (0, 1].

    Raises:
        ModelError: If there is no room for the rocks, or positions do not fit.
    """
    field = _Field(size, rocks, positions, start, half_distance)
    seen = Space([Factor(f"sight-{rock}", ["good", "bad"]) for rock in range(rocks)])
    sights: list[Potential] = [
        Table([_ROBOT_THEN, _rock_then(rock), Node("observation", rock)], field.sight(rock)) for rock in range(rocks)
    ]
    return FactoredPOMDP(_network(field, [], seen, sights), discount=discount)


def _is_place(given: object) -> bool:
    return isinstance(given, Sequence) and len(given) == 2 and all(map(is_whole, given))


class _Field:
    """Where the rover may be and where the rocks are; after the cells comes the end."""

    def __init__(
        self, size: int, rocks: int, positions: Sequence[Place] | None, start: Place | None, half_distance: float
    ) -> None:
        if size < 1 or not 1 <= rocks <= size * size:
            raise ModelError(f"a field of {size} x {size} cells has no room for {rocks} rocks; it needs at least one")
        if not half_distance > 0:
            raise ModelError(f"the half distance is a number above 0, not {half_distance}")
        if positions is None:
            drawn = np.random.default_rng(0).choice(size * size, rocks, replace=False).tolist()
            positions = _MAPS.get((size, rocks), [divmod(cell, size) for cell in drawn])
        if not isinstance(positions, Sequence) or not all(map(_is_place, positions)):
            raise ModelError(f"positions are a list of pairs of whole numbers, not {positions!r}")
        if start is not None and not _is_place(start):
            raise ModelError(f"the start is a pair of whole numbers, not {start!r}")
        if len(positions) != rocks or len(set(map(tuple, positions))) != rocks:
            raise ModelError(f"{rocks} rocks need as many positions, each another one, not {list(positions)}")
        self.size = size
        self.half_distance = half_distance
        self.end = size * size
        self.rocks = [self._cell(place, "a rock") for place in positions]
        self.start = self._cell((0, size // 2) if start is None else start, "the start")

    def _cell(self, place: Place, what: str) -> int:
        if not all(0 <= number < self.size for number in place):
            raise ModelError(f"{what} is at {tuple(place)}, outside the field of {self.size} x {self.size} cells")
        return place[0] * self.size + place[1]

    @property
    def names(self) -> list[str]:
        """The names of the cells, and of the end."""
        return [f"x{x}-y{y}" for x in range(self.size) for y in range(self.size)] + ["end"]

    def moved(self, step: Place) -> npt.NDArray[np.intp]:
        """Return where a step leads from each cell and from the end."""
        x, y = np.divmod(np.arange(self.end), self.size)
        x, y = x + step[0], y + step[1]
        inside = (x >= 0) & (x < self.size) & (y >= 0) & (y < self.size)
        return np.append(np.where(inside, x * self.size + y, self.end), self.end)

    def sight(self, rock: int) -> npt.NDArray[np.float64]:
        """Return the probabilities of "good" and "bad" for a rock: cells and the end x its quality x observations."""
        x, y = np.divmod(np.arange(self.end), self.size)
        rock_x, rock_y = divmod(self.rocks[rock], self.size)
        right = (1 + 2 ** (-np.hypot(x - rock_x, y - rock_y) / self.half_distance)) / 2
        table = np.empty((self.end + 1, 2, 2))
        table[:-1, 0, 0] = table[:-1, 1, 1] = 1 - right
        table[:-1, 0, 1] = table[:-1, 1, 0] = right
        table[-1] = [1, 0]
        return table


def _rock_then(rock: int) -> Node:
    return Node("next_state", 1 + rock)


def _network(field: _Field, checks: list[str], seen: Space, observation: list[Potential]) -> TwoSliceNetwork:
    """Return a network of the moves, the checks that there are, and sampling, in this order."""
    count = len(field.rocks)
    cells = field.end + 1
    identity = np.eye(cells)
    rock = [Node("state", 1 + number) for number in range(count)]
    moved = [field.moved(step) for step in _STEPS.values()]
    stays = np.where(np.isin(np.arange(cells), field.rocks), np.arange(cells), field.end)
    targets = [*moved, stays, np.arange(cells)]
    kinds = [0, 1, 2, 3, *[5] * len(checks), 4]  # of the actions: four moves, sampling, checking
    sampling = [0] * (4 + len(checks)) + [1]
    transitions: list[Potential] = [
        Tree(_ACTION, kinds, [Table([_ROBOT, _ROBOT_THEN], identity[target]) for target in targets])
    ]
    for number, at in enumerate(field.rocks):
        kept = Table([rock[number], _rock_then(number)], np.eye(2))
        sampled = Table([_rock_then(number)], [1.0, 0.0])
        here = (np.arange(cells) == at).astype(int).tolist()
        transitions.append(Tree(_ACTION, sampling, [kept, Tree(_ROBOT, here, [kept, sampled])]))
    # What moves pay: leaving to the east, leaving elsewhere.
    leaves = [(target == field.end) & (np.arange(cells) < field.end) for target in moved]
    pays: list[Potential] = [
        Table([_ROBOT], np.where(left, 10.0 if name == "east" else -100.0, 0.0))
        for name, left in zip(_STEPS, leaves, strict=True)
    ]
    worth: list[Potential] = [Table([node], [-10.0, 10.0]) for node in rock]
    there = np.zeros(cells, dtype=int)  # no rock, the end, or which rock
    there[field.end] = 1
    there[field.rocks] = 2 + np.arange(count)
    fine, nothing = Table([_ROBOT], np.full(cells, -100.0)), Table([_ROBOT], np.zeros(cells))
    sample = Tree(_ROBOT, there.tolist(), [fine, nothing, *worth])
    return TwoSliceNetwork(
        Space([Factor("rover", field.names), *(Factor(f"rock-{number}", ["bad", "good"]) for number in range(count))]),
        Space.single("rover", [*_STEPS, *checks, "sample"]),
        seen,
        initial=[Table([_ROBOT], identity[field.start]), *(Table([node], [0.5, 0.5]) for node in rock)],
        transitions=transitions,
        observation=observation,
        utilities=[Tree(_ACTION, kinds, [*pays, sample, nothing])],
        fully_observed=[True] + [False] * count,
    )
