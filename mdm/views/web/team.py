"""All agents of a team on one page: a client of each agent's own page, whose frames it lays beside each other.

Each agent is a process with a page of its own. Their times are brought together by the wall clocks at which they began.
"""

from __future__ import annotations

import asyncio
import time as times
from collections import deque
from contextlib import suppress
from math import inf
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.errors import Error
from mdm.snapshots import EnsembleFrame, Event, Frame, Ring, Scene
from mdm.snapshots.events import ROOM, predicate_event
from mdm.snapshots.frame import Judgement, StatisticsFrame
from mdm.snapshots.judgement import RULES, worst_first
from mdm.snapshots.picture import Picture
from mdm.snapshots.why import Why
from mdm.version import __version__
from mdm.views.web.client import Socket, opened
from mdm.views.web.session import Allowance

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from mdm.snapshots import RecordedRun
    from mdm.snapshots.frame import EnsembleScene, FloorScene, PredicateScene
    from mdm.snapshots.recorded import Course

_GONE = EnsembleFrame("stopped", 0.0)
_AGAIN = 0.5
_WAITS = 5.0
_SILENT = 5.0
"""Seconds without a frame, or without a first one, after which an agent counts as lost: its process may be there."""
_VALID = 2.5
"""Seconds after which an agent carries out a command no more: fewer than its answer is waited for."""


class _Told(msgspec.Struct, frozen=True):
    """A message of an agent's page."""

    scene: Scene | None = None
    frame: Frame | None = None
    events: tuple[Event, ...] = ()
    cursor: int = 0
    why: Why | None = None
    pictures: tuple[Picture, ...] = ()
    ensemble: str = ""
    done: str = ""
    refused: str = ""


_decode = msgspec.json.Decoder(_Told).decode
_encode = msgspec.json.encode


