"""A picture of a run: its scene, which stays and is sent once, and frames of all that changes, at one time each.

Times are in seconds since the run's second 0.
"""

from __future__ import annotations

from typing import Literal

import msgspec


class CauseFrame(msgspec.Struct, frozen=True):
    """A cause of a safe mode: its kind, in words, since when, and its remedy."""

    kind: str
    detail: str
    since: float
    remedy: str = ""


class LifeFrame(msgspec.Struct, frozen=True):
    """A live action: its name and since when; ``remaining`` in metres where a drive tells it."""

    action: str
    since: float
    remaining: float | None = None


class EnsembleFrame(msgspec.Struct, frozen=True, omit_defaults=True):
    """How an ensemble is.

    Attributes:
        mode: ``stopped``, ``deciding`` or ``safe``.
        since: The mode's beginning.
        causes: Why it is safe.
        waiting: The names of missing inputs or pauses that keep it from deciding.
        idle: Since when it has had nothing to do; None where it has.
        live: Its live actions.
        epoch: The number of its last decision; -1 before the first.
        action: The last decided action.
        decisions: How many there were.
        wanted: The action in whose place a shield has taken the last one; empty where it has not.
    """

    mode: str
    since: float
    causes: tuple[CauseFrame, ...] = ()
    waiting: tuple[str, ...] = ()
    idle: float | None = None
    live: tuple[LifeFrame, ...] = ()
    epoch: int = -1
    action: str = ""
    decisions: int = 0
    wanted: str = ""


class Marginal(msgspec.Struct, frozen=True):
    """The probabilities of a factor's symbols, the likeliest where there are many."""

    factor: str
    symbols: tuple[str, ...]
    values: tuple[float, ...]
    rest: float = 0.0


class GridFrame(msgspec.Struct, frozen=True):
    """Probabilities over the cells of a grid, row by row from the top, by the names of its factors."""

    down: str
    across: str
    rows: int
    columns: int
    values: tuple[float, ...]


class BeliefFrame(msgspec.Struct, frozen=True, omit_defaults=True):
    """A belief: its likeliest states by names, the rest of the others, the number of states, and marginals of factors.

    ``entropy`` is in bits. Of many states, ``octaves`` has how many there are of a probability up to each power of 2,
    the least first, and how much of the belief they have together.
    """

    top: tuple[tuple[str, float], ...]
    rest: float
    states: int
    entropy: float
    marginals: tuple[Marginal, ...] = ()
    grid: GridFrame | None = None
    octaves: tuple[tuple[float, int, float], ...] = ()


class Detail(msgspec.Struct, frozen=True, omit_defaults=True):
    """An ensemble at close range.

    Attributes:
        state: The state decided on, by its name.
        factors: The values of its factors, None where one is unknown.
        observation: The last observation, by name.
        cause: Why the last decision was made then, in words, where that is known.
        decided: When that was.
        reward: The expected reward of the last decision.
        value: The expected return from here on, where the policy tells it.
        belief: The belief that was decided on.
        search: The counts of the search that decided.
        observations: The last observations by name with their times, the newest last.
        tally: How often each observation came, the most frequent first.
    """

    state: str | None = None
    factors: tuple[tuple[str, str | None], ...] = ()
    observation: str | None = None
    cause: str = ""
    decided: float | None = None
    reward: float | None = None
    value: float | None = None
    belief: BeliefFrame | None = None
    search: str = ""
    observations: tuple[tuple[float, str], ...] = ()
    tally: tuple[tuple[str, int], ...] = ()


class Judgement(msgspec.Struct, frozen=True, omit_defaults=True):
    """A judgement: something is wrong in a run, or worth a look.

    Attributes:
        rule: Its name among `mdm.snapshots.judgement.RULES`.
        of: The path of the ensemble that it is of; else the predicate, the agent or the actor.
        subject: The action or the factor that it is of; empty where it is of the whole.
        severity: ``wrong``, or ``look`` where it is worth a look.
        count: How often.
        since: In seconds since the run's second 0.
        text: In words, without `of` and `since`.
        evidence: The evidence, in words.
        remedy: A sentence on where to look.
        until: When it was over; None while it lasts.
    """

    rule: str
    of: str
    subject: str
    severity: str
    count: int
    since: float
    text: str
    evidence: str = ""
    remedy: str = ""
    until: float | None = None

    def __str__(self) -> str:
        until = "" if self.until is None else f" until {clock(self.until)}"
        return f"{self.of}: {self.text}, since {clock(self.since)}{until}"


def clock(seconds: float) -> str:
    """Return seconds as minutes and seconds, such as ``01:07.5``."""
    tenths = round(max(0.0, seconds) * 10)
    return f"{tenths // 600:02}:{tenths % 600 // 10:02}.{tenths % 10}"


class RobotFrame(msgspec.Struct, frozen=True):
    """A robot on a floor: row and column of its raster, radians; where it is, and the place that it heads for."""

    row: float
    column: float
    yaw: float
    floor: str = ""
    place: str | None = None
    goal: str | None = None


