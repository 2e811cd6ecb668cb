"""A replay: the stimuli of a record are given to the same system again, in virtual time, and its decisions compared.

Timers and their consequences come about as they did, for a turn has the time of its stimulus and a timer its due
time. Users' functions are not called: stand-ins last as long as they did, and publish the same messages.
"""

from __future__ import annotations

import asyncio
import sys
from bisect import bisect_left
from collections import defaultdict
from typing import TYPE_CHECKING

import msgspec

from mdm.errors import Error
from mdm.recording import Record
from mdm.recording.part import Gap
from mdm.recording.recorder import environment
from mdm.replay.driver import Driver, ReplayClock
from mdm.replay.exchange import Exchange, Limit, Otherwise, ReplayTransport, Traffic
from mdm.replay.player import Difference, Player
from mdm.runtime import Actor, Runtime, run
from mdm.stimuli import Began, Finished, Joined, Received, Unsent

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from mdm.actors import PredicateManager
    from mdm.messages import Decision, PredicateUpdate, StateChange
    from mdm.recording.reader import Recorded
    from mdm.stimuli import Stimulus

_BITS = ("numpy", "numba", "blas", "machine")


class Replayed(msgspec.Struct, frozen=True):
    """The result of a replay.

    Attributes:
        recorded: How many decisions the record has by the time at which the run began to end.
        replayed: How many were made.
        differences: Those that were not the same, the first one first.
        exact: Whether numbers were compared bit by bit, for the environment is that of the record; else to 1e-9.
        lost: How many messages the record lacks.
        gap: The first place at which it lacks some: messages behind it are not replayed, nor counted here.
        different: How many were not the same, also where not all of them are kept.
        stopped: Whether it stopped at the last difference that was asked for, before the end of the record.
        limit: Of an agent of a team that is replayed with another configuration, from when on nothing can be told, and
            why, where that is so: all numbers are of the time before.
    """

    recorded: int
    replayed: int
    differences: tuple[Difference, ...]
    exact: bool
    lost: int
    different: int = 0
    limit: Limit | None = None
    stopped: bool = False
    gap: Gap | None = None

    @property
    def same(self) -> bool:
        """Whether all decisions were the same, up to the gap where there is one."""
        return not self.differences and self.limit is None


class Together(msgspec.Struct, frozen=True):
    """The result of the replay of a team.

    Attributes:
        agents: The result of each agent's.
        received: How many messages came from agents that were replayed, too, as long as their records go.
        unlike: Those of them that the replay of their sender had not sent by then.
        unrepeated: How many more came on channels of the program's own, of which a replay runs nothing.
        strange: How many came from agents in lives of which there is no record here, by agent.
        traffic: All that was sent, for `replay_together` with another configuration; None of such a replay itself.
    """

    agents: dict[str, Replayed]
    received: int
    unlike: tuple[Received, ...]
    unrepeated: int
    strange: dict[str, int] = {}
    traffic: Traffic | None = None

    @property
    def same(self) -> bool:
        """Whether all decisions were the same, and all messages were sent."""
        return not self.unlike and all(each.same for each in self.agents.values())


def check_beginning(record: Record) -> None:
    """Refuse a record in which no actor starts: there is nothing to run once more.

    Raises:
        Error: If it has no beginning.
    """
    if not any(isinstance(each.message, Began) for each in _unbroken(record, "stimuli")):
        raise _no_beginning(record)


def transports_of(record: Record) -> dict[str, ReplayTransport]:
    """Return the transports of the recorded agents of teams, by agent: their members are to be built with these.

    Raises:
        Error: If the record has no beginning.
    """
    if "stimuli" not in record.topics:
        raise _no_beginning(record)
    joined: dict[str, Joined] = {}
    unsent: dict[str, set[int]] = defaultdict(set)
    for topic, _, _, data in record.raw(["stimuli"]):
        if b'"joined"' not in data and b'"unsent"' not in data:
            continue  # most are decoded for nothing
        stimulus = record.decode(topic, data)
        if isinstance(stimulus, Joined):
            joined.setdefault(stimulus.agent, stimulus)
        elif isinstance(stimulus, Unsent):
            unsent[stimulus.agent].add(stimulus.number)
    return {
        agent: ReplayTransport(agent, first.incarnation, frozenset(unsent[agent]), first.protocol)
        for agent, first in joined.items()
    }