class _Agent:
    """An agent, by its page."""

    def __init__(self, name: str, address: str, team: TeamRun) -> None:
        self.name = name
        self.scene: Scene | None = None
        self.frame: Frame | None = None
        self._address = address
        self._team = team
        self._cursor = 0
        # When the process began whose events were heard, and the number of the last: each who comes hears all of them
        # again. And whether the events say that the agent has gone.
        self._heard = (0, 0)
        self.is_gone = False
        self.since = 0.0  # when it went, or the page began
        self._socket: Socket | None = None
        self._whys: deque[asyncio.Future[_Told]] = deque()
        self._commands: deque[asyncio.Future[_Told]] = deque()
        self._allowance = Allowance(4, 8)  # less than the agent's own page allows, which ends the talk

    async def follow(self) -> None:
        """Look at the agent, and again whenever it restarts."""
        while True:
            with suppress(Error, OSError, msgspec.MsgspecError):
                async with opened(self._address) as socket:
                    self._socket, self._cursor = socket, 0
                    await self._look(socket)
            if self.frame is not None:
                self._tell(None)
            self._socket = self.frame = None
            for asked in (*self._whys, *self._commands):
                asked.cancel()
            self._whys.clear()
            self._commands.clear()
            await asyncio.sleep(_AGAIN)

    async def _look(self, socket: Socket) -> None:
        while True:
            try:
                async with asyncio.timeout(_SILENT):
                    received = await socket.receive()
            except TimeoutError:
                socket.abort()  # a process that is held would not take leave
                return
            told = _decode(received)
            if told.scene is not None:
                self.scene, self.frame = told.scene, None  # the last frame is of the scene before
                self._team.generation += 1
            elif told.frame is not None:
                self.frame = told.frame
                self._hear(told)
                if self.is_gone:
                    self._tell(told.frame)
            else:  # each kind is answered in the order in which it was asked
                asked = self._commands if told.done or told.refused else self._whys
                if asked and not (first := asked.popleft()).done():
                    first.set_result(told)
            if told.scene is not None or told.frame is not None:
                close = [path for path in self._team.close if path in self.paths]
                await socket.say({"say": "drawn", "cursor": self._cursor, "close": close})

    def _tell(self, frame: Frame | None) -> None:
        """Tell by events how the agent is that was gone; None where it goes, so that nothing is known from now on."""
        assert self.scene is not None
        self.is_gone = frame is None
        self.since = now = self._team.now
        ring, scene = self._team.ring, self.scene
        gone = "" if frame else f"agent {self.name!r} does not answer"
        modes = [each.mode for each in frame.ensembles] if frame else ["stopped"] * len(scene.ensembles)
        for ensemble, mode in zip(scene.ensembles, modes, strict=True):
            ring.add(now, "mode", ensemble.path, mode, detail=gone)
        values = frame.predicates if frame else [None] * len(scene.predicates)
        for predicate, value in zip(scene.predicates, values, strict=True):
            ring.keep(predicate_event(now, self.name, _shown(self.name, predicate.name), value))

    def _hear(self, told: _Told) -> None:
        assert self.scene is not None
        for event in told.events:
            if self.scene.began == self._heard[0] and event.number <= self._heard[1]:
                continue
            self._heard = (self.scene.began, event.number)
            name = _shown(self.name, event.name) if event.kind == "predicate" else event.name
            self._team.ring.keep(msgspec.structs.replace(event, time=event.time + self.ahead, name=name))
        self._cursor = told.cursor

    @property
    def paths(self) -> frozenset[str]:
        """The paths of its ensembles."""
        return frozenset() if self.scene is None else frozenset(each.path for each in self.scene.ensembles)

    @property
    def ahead(self) -> float:
        """Seconds from the beginning of the team's page to its own second 0."""
        return 0.0 if self.scene is None else (self.scene.began - self._team.began) / 1e9

    async def tell(self, **asked: Any) -> _Told:
        """Return the answer to a question about an ensemble.

        Raises:
            Error: If the agent does not answer.
        """
        try:
            return await self._ask(self._whys, asked)
        except TimeoutError:
            raise Error(f"agent {self.name!r} does not answer") from None

    async def command(self, message: dict[str, Any]) -> None:
        """Carry out a command.

        Raises:
            Error: If the agent refuses it, does not answer in time, or too many commands came.
        """
        if not self._allowance.take():
            raise Error(f"too many commands for agent {self.name!r}: wait a second")
        before = times.time_ns() + round(1e9 * _VALID)
        socket = self._socket
        try:
            told = await self._ask(self._commands, {**message, "before": before})
        except TimeoutError:
            if socket is not None and socket is self._socket:
                socket.abort()  # it counts as lost until it answers again, and later answers are to later questions
            raise Error(
                f"agent {self.name!r} does not answer; what it gets to know later it will not carry out"
            ) from None
        if told.refused:
            raise Error(told.refused)

    async def _ask(self, asked: deque[asyncio.Future[_Told]], message: dict[str, Any]) -> _Told:
        if self._socket is None:
            raise Error(f"agent {self.name!r} does not run, or its page does not answer")
        future: asyncio.Future[_Told] = asyncio.get_running_loop().create_future()
        asked.append(future)
        async with asyncio.timeout(_WAITS):
            await self._socket.say(message)
            await asyncio.wait([future])
        if future.cancelled():
            raise Error(f"agent {self.name!r} has ended, or has closed its page, before it answered")
        return future.result()


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
        judgements=tuple(
            [
                replace(each, since=each.since + by, until=None if each.until is None else each.until + by)
                for each in frame.judgements
            ]
        ),
    )


def _shown(agent: str, predicate: str) -> str:
    return f"{agent}: {predicate}"


def _together(
    scenes: Iterable[tuple[str, Scene]],
) -> tuple[tuple[EnsembleScene, ...], tuple[PredicateScene, ...], tuple[FloorScene, ...]]:
    """Return the ensembles, predicates and floors of agents' scenes as those of one."""
    ensembles: list[EnsembleScene] = []
    predicates: list[PredicateScene] = []
    floors: list[FloorScene] = []
    for name, scene in scenes:
        before = len(ensembles)
        ensembles += [
            each if each.parent < 0 else msgspec.structs.replace(each, parent=each.parent + before)
            for each in scene.ensembles
        ]
        predicates += [msgspec.structs.replace(each, name=_shown(name, each.name)) for each in scene.predicates]
        floors += [floor for floor in scene.floors if floor not in floors]
    return tuple(ensembles), tuple(predicates), tuple(floors)