class Spread(msgspec.Struct, frozen=True):
    """A histogram of latencies in seconds: upper bounds of the buckets that have any, with their counts."""

    count: int
    half: float
    most: float
    maximum: float
    buckets: tuple[tuple[float, int], ...]


class StatisticsFrame(msgspec.Struct, frozen=True):
    """Counts and latencies, told once a second.

    Attributes:
        counts: By their names, such as drops, turns, stalls of the loop.
        latencies: By ensemble, from stimulus to callback, of those at close range.
        ended: By ensemble, how many actions have ended in which way.
    """

    counts: dict[str, float]
    latencies: dict[str, Spread]
    ended: dict[str, dict[str, int]]


class Frame(msgspec.Struct, frozen=True, omit_defaults=True):
    """How everything is at one time.

    Attributes:
        time: Of the frame.
        ensembles: In the order of the scene.
        predicates: The value of each in the order of the scene.
        changed: When each last changed, as far as it was seen.
        details: Of the ensembles at close range, by path.
        robots: Where the robot is.
        statistics: Once a second.
        team: Of a team, agents and links, in words by key.
        missing: Of a team, the agents that do not answer, or have not answered yet.
        judgements: Those by then, the worst first, at most 100; those that are over with when that was.
        headline: The worst in words; empty where nothing is named.
    """

    time: float
    ensembles: tuple[EnsembleFrame, ...]
    predicates: tuple[bool | None, ...]
    changed: tuple[float, ...]
    details: dict[str, Detail] = {}
    robots: tuple[RobotFrame, ...] = ()
    statistics: StatisticsFrame | None = None
    team: dict[str, dict[str, str]] = {}
    missing: tuple[str, ...] = ()
    judgements: tuple[Judgement, ...] = ()
    headline: str = ""


class FactorScene(msgspec.Struct, frozen=True):
    """A factor of states.

    Attributes:
        name: Its name.
        symbols: The names of its symbols, where there are few enough to list.
        told_by: The predicates that tell it, where an ensemble has a state layer and they are few.
    """

    name: str
    symbols: tuple[str, ...]
    told_by: tuple[str, ...] = ()


class EnsembleScene(msgspec.Struct, frozen=True):
    """An ensemble.

    Attributes:
        path: Its path among actors.
        parent: The place of the ensemble above it in the scene; -1 at the top.
        bound: The action of that one that it is bound to; empty at the top.
        summary: The kind of its process, in a few words.
        actions: The names of its actions, in their order.
        states: How many states there are; 0 where that is not known.
        factors: The factors of its states.
        grid: Whether two factors of the states are the rows and columns of a grid.
    """

    path: str
    parent: int
    bound: str
    summary: str
    actions: tuple[str, ...] = ()
    states: int = 0
    factors: tuple[FactorScene, ...] = ()
    grid: bool = False


class PredicateScene(msgspec.Struct, frozen=True):
    """A predicate: its name, how it is defined, and whether the page may set it, for no sensor tells it."""

    name: str
    definition: str
    settable: bool = False


class PlaceScene(msgspec.Struct, frozen=True):
    """A place of a floor: its name, and its goal by rows and columns of the raster, with fractions."""

    name: str
    row: float
    column: float


class WayScene(msgspec.Struct, frozen=True):
    """A way from a place to another one, by their names, with its label."""

    source: str
    target: str
    label: str


class FloorScene(msgspec.Struct, frozen=True):
    """A floor: its raster, and the places on it.

    Attributes:
        name: Empty where there is but one.
        rows: Of the raster, from top to bottom.
        columns: Of the raster, from left to right.
        metres: The width of a cell.
        raster: A byte a cell, row by row: 0 of no place, 255 occupied, else the place's number from 1 on.
        places: The places with their goals, in the order of their numbers.
        ways: The ways between them.
    """

    name: str
    rows: int
    columns: int
    metres: float
    raster: bytes
    places: tuple[PlaceScene, ...]
    ways: tuple[WayScene, ...]


class Scene(msgspec.Struct, frozen=True):
    """A run, as far as it stays as it is.

    Attributes:
        version: Of the library; a page of another one loads again.
        source: A running system, or a record.
        title: Of the run, such as a file's name.
        began: The time in nanoseconds since 1970 of second 0, 0 where that is not known.
        first: Of a record, its first second.
        last: Of a record, its last second.
        ensembles: All ensembles, each behind the one above it.
        predicates: All predicates.
        floors: The floors of the robot's map.
        control: Whether commands are taken.
        remarks: Warnings about the run, such as that its record is torn.
        pending: Whether more will be known of it soon: ask again.
        room: How many events of a kind are kept, or told; of a record, in how many ``part`` its lanes are told at most.
    """

    version: str
    source: Literal["live", "record"]
    title: str
    began: int
    first: float
    last: float
    ensembles: tuple[EnsembleScene, ...]
    predicates: tuple[PredicateScene, ...]
    floors: tuple[FloorScene, ...] = ()
    control: bool = False
    remarks: tuple[str, ...] = ()
    pending: bool = False
    room: dict[str, int] = {}
