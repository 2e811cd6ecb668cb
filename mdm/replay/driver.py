"""What plays a record: it starts the actors that a run has started, and gives them each stimulus at its time."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from mdm import messages
from mdm.messages import Tick
from mdm.recording.stimuli import Began, Cut, Ended, Failed, Finished, Resumed, Said, Ticked, count_messages
from mdm.replay.exchange import PartedError
from mdm.replay.input import give
from mdm.replay.stand_in import AsRecordedError
from mdm.replay.teammates import Teammates
from mdm.runtime.actor import descendants

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mdm.recording.stimuli import Stimulus
    from mdm.replay.clock import ReplayClock
    from mdm.replay.player import Player
    from mdm.replay.transport import ReplayTransport
    from mdm.runtime import Actor, Runtime

__all__ = ["Driver"]

_PATIENCE = 3600.0
"""Seconds of virtual time within which an actor that the record has comes to its start."""
_BREATH = 100
"""Stimuli after which the event loop turns once."""


class Driver:
    """Plays a record.

    Args:
        runtime: The runtime, not entered yet: its own start is in the record, too.
        player: The tape of the runtime.
        clock: The clock of the runtime.
        tops: The actors at the top.
        transports: Those of agents of a team, by agent.
    """

    def __init__(
        self,
        runtime: Runtime,
        player: Player,
        clock: ReplayClock,
        tops: Sequence[Actor],
        transports: Mapping[str, ReplayTransport],
    ) -> None:
        self._runtime, self._player, self._clock, self._tops = runtime, player, clock, tops
        self._teammates = Teammates(runtime, player, transports)
        self._program: list[asyncio.Task[None]] = []
        self._stops: dict[str, asyncio.Task[None]] = {}
        player.say = self._say
        runtime.dispatcher.watch = self._watch

    async def play(self, stimuli: Sequence[Stimulus], most: int) -> None:
        """Play all stimuli, or those up to the last difference that is to be found."""
        driver = asyncio.create_task(self._drive(stimuli, most))
        async with self._runtime:
            program = self._program
            program += [asyncio.create_task(self._runtime.start(top)) for top in self._tops]
            try:
                await driver
            finally:
                for task in program:
                    task.cancel()
                await asyncio.gather(*program, return_exceptions=True)
                self._runtime.dispatcher.tape = None

    async def _drive(self, stimuli: Sequence[Stimulus], most: int) -> None:
        """Give the stimuli, each at its time."""
        player = self._player
        try:
            for place, stimulus in enumerate(stimuli):
                if not place % _BREATH:
                    await asyncio.sleep(0)  # so that signals are heard
                while self._clock.step(stimulus.time):
                    await self._settle()
                player.comes_to(place)
                if isinstance(stimulus, Finished) or len(player.differences) >= most:
                    break
                player.since.append(stimulus)
                try:
                    await self._give(stimulus)
                except PartedError:
                    break
                await self._settle()
            player.missed(self._clock.now(), overdue=len(player.differences) >= most)
        finally:
            player.release()
            self._runtime.dispatcher.resume_later()

    async def _settle(self) -> None:
        while any(not work.begun and not work.done for _, work in self._player.fresh):  # noqa: ASYNC110 - likewise
            await asyncio.sleep(0)
        self._player.fresh.clear()

    async def _give(self, stimulus: Stimulus) -> None:
        if isinstance(stimulus, Began):
            self._ask(stimulus)
            await self._player.admit(stimulus, _PATIENCE)
        elif isinstance(stimulus, Failed):
            self._fail(stimulus)
        elif isinstance(stimulus, Said):
            await self._repeat(stimulus)
        elif isinstance(stimulus, Ticked):
            self._player.ticks += 1
            ticker = self._player.tickers.get((stimulus.actor, stimulus.rate))
            if ticker is not None:
                ticker.tick(Tick(stimulus.time, stimulus.number, 0, stimulus.missed))
        elif isinstance(stimulus, Ended):
            await self._end(stimulus)
        elif isinstance(stimulus, Cut | Resumed):
            self._cut_or_resume(stimulus)
        else:
            await self._teammates.give(stimulus)

    def _cut_or_resume(self, stimulus: Cut | Resumed) -> None:
        """Have a turn that is cut short go on; forget a cut to whose place no turn has come."""
        cuts, dispatcher = self._player.cuts, self._runtime.dispatcher
        if isinstance(stimulus, Resumed):
            if dispatcher.active:
                dispatcher.resume(stimulus.time, starved=stimulus.starved)
        elif cuts and cuts[0] is stimulus:
            cuts.popleft()

    # -- Actors ------------------------------------------------------------------------------------------------------

    def _ask(self, began: Began) -> None:
        """Stop or start anew an actor at the top, where the program has done so."""
        for top in self._tops:
            if top.path == began.actor and not top.failing:
                if began.step == "stop" and top.life == "running":
                    self._stops[top.path] = stop = asyncio.create_task(self._runtime.stop(top))
                    self._program.append(stop)
                elif began.step == "start" and top.life in {"stopping", "stopped", "failed"}:
                    self._program.append(asyncio.create_task(self._start_again(top)))

    async def _start_again(self, top: Actor) -> None:
        """Start an actor, once it has stopped: that takes some rounds of the event loop."""
        stop = self._stops.pop(top.path, None)
        if stop is not None:
            await asyncio.wait([stop])
        await self._runtime.start(top)

    def _fail(self, failed: Failed) -> None:
        """Have an actor fail, unless it has with another, or by itself."""
        actor = next((one for one in descendants(self._runtime.root) if one.path == failed.actor), None)
        if actor is not None and not actor.failing:
            actor.fail(AsRecordedError(failed.error))

    async def _end(self, ended: Ended) -> None:
        """Have the task of an action end as it did."""
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

    # -- What was said -----------------------------------------------------------------------------------------------

    async def _repeat(self, said: Said) -> None:
        """Publish what was said outside of turns; what was said within one has its place there."""
        player = self._player
        if said.where == "outside":
            self._say(said)
        elif said.where == "task":
            found = player.stand_ins.get((said.ensemble, said.life))
            if found is not None and not found[1].done:
                await found[0].do(lambda: self._say(said))
            else:
                self._say(said)
        elif said.where == "turn" and player.turns and player.turns[0][0] is said:  # else its turn has come
            player.turns.popleft()
            self._say(said)

    def _watch(self) -> bool:
        """Say what was said at this place of the running turn; return whether it was cut short there."""
        self._say_in_turn()
        cuts, dispatcher = self._player.cuts, self._runtime.dispatcher
        if not cuts or cuts[0].time != dispatcher.time or count_messages(self._runtime.channels) < cuts[0].after:
            return False
        cuts.popleft()
        return True

    def _say_in_turn(self) -> None:
        """Publish what users' handlers said in the running turn, once that has come as far as it had then.

        Several ticks have one time, and each a turn of its own: what was said behind the last is not said in the first.
        """
        runtime, player = self._runtime, self._player
        while player.turns:
            said, ticks = player.turns[0]
            if said.time != runtime.dispatcher.time or ticks > player.ticks:
                break
            if said.after != count_messages(runtime.channels):
                break
            player.turns.popleft()
            self._say(said)

    def _say(self, said: Said) -> None:
        """Publish what was said, on its channel, in the present turn or as the beginning of one."""
        kind = getattr(messages, said.type, None)
        if kind is None or not isinstance(said.message, kind):
            return  # of a type that only the program knew
        give(self._runtime, said.channel, said.message)