def _judged(found: Iterable[Judgement], ensembles: Collection[EnsembleFrame]) -> tuple[tuple[Judgement, ...], str]:
    """Return the judgements of agents as those of one, each once as it comes last, and the worst in words."""
    once = {(each.rule, each.of, each.subject, each.until is None): each for each in found}
    stopped = bool(ensembles) and all(each.mode == "stopped" for each in ensembles)
    return worst_first(once.values(), stopped=stopped)


class RecordedTeam:
    """The records of a team's agents, for those who look at them together; each began by its own wall clock.

    Args:
        runs: The record of each agent, by its name.
        title: The title of the team.

    Raises:
        Error: If two of them have the same ensemble, as records of several robots do.

    Attributes:
        first: The first second.
        last: The last one.
        generation: Of how many readings of the records it is.
    """

    def __init__(self, runs: Mapping[str, RecordedRun], *, title: str) -> None:
        self._runs = runs
        self._title = title
        scenes = {name: run.scene() for name, run in runs.items()}
        self._began = min(scene.began for scene in scenes.values())
        self._ahead = {name: (scene.began - self._began) / 1e9 for name, scene in scenes.items()}
        self._home: dict[str, str] = {}
        for name, scene in scenes.items():
            for each in scene.ensembles:
                if (other := self._home.setdefault(each.path, name)) != name:
                    raise Error(
                        f"{title}: the records of {other} and {name} both have an ensemble {each.path!r}: they are of "
                        f"several runs or robots, which are shown one by one"
                    )
        self.first, self.last = 0.0, max(run.last + self._ahead[name] for name, run in runs.items())
        self.generation = sum(run.generation for run in runs.values())

    def scene(self) -> Scene:
        """Return the scenes of all agents as one."""
        scenes = {name: run.scene() for name, run in self._runs.items()}
        ensembles, predicates, floors = _together(scenes.items())
        facts = {"began": self._began, "first": 0.0, "last": self.last, "floors": floors}
        remarks = tuple([f"{name}: {remark}" for name, scene in scenes.items() for remark in scene.remarks])
        pending = any(scene.pending for scene in scenes.values())
        one = next(iter(scenes.values()))
        about = {"title": self._title, "ensembles": ensembles, "predicates": predicates}
        return msgspec.structs.replace(one, **about, **facts, remarks=remarks, pending=pending)

    def frame(self, seconds: float, close: Collection[str] = ()) -> Frame:
        """Return how all agents were at a time; one that had not begun yet, or whose record breaks off, as stopped."""
        time = min(max(seconds, self.first), self.last)
        frames: list[Any] = []
        values: list[bool | None] = []
        for name, run in self._runs.items():
            found = _shifted(run.frame(time - self._ahead[name], close), self._ahead[name])
            if time < self._ahead[name]:
                found = msgspec.structs.replace(found, ensembles=(_GONE,) * len(found.ensembles), judgements=())
                values += [None] * len(found.predicates)
            elif (end := self._breaks(name)) < time:
                gone = EnsembleFrame("stopped", end)
                found = msgspec.structs.replace(found, ensembles=(gone,) * len(found.ensembles))
                values += [None] * len(found.predicates)
            else:
                values += found.predicates
            frames.append(found)
        ensembles = tuple([each for frame in frames for each in frame.ensembles])
        judgements, headline = _judged([each for frame in frames for each in frame.judgements], ensembles)
        return Frame(
            time,
            ensembles,
            tuple(values),
            tuple([each for frame in frames for each in frame.changed]),
            details={path: each for frame in frames for path, each in frame.details.items()},
            robots=tuple([each for frame in frames for each in frame.robots]),
            judgements=judgements,
            headline=headline,
        )

    def lanes(
        self, first: float, last: float, paths: Collection[str], predicates: Collection[str], most: int
    ) -> list[Event]:
        """Return lanes as `RecordedRun.lanes` does, of all agents."""
        found: list[Event] = []
        for name, run in self._runs.items():
            by, begin = self._ahead[name], f"{name}: "
            own = [each.removeprefix(begin) for each in predicates if each.startswith(begin)]
            if last >= by:
                found += self._moved(name, run.lanes(first - by, last - by, tuple(paths), own, most))
            if (end := self._breaks(name)) < min(last, self.last):
                ended = f"the record of {name!r} ends here, before its run did"
                home = [path for path in paths if self._home.get(path) == name]
                found += [Event(0, end, "mode", path, "stopped", ended) for path in home]
                found += [predicate_event(end, name, _shown(name, each), None) for each in own]
        return found

    def _breaks(self, name: str) -> float:
        """Return when an agent's record ends, where that is before its run did; infinity of any other."""
        run = self._runs[name]
        return run.last + self._ahead[name] if run.breaks else inf

    def _moved(self, name: str, events: Iterable[Event]) -> list[Event]:
        by = self._ahead[name]
        return [
            msgspec.structs.replace(
                each, time=each.time + by, name=_shown(name, each.name) if each.kind == "predicate" else each.name
            )
            for each in events
        ]

    def after(self, cursor: int, most: int, *, rare: bool = False) -> tuple[list[bytes], int]:
        """Return the first events behind a cursor, as `RecordedRun.after` does, of all agents."""
        found: list[Event] = []
        for name, run in self._runs.items():
            encoded, _ = run.after(0, 1 << 62, rare=rare)
            found += self._moved(name, [msgspec.json.decode(each, type=Event) for each in encoded])
        found.sort(key=lambda each: each.time)
        told = found[cursor : cursor + most]
        return [_encode(each) for each in told], cursor + len(told)

    def step(self, kind: Any, seconds: float, *, back: bool = False) -> float:
        """Return the time of the next event of a kind of any agent, or of the one before."""
        found = []
        for name, run in self._runs.items():
            by = self._ahead[name]
            if seconds < by and not back and run.step(kind, 1e-9, back=True) == run.first:
                at = by  # as it began
            else:
                at = run.step(kind, seconds - by, back=back) + by
            if round(1e9 * (seconds - at if back else at - seconds)) > 0:  # it is the same where there is none
                found.append(at)
        return (max(found) if back else min(found)) if found else seconds

    def _run_of(self, ensemble: str) -> tuple[RecordedRun, float]:
        name = self._home.get(ensemble) or next(iter(self._runs))  # which says that there is no such one
        return self._runs[name], self._ahead[name]

    async def course(self, ensemble: str, first: float, last: float) -> Course | None:
        """Return how an ensemble's decisions went; None where there is no such one."""
        run, by = self._run_of(ensemble)
        found = await run.course(ensemble, first - by, last - by)
        return found and msgspec.structs.replace(found, times=tuple([time + by for time in found.times]))

    async def explain(self, ensemble: str, seconds: float | None = None) -> Why | None:
        """Return why an ensemble decided as it did; None where there is no such one."""
        run, by = self._run_of(ensemble)
        return await run.explain(ensemble, None if seconds is None else seconds - by)

    async def draw(
        self, ensemble: str, seconds: float | None = None, opened: Collection[int] = ()
    ) -> tuple[Picture, ...]:
        """Return pictures of an ensemble at a time; none where there is no such one."""
        run, by = self._run_of(ensemble)
        return await run.draw(ensemble, None if seconds is None else seconds - by, opened)


