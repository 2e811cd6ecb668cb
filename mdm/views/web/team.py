"""All agents of a team on one page: a client of each agent's own page, whose frames it lays beside each other.

Each agent is a process with a page of its own. Their times are brought together by the wall clocks at which they began.
"""

from __future__ import annotations

import asyncio
import time as times
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.errors import Error
from mdm.snapshots import EnsembleFrame, Event, Frame, Ring, Scene
from mdm.snapshots.why import Why
from mdm.version import __version__
from mdm.views.web.client import Socket, opened

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from mdm.snapshots.scene import EnsembleScene, FloorScene, PredicateScene

__all__ = ["TeamRun"]

_GONE = EnsembleFrame("stopped", 0.0)
_AGAIN = 0.5
_WAITS = 5.0


class _Told(msgspec.Struct, frozen=True):
    """A message of an agent's page."""

    scene: Scene | None = None
    frame: Frame | None = None
    events: tuple[Event, ...] = ()
    cursor: int = 0
    why: Why | None = None
    ensemble: str = ""


_decode = msgspec.json.Decoder(_Told).decode
_encode = msgspec.json.encode


class _Agent:
    """An agent, as far as its page has told of it."""

    def __init__(self, name: str, address: str, team: TeamRun) -> None:
        self.name = name
        self.scene: Scene | None = None
        self.frame: Frame | None = None
        self._address = address
        self._team = team
        self._cursor = 0
        self._socket: Socket | None = None
        self._asked: asyncio.Future[_Told] | None = None

    async def follow(self) -> None:
        """Look at the agent, again and again where it starts anew."""
        while True:
            with suppress(Error, OSError):
                async with opened(self._address) as socket:
                    self._socket, self._cursor = socket, 0
                    await self._look(socket)
            self._socket = self.frame = None
            await asyncio.sleep(_AGAIN)

    async def _look(self, socket: Socket) -> None:
        while True:
            told = _decode(await socket.receive())
            if told.scene is not None:
                self.scene = told.scene
                self._team.generation += 1
            elif told.frame is not None:
                self.frame = told.frame
                self._hear(told)
            elif self._asked is not None and not self._asked.done():
                self._asked.set_result(told)
            if told.scene is not None or told.frame is not None:
                close = [path for path in self._team.close if path in self.paths]
                await socket.say({"say": "drawn", "cursor": self._cursor, "close": close})

    def _hear(self, told: _Told) -> None:
        for event in told.events:
            facts = msgspec.structs.asdict(event)
            time, kind, source, name = (facts.pop(key) for key in ("time", "kind", "source", "name"))
            facts.pop("number")
            if kind == "predicate":
                name = f"{self.name}: {name}"  # as the scene of the team names it
            self._team.ring.add(time + self.ahead, kind, source, name, **facts)
        self._cursor = told.cursor

    @property
    def paths(self) -> frozenset[str]:
        """The paths of its ensembles."""
        return frozenset() if self.scene is None else frozenset(each.path for each in self.scene.ensembles)

    @property
    def ahead(self) -> float:
        """Seconds from the beginning of the team's page to its own second 0."""
        return 0.0 if self.scene is None else (self.scene.began - self._team.began) / 1e9

    async def ask(self, message: dict[str, Any]) -> _Told:
        """Say something, and return what is answered.

        Raises:
            Error: If the agent does not answer.
        """
        if self._socket is None:
            raise Error(f"agent {self.name!r} does not run")
        self._asked = asyncio.get_running_loop().create_future()
        await self._socket.say(message)
        try:
            return await asyncio.wait_for(self._asked, _WAITS)
        except TimeoutError:
            raise Error(f"agent {self.name!r} does not answer") from None


def _shifted(frame: Frame, by: float) -> Frame:
    """Return a frame with all its times later by some seconds."""
    replace = msgspec.structs.replace
    ensembles = [
        replace(
            each,
            since=each.since + by,
            idle=None if each.idle is None else each.idle + by,
            causes=tuple([replace(cause, since=cause.since + by) for cause in each.causes]),
            live=tuple([replace(life, since=life.since + by) for life in each.live]),
        )
        for each in frame.ensembles
    ]
    details = {
        path: replace(
            each,
            decided=None if each.decided is None else each.decided + by,
            observations=tuple([(time + by, name) for time, name in each.observations]),
        )
        for path, each in frame.details.items()
    }
    return replace(
        frame,
        time=frame.time + by,
        ensembles=tuple(ensembles),
        changed=tuple([time + by for time in frame.changed]),
        details=details,
    )