def replay(
    record: Record | str | Path,
    actors: Actor | Sequence[Actor],
    *,
    most: int = 100,
    transports: Mapping[str, ReplayTransport] = {},
    listen: Callable[[Runtime], object] = lambda _: None,
    by_time: bool = False,
) -> Replayed:
    """Run a record once more, in virtual time, and compare every decision.

    Args:
        record: The record, or its file.
        actors: The system, or the actors at the top, built as for the run and not started. The functions of actions are
            not called. A world needs a seed; actors of one's own that set sensors are left out.
        most: How many differences are kept; at the last of them the replay ends.
        transports: Of agents of a team, those that `transports_of` returned, with which their members were built.
        listen: Called with the runtime before it begins, to subscribe to channels that the record does not keep.
        by_time: Compare decisions with those of their time, as of another configuration, and not of their number.

    Raises:
        Error: If the record has no beginning, or an actor ticks at times at which it did not.
    """
    run_again = _Again(record if isinstance(record, Record) else Record(record), actors, transports, most, by_time)

    async def main() -> None:
        await run_again.play(listen)

    run(main, virtual=True)
    run_again.check_ticks()
    return run_again.replayed()


def replay_predicates(
    record: Record, actors: Actor, manager: PredicateManager, transports: Mapping[str, ReplayTransport] = {}
) -> tuple[Replayed, list[tuple[int, dict[str, bool | None]]]]:
    """Replay a record; return the result, and all values of predicates at a start, and those that change, by times."""
    found: list[tuple[int, dict[str, bool | None]]] = []

    def update(message: PredicateUpdate) -> None:
        changed = dict.fromkeys(message.rising, True) | dict.fromkeys(message.falling, False)
        found.append((message.time, changed | dict.fromkeys(message.unknown)))

    def start(change: StateChange) -> None:
        if change.actor == manager.path and change.state == "running":
            if not found:  # and not at a restart
                manager.updates.subscribe(update)
            found.append((change.time, manager.values()))

    return replay(record, actors, most=1, transports=transports, listen=lambda of: of.lives.subscribe(start)), found


def replay_together(
    records: Mapping[str, Record],
    actors: Mapping[str, Actor | Sequence[Actor]],
    transports: Mapping[str, Mapping[str, ReplayTransport]],
    *,
    most: int = 100,
    as_recorded: Together | None = None,
) -> Together:
    """Run the records of a team's agents once more, all in one process, and compare every decision.

    A message that one agent received of another is sent by the other's replay. It comes when the record says that it
    came, and the one replay waits until the other has sent it.

    Agents of another configuration, one for all, are compared with those that ran: so the team would have decided on
    the input of its sensors as it was. Their messages take the places of those that were sent, with their delays and
    losses. Where an agent would have sent otherwise, at another time or under another key, nothing is told any more of
    it, nor of the others once they may have received that: `Replayed.limit` says from when on.

    Args:
        records: By agent, or any name of theirs.
        actors: Of each, as for `replay`.
        transports: Of each, those that `transports_of` returned.
        most: How many differences of each are kept.
        as_recorded: Of actors with another configuration than the run's, the replay of the same records with that.

    Raises:
        Error: If a record has no beginning, two are of one agent in the same life, or the replay of the records as they
            are was not the same.
    """
    exchange: Exchange | Otherwise
    exchange = Exchange() if as_recorded is None else Otherwise(_traffic(as_recorded))
    all_of_them = sys.maxsize if as_recorded is not None else most
    runs = {name: _Again(record, actors[name], transports[name], all_of_them) for name, record in records.items()}
    for name, each in runs.items():
        exchange.add(name, each.stimuli, transports[name], each.clock.now)

    async def play(name: str, each: _Again) -> None:
        try:
            await each.play()
        finally:
            exchange.leave(name)

    async def main() -> None:
        await asyncio.gather(*(play(name, each) for name, each in runs.items()))

    run(main, virtual=True)
    if isinstance(exchange, Otherwise):
        limits = exchange.limits()
        return Together({name: each.replayed(limits.get(name), most) for name, each in runs.items()}, 0, (), 0)
    replayed = {name: each.replayed() for name, each in runs.items()}
    unlike = tuple(exchange.unlike)
    return Together(replayed, exchange.received, unlike, exchange.unrepeated, exchange.strange, exchange.traffic)


def _traffic(as_recorded: Together) -> Traffic:
    """Return the messages of agents of the configuration that they had.

    Raises:
        Error: If they did not decide and send as recorded: then nothing is known of others.
    """
    if as_recorded.traffic is None or not as_recorded.same:
        raise Error(
            "the records are not repeated as they are, with the configuration that they had: what another one would "
            "have decided cannot be told"
        )
    return as_recorded.traffic