class TeamRun:
    """The agents of a team, for those who look at them together.

    Args:
        pages: The address of each agent's page, with its secret.
        title: The title of the team.
        control: Whether commands are taken, which each agent's page has to allow, too.

    Attributes:
        ring: The events of all agents.
        generation: Counts the scenes.
        close: The paths of ensembles that are looked at closely.
        began: When the page began, in nanoseconds since 1970.
    """

    def __init__(self, pages: Mapping[str, str], *, title: str = "", control: bool = False) -> None:
        self.ring = Ring()
        self.generation = 0
        self.close: tuple[str, ...] = ()
        self.began = times.time_ns()
        self._title = title
        self._control = control
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

    @property
    def now(self) -> float:
        """Seconds since the page began."""
        return (times.time_ns() - self.began) / 1e9

    def _known(self) -> list[tuple[_Agent, Scene]]:
        return [(agent, agent.scene) for agent in self._agents if agent.scene is not None]

    def scene(self) -> Scene:
        """Return the scenes of all agents as one."""
        ensembles, predicates, floors = _together([(agent.name, scene) for agent, scene in self._known()])
        return Scene(
            version=__version__,
            source="live",
            title=self._title,
            began=self.began,
            first=0.0,
            last=0.0,
            ensembles=ensembles,
            predicates=predicates,
            floors=floors,
            control=self._control,
            room=ROOM,
        )

    def frame(self, close: Collection[str] = ()) -> Frame:
        """Return how all agents are; of one that does not run, as stopped."""
        self.close = tuple(close)
        frames: list[Any] = []
        facts: dict[str, Any] = {"details": {}, "robots": (), "team": {}, "missing": ()}
        values: list[bool | None] = []
        changed: list[float] = []
        counted = facts["statistics"] = StatisticsFrame({}, {}, {})
        judgements: list[Judgement] = []
        severity, _, remedy = RULES["apart"]
        for agent in self._agents:
            scene, frame = agent.scene, agent.frame
            if agent.is_gone or (scene is None and self.now >= _SILENT):
                told = "does not answer" if scene is not None else "has not answered yet"
                judgements.insert(0, Judgement("apart", agent.name, "", severity, 1, agent.since, told, "", remedy))
            if scene is None:
                facts["missing"] += (agent.name,)
                facts["team"][f"agent {agent.name}"] = {"link": "none yet", "process": "has not answered yet"}
                continue
            if frame is None:
                facts["missing"] += (agent.name,)
                frames += [_GONE] * len(scene.ensembles)
                values += [None] * len(scene.predicates)
                changed += [0.0] * len(scene.predicates)
                facts["team"][f"agent {agent.name}"] = {"link": "lost", "process": "does not answer"}
                continue
            shifted = _shifted(frame, agent.ahead)
            judgements += shifted.judgements
            frames += shifted.ensembles
            values += shifted.predicates
            changed += shifted.changed
            facts["details"] |= shifted.details
            facts["robots"] += shifted.robots
            facts["team"] |= {f"{key} ({agent.name})": words for key, words in shifted.team.items()}
            if frame.statistics is not None:
                counted.counts.update({f"{key} ({agent.name})": n for key, n in frame.statistics.counts.items()})
                counted.latencies.update(frame.statistics.latencies)
                counted.ended.update(frame.statistics.ended)
        facts["judgements"], facts["headline"] = _judged(judgements, frames)
        return Frame(self.now, tuple(frames), tuple(values), tuple(changed), **facts)

    def encoded(self, close: Collection[str] = ()) -> bytes:
        """Return how all agents are, as JSON."""
        return _encode(self.frame(close))

    def _agent_of(self, ensemble: str) -> _Agent:
        for agent in self._agents:
            if ensemble in agent.paths:
                return agent
        raise Error(f"there is no ensemble {ensemble!r}")

    async def command(self, command: str, ensemble: str) -> None:
        """Command an ensemble, by its agent.

        Raises:
            Error: If there is no such ensemble, or its agent refuses the command, or does not answer in time.
        """
        await self._agent_of(ensemble).command({"say": "command", "command": command, "ensemble": ensemble})

    async def sense(self, predicate: str, value: bool | None) -> None:
        """Set a predicate, by its name in the scene, at its agent.

        Raises:
            Error: If there is no such predicate, or its agent refuses to set it, or does not answer in time.
        """
        for agent, scene in self._known():
            for each in scene.predicates:
                if _shown(agent.name, each.name) == predicate:
                    await agent.command({"say": "sense", "predicate": each.name, "value": value})
                    return
        raise Error(f"there is no predicate {predicate!r}")

    async def explain(self, ensemble: str, time: float | None = None) -> Why | None:
        """Return why an ensemble has decided, as its agent says."""
        try:
            return (await self._agent_of(ensemble).tell(say="why", ensemble=ensemble, time=time)).why
        except Error as error:
            return Why(f"Nothing tells why: {error}.")

    async def draw(self, ensemble: str, time: float | None = None, opened: Collection[int] = ()) -> tuple[Picture, ...]:
        """Return the pictures of an ensemble, as its agent draws them."""
        try:
            return (
                await self._agent_of(ensemble).tell(say="draw", ensemble=ensemble, time=time, opened=opened)
            ).pictures
        except Error as error:
            return (Picture("no picture", (str(error),)),)
