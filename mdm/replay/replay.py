"""A replay: the stimuli of a record are given to the same system anew, in virtual time, and its decisions compared.

Timers and what follows from them come about as they did, for a turn has the time of its stimulus and a timer its due
time. Users' functions are not called: stand-ins last as long as they did, and say what they said.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import msgspec

from mdm import messages
from mdm.errors import Error
from mdm.messages import Control, Decision, Tick
from mdm.recording import Record
from mdm.recording.recorder import environment
from mdm.recording.stimuli import Began, Ended, Finished, Said, Ticked
from mdm.replay.clock import ReplayClock
from mdm.replay.difference import Difference
from mdm.replay.player import Player
from mdm.replay.stand_in import AsRecordedError
from mdm.runtime import Actor, Runtime, run

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from mdm.recording.stimuli import Stimulus

__all__ = ["Replayed", "replay"]

_PATIENCE = 3600.0
"""Seconds of virtual time within which an actor that the record has comes to its start."""
_BITS = ("numpy", "numba", "blas", "machine")


class Replayed(msgspec.Struct, frozen=True):
    """What became of a replay.

    Attributes:
        recorded: How many decisions the record has.
        replayed: How many were made.
        differences: Those that were not the same, the first one first.
        exact: Whether numbers were compared bit by bit, for the environment is that of the record; else to 1e-9.
        lost: How many messages the record lacks: behind such a gap a replay differs.
    """

    recorded: int
    replayed: int
    differences: tuple[Difference, ...]
    exact: bool
    lost: int

    @property
    def same(self) -> bool:
        """Whether all decisions were the same."""
        return not self.differences


def replay(record: Record | str | Path, actors: Actor | Sequence[Actor], *, most: int = 100) -> Replayed:
    """Run what a record has once more, in virtual time, and compare every decision.

    Args:
        record: The record, or its file.
        actors: The system, or the actors at the top, built as for the run and not started. Their functions are not
            called.
        most: How many differences are kept; at the last of them the replay ends.

    Raises:
        Error: If the record has no beginning.
    """
    found = record if isinstance(record, Record) else Record(record)
    tops = [actors] if isinstance(actors, Actor) else list(actors)
    stimuli, decisions = _contents(found)
    if not any(isinstance(stimulus, Began) for stimulus in stimuli):
        raise Error(f"{found.path}: the record has no beginning: nothing in it says when an actor started")
    now = environment()
    exact = all(found.head.get(name) == now[name] for name in _BITS)
    player = Player(stimuli, decisions, tolerance=0.0 if exact else 1e-9, most=most)
    clock = ReplayClock(int(found.head["epoch"]))

    async def main() -> None:
        runtime = Runtime(clock=clock, log=False, watchdog=None, signals=False)
        runtime.dispatcher.tape = player
        runtime.dispatcher.unlimited = True
        async with _Entered(runtime, player, clock, tops, stimuli, most):
            pass

    run(main, virtual=True)
    return Replayed(player.count, player.made, tuple(player.differences), exact, found.lost)


def _contents(record: Record) -> tuple[list[Stimulus], list[Decision]]:
    stimuli: list[Stimulus] = []
    decisions: list[Decision] = []
    topics = [topic for topic in ("stimuli", "decisions") if topic in record.topics]
    for each in record.messages(topics):
        (stimuli if each.topic == "stimuli" else decisions).append(each.message)
    return stimuli, decisions


class _Entered:
    """A runtime that is entered while its record is played: its own start is in the record, too."""

    def __init__(
        self,
        runtime: Runtime,
        player: Player,
        clock: ReplayClock,
        tops: list[Actor],
        stimuli: list[Stimulus],
        most: int,
    ) -> None:
        self._runtime, self._player, self._clock = runtime, player, clock
        self._tops, self._stimuli, self._most = tops, stimuli, most
        player.say = self._say

    async def __aenter__(self) -> None:
        driver = asyncio.create_task(self._drive())
        async with self._runtime:
            starts = [asyncio.create_task(self._runtime.start(top)) for top in self._tops]
            try:
                await driver
            finally:
                for start in starts:
                    start.cancel()
                await asyncio.gather(*starts, return_exceptions=True)
                self._runtime.dispatcher.tape = None

    async def __aexit__(self, *_: object) -> None:
        """Leave."""

    # -- Stimuli -----------------------------------------------------------------------------------------------------

    async def _drive(self) -> None:
        """Give the stimuli, each at its time."""
        player = self._player
        try:
            for stimulus in self._stimuli:
                await self._move_to(stimulus.time)
                if isinstance(stimulus, Finished) or len(player.differences) >= self._most:
                    break
                player.since.append(stimulus)
                await self._give(stimulus)
            if len(player.differences) < self._most:
                player.missed(self._clock.now())
        finally:
            for stand_in, work in player.stand_ins.values():
                if not work.done:
                    stand_in.end()
            player.release()

    async def _move_to(self, time: int) -> None:
        """Let timers fire that are due by then; what they begin takes its first step."""
        while self._clock.step(time):
            await self._settle()

    async def _settle(self) -> None:
        while any(not work.begun and not work.done for _, work in self._player.fresh):  # noqa: ASYNC110 - likewise
            await asyncio.sleep(0)
        self._player.fresh.clear()

    async def _give(self, stimulus: Stimulus) -> None:
        player = self._player
        if isinstance(stimulus, Began):
            await player.admit(stimulus, _PATIENCE)
        elif isinstance(stimulus, Said) and stimulus.where == "task":
            found = player.stand_ins.get((stimulus.ensemble, stimulus.life))
            if found is not None and not found[1].done:
                await found[0].do(lambda: self._say(stimulus))
            else:
                self._say(stimulus)
        elif isinstance(stimulus, Said) and stimulus.where != "call":
            self._say(stimulus)
        elif isinstance(stimulus, Ticked):
            ticker = player.tickers.get(stimulus.actor)
            if ticker is not None:
                ticker.tick(Tick(stimulus.time, stimulus.number, 0, stimulus.missed))
        elif isinstance(stimulus, Ended):
            await self._end(stimulus)
        await self._settle()

    async def _end(self, ended: Ended) -> None:
        found = self._player.stand_ins.get((ended.ensemble, ended.life))
        if found is None or found[1].done:
            return
        stand_in, work = found
        work.interrupted = ended.interrupted
        error: BaseException | None = None
        if ended.error is not None:
            error = AsRecordedError(ended.error)
        elif ended.cancelled and not ended.interrupted:
            error = asyncio.CancelledError()
        stand_in.end(error)
        await work.over

    def _say(self, said: Said) -> None:
        """Publish what was said, on its channel, in the present turn or as the beginning of one."""
        kind = getattr(messages, said.type, None)
        if kind is None or not isinstance(said.message, kind):
            return  # of a type that only the program knew
        if kind is Control and self._command(said):
            return
        for channel in self._runtime.channels:
            if channel.name == said.channel:
                channel.publish(said.message)
                return

    def _command(self, said: Said) -> bool:
        """Give an ensemble a command, by which one that has not started keeps it; return whether there is one."""
        ensemble: Any = _actor_at(self._runtime.root, said.channel.rpartition("/")[0])
        if not hasattr(ensemble, "publish_state"):
            return False
        command = said.message.command
        if command == "resume":
            ensemble.start(resume=True)
        else:
            getattr(ensemble, command)()
        return True


def _actor_at(root: Actor, path: str) -> Actor | None:
    waiting = [root]
    while waiting:
        actor = waiting.pop()
        if actor.path == path and actor is not root and hasattr(actor, "publish_state"):
            return actor
        waiting += actor.children
    return None