class _Again:
    """A record and its actors, which is run once more."""

    def __init__(
        self,
        record: Record,
        actors: Actor | Sequence[Actor],
        transports: Mapping[str, ReplayTransport],
        most: int,
        by_time: bool = False,
    ) -> None:
        check_beginning(record)
        self.stimuli, decisions = _contents(record)
        self._record, self._transports, self._most = record, transports, most
        self._tops = [actors] if isinstance(actors, Actor) else list(actors)
        now = environment()
        self.clock = ReplayClock(int(record.head["epoch"]))
        self._exact = all(record.head.get(name) == now[name] for name in _BITS)
        tolerance = 0.0 if self._exact else 1e-9
        self._player = Player(
            self.stimuli, decisions, tolerance=tolerance, most=most, now=self.clock.now, by_time=by_time
        )
        for name, facts in record.metadata.items():
            if name.startswith("ensemble ") and "draws" in facts:
                self._player.draw_from(name.removeprefix("ensemble "), facts["draws"])

    async def play(self, listen: Callable[[Runtime], object] = lambda _: None) -> None:
        """Run it."""
        runtime = Runtime(clock=self.clock, log=False, watchdog=None, signals=False)
        runtime.dispatcher.choices = self._player
        watching = runtime.observe(self._player)
        listen(runtime)
        driver = Driver(runtime, self._player, self.clock, self._tops, self._transports)
        await driver.play(self.stimuli, self._most)
        if watching.error is not None:
            raise watching.error

    def check_ticks(self) -> None:
        """Refuse actors whose ticks the record does not have.

        Raises:
            Error: If there is one.
        """
        if unticked := self._player.unticked():
            raise Error(
                f"{self._record.path}: {unticked}: its decisions at other times cannot be known; "
                f"give it the rate of the run"
            )

    def replayed(self, limit: Limit | None = None, most: int = sys.maxsize) -> Replayed:
        """Return the result, up to a limit; with so many differences."""
        player = self._player
        made, expected, found, by = len(player.made), player.count, player.differences, player.found
        record, last = self._record, self.stimuli[-1].time
        if record.gap is not None or record.torn is not None:  # decisions on the last input may be lost
            ends = [each.recorded is None and at >= last for each, at in zip(found, by, strict=True)]
            made -= sum(ends)
            found = [each for each, end in zip(found, ends, strict=True) if not end]
            by = [at for at, end in zip(by, ends, strict=True) if not end]
        if limit is not None:
            made = bisect_left(player.made, limit.time)
            expected = bisect_left(player.paired, limit.time) + sum(at < limit.time for at in player.missed_by)
            found = [each for each, at in zip(found, by, strict=True) if at < limit.time]
        kept = tuple(found[:most])
        stopped = player.stopped and bool(found)
        return Replayed(expected, made, kept, self._exact, record.lost, len(found), limit, stopped, record.gap)


def _no_beginning(record: Record) -> Error:
    if record.gap is not None and record.gap.since is None:
        return Error(f"{record.path}: the first messages of the record are lost: without them nothing can be replayed")
    return Error(f"{record.path}: the record has no beginning: nothing in it says when an actor started")


def _contents(record: Record) -> tuple[list[Stimulus], list[tuple[Decision, int, int]]]:
    """Return the stimuli, and the decisions as a player takes them.

    Decisions behind the run's end are none of them, though the time of their stimulus may lie before it.
    """
    stimuli: list[Stimulus] = []
    decisions: list[tuple[Decision, int, int]] = []
    waiting: list[Decision] = []
    has_finished = False
    for each in _unbroken(record, "stimuli", "decisions"):
        if each.topic == "decisions":
            if not has_finished:
                waiting.append(each.message)
            continue
        place = len(stimuli)
        stimuli.append(each.message)
        has_finished = has_finished or isinstance(each.message, Finished)
        decisions += [(decision, max(decision.time, each.message.time), place) for decision in waiting]
        waiting.clear()
    last = stimuli[-1].time if stimuli else 0
    decisions += [(decision, max(decision.time, last), len(stimuli)) for decision in waiting]
    return stimuli, decisions


def _unbroken(record: Record, *topics: str) -> Iterator[Recorded]:
    """Yield the messages up to the first one that is missing: those behind it follow from that."""
    for each in record.messages(_there(record, *topics)):
        if record.gap is not None and each.sequence > record.gap.sequence:
            return
        yield each


def _there(record: Record, *topics: str) -> list[str]:
    """Return those topics that a record has: one torn at its start has none."""
    return [topic for topic in topics if topic in record.topics]