class TeamRun:
    """The agents of a team, for those who look at them together.

    Args:
        pages: The address of each agent's page, with its secret.
        title: What the team is called.

    Attributes:
        ring: The events of all agents.
        generation: Counts the scenes.
        close: The paths of ensembles that are looked at closely.
        began: When the page began, in nanoseconds since 1970.
    """

    def __init__(self, pages: Mapping[str, str], *, title: str = "") -> None:
        self.ring = Ring()
        self.generation = 0
        self.close: tuple[str, ...] = ()
        self.began = times.time_ns()
        self._title = title
        self._agents = [_Agent(name, address, self) for name, address in pages.items()]
        self._tasks: list[asyncio.Task[None]] = []

    def open(self) -> None:
        """Begin to look at the agents."""
        self._tasks = [asyncio.get_running_loop().create_task(agent.follow()) for agent in self._agents]

    async def stop(self) -> None:
        """Look at them no more."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _known(self) -> list[tuple[_Agent, Scene]]:
        return [(agent, agent.scene) for agent in self._agents if agent.scene is not None]

    def scene(self) -> Scene:
        """Return what there is of all agents."""
        ensembles: list[EnsembleScene] = []
        predicates: list[PredicateScene] = []
        floors: list[FloorScene] = []
        for agent, scene in self._known():
            before = len(ensembles)
            ensembles += [
                each if each.parent < 0 else msgspec.structs.replace(each, parent=each.parent + before)
                for each in scene.ensembles
            ]
            predicates += [
                msgspec.structs.replace(each, name=f"{agent.name}: {each.name}", settable=False)
                for each in scene.predicates
            ]
            floors += [floor for floor in scene.floors if floor not in floors]
        return Scene(
            *(__version__, "live", self._title, self.began, 0.0, 0.0, tuple(ensembles), tuple(predicates)),
            floors=tuple(floors),
        )

    def frame(self, close: Collection[str] = ()) -> Frame:
        """Return how all agents are; of one that does not run, as stopped."""
        self.close = tuple(close)
        frames: list[Any] = []
        facts: dict[str, Any] = {"details": {}, "robots": (), "team": {}}
        values: list[bool | None] = []
        changed: list[float] = []
        for agent, scene in self._known():
            frame = agent.frame
            if frame is None or len(frame.ensembles) != len(scene.ensembles):
                frames += [_GONE] * len(scene.ensembles)
                values += [None] * len(scene.predicates)
                changed += [0.0] * len(scene.predicates)
                facts["team"][f"agent {agent.name}"] = {"link": "lost", "process": "does not answer"}
                continue
            shifted = _shifted(frame, agent.ahead)
            frames += shifted.ensembles
            values += shifted.predicates
            changed += shifted.changed
            facts["details"] |= shifted.details
            facts["robots"] += shifted.robots
            facts["team"] |= {f"{key} ({agent.name})": told for key, told in shifted.team.items()}
        now = (times.time_ns() - self.began) / 1e9
        return Frame(now, tuple(frames), tuple(values), tuple(changed), **facts)

    def encoded(self, close: Collection[str] = ()) -> bytes:
        """Return how all agents are, as JSON."""
        return _encode(self.frame(close))

    def _agent_of(self, ensemble: str) -> _Agent:
        for agent in self._agents:
            if ensemble in agent.paths:
                return agent
        raise Error(f"there is no ensemble {ensemble!r}")

    async def explain(self, ensemble: str, time: float | None = None) -> Why | None:
        """Return why an ensemble has decided, as its agent says."""
        try:
            return (await self._agent_of(ensemble).ask({"say": "why", "ensemble": ensemble, "time": time})).why
        except Error as error:
            return Why(f"Nothing tells why: {error}.")
