"""The driver of a replay: it starts the actors that a run has started, and gives them each stimulus at its time."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import msgspec

from mdm import messages
from mdm.actors import AbandonedError
from mdm.messages import Tick
from mdm.replay.exchange import PartedError
from mdm.replay.input import give
from mdm.replay.player import AsRecordedError
from mdm.runtime.actor import descendants
from mdm.runtime.channel import Subscription
from mdm.runtime.observing import Choices
from mdm.runtime.time.clock import Timer
from mdm.runtime.time.virtual import VirtualClock
from mdm.stimuli import (
    Acknowledged,
    Answered,
    Asked,
    Began,
    Commanded,
    Cut,
    Ended,
    Failed,
    Finished,
    Opened,
    Recalled,
    Received,
    Resumed,
    Said,
    Seen,
    Ticked,
    count_messages,
)
from mdm.team.layer import TeamLayer
from mdm.team.replicated import ReplicatedLayer
from mdm.team.sharing.predicates import PredicateSubscriber
from mdm.team.storage import Stored

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from mdm.replay.exchange import ReplayTransport
    from mdm.replay.player import Player
    from mdm.runtime import Actor, Runtime
    from mdm.stimuli import Stimulus

_PATIENCE = 3600.0
"""Seconds of virtual time within which an actor that the record has comes to its start."""
_BREATH = 100
"""Stimuli after which the event loop turns once."""


class Driver:
    """Plays a record.

    Args:
        runtime: The runtime, not entered yet: its own start is in the record, too.
        player: Who answers in the place of the world, and compares.
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
                self._runtime.dispatcher.choices = Choices()
                self._runtime.observers.add(self._player).cancel()

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
        """Go on with a turn that is cut short; forget a cut to whose place no turn has come."""
        cuts, dispatcher = self._player.cuts, self._runtime.dispatcher
        if isinstance(stimulus, Resumed):
            if dispatcher.active:
                dispatcher.resume(stimulus.time, starved=stimulus.starved)
        elif cuts and cuts[0] is stimulus:
            cuts.popleft()

    # -- Actors ------------------------------------------------------------------------------------------------------

    def _ask(self, began: Began) -> None:
        """Stop an actor at the top or start it again, where the program has done so."""
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
        """Let an actor fail, unless it has with another, or by itself."""
        actor = next((one for one in descendants(self._runtime.root) if one.path == failed.actor), None)
        if actor is not None and not actor.failing:
            actor.fail(AsRecordedError(failed.error))

    async def _end(self, ended: Ended) -> None:
        """End the task of an action as it did end."""
        found = self._player.stand_ins.get((ended.ensemble, ended.life))
        if found is None or found[1].done:
            return
        stand_in, work = found
        work.interrupted = ended.interrupted
        error: BaseException | None = None
        if ended.error is not None:
            error = (AbandonedError if ended.error.startswith("AbandonedError:") else AsRecordedError)(ended.error)
        elif ended.cancelled:
            error = asyncio.CancelledError()
        stand_in.end(error)
        await work.over

    # -- What was said -----------------------------------------------------------------------------------------------

    async def _repeat(self, said: Said) -> None:
        """Publish a message from outside of turns; one from within a turn has its place there."""
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
        """Publish the messages of this place of the running turn; return whether it was cut short there."""
        # Several ticks have one time, and each a turn of its own: what was said behind the last waits for that.
        runtime, player = self._runtime, self._player
        while player.turns:
            said, ticks = player.turns[0]
            if said.time != runtime.dispatcher.time or ticks > player.ticks:
                break
            if said.after != count_messages(runtime.channels):
                break
            player.turns.popleft()
            self._say(said)
        cuts, dispatcher = self._player.cuts, self._runtime.dispatcher
        if not cuts or cuts[0].time != dispatcher.time or count_messages(self._runtime.channels) < cuts[0].after:
            return False
        cuts.popleft()
        return True

    def _say(self, said: Said) -> None:
        """Publish a message again, on its channel, in the present turn or as the beginning of one."""
        kind = getattr(messages, said.type, None)
        if kind is None or not isinstance(said.message, kind):
            return  # of a type that only the program knew
        give(self._runtime, said.channel, said.message)


_ROUNDS = 100
"""Rounds of the event loop within which a link takes note that it is open."""


class Teammates:
    """Stands for the other agents of a team, as far as one agent has heard of them.

    Args:
        runtime: The agent's.
        player: Who answers there in the place of the world.
        transports: Those of the agents that are played, by agent.
    """

    def __init__(self, runtime: Runtime, player: Player, transports: Mapping[str, ReplayTransport]) -> None:
        self._runtime, self._player, self._transports = runtime, player, transports

    async def give(self, stimulus: Stimulus) -> None:
        """Give a stimulus from teammates, or from outside to the team; ignore another one.

        Raises:
            PartedError: If it is a message that is not known any more.
        """
        transport = self._transports.get(getattr(stimulus, "agent", ""))
        if isinstance(stimulus, Commanded):
            self._command(stimulus)
        elif isinstance(stimulus, Recalled):
            self._recall(stimulus)
        elif isinstance(stimulus, Answered):
            self._answer(stimulus)
        elif isinstance(stimulus, Acknowledged):
            self._acknowledge(stimulus)
        elif transport is not None and isinstance(stimulus, Received):
            received = stimulus
            if transport.exchange is not None:
                heard = transport.hears(stimulus.expression)
                received = await transport.exchange.comes(stimulus, transport.incarnation, heard=heard)
            transport.receive(received)
        elif transport is not None and isinstance(stimulus, Asked):
            transport.request(stimulus)
        elif transport is not None and isinstance(stimulus, Seen):
            transport.see(stimulus.live)
        elif transport is not None and isinstance(stimulus, Opened):
            await self._open(transport)

    async def _open(self, transport: ReplayTransport) -> None:
        before = self._player.opened
        transport.release()
        for _ in range(_ROUNDS):
            if self._player.opened > before:
                break
            await asyncio.sleep(0)

    def _command(self, commanded: Commanded) -> None:
        """Carry out a command that was asked for from outside."""
        layer = self._layer(commanded.ensemble)
        if layer is not None:
            order: Any = commanded.command
            turn = Subscription[Any](None, layer, lambda token: layer.command(order, token))
            self._runtime.dispatcher.deliver(turn, commanded.token)

    def _recall(self, recalled: Recalled) -> None:
        """Let a layer begin as an earlier process of its agent had stopped."""
        layer = self._layer(recalled.ensemble)
        if layer is not None:
            stored = msgspec.json.decode(recalled.stored, type=Stored)
            self._runtime.dispatcher.deliver(Subscription[Any](None, layer, layer.recall), stored)

    def _layer(self, ensemble: str) -> TeamLayer | None:
        layers = (actor for actor in descendants(self._runtime.root) if isinstance(actor, TeamLayer))
        return next((one for one in layers if one.ensemble.name == ensemble), None)

    def _answer(self, answered: Answered) -> None:
        """Give an actor the answer that it got."""
        for actor in descendants(self._runtime.root):
            if isinstance(actor, PredicateSubscriber) and actor.path == answered.actor:
                actor.repeat_answer(answered.body)

    def _acknowledge(self, acknowledged: Acknowledged) -> None:
        """Let a layer acknowledge a step where it did."""
        for actor in descendants(self._runtime.root):
            if isinstance(actor, ReplicatedLayer) and actor.path == acknowledged.actor:
                actor.repeat_acknowledgement()


class ReplayClock(VirtualClock):
    """A clock that whoever repeats a run moves from stimulus to stimulus.

    Ticks are stimuli of the record: a timer of their rank never fires by itself.

    Args:
        epoch: The time that it shows at first, in nanoseconds.
    """

    def __init__(self, epoch: int) -> None:
        super().__init__(epoch=epoch)
        self._time = epoch

    def now(self) -> int:
        """Return the time to which it was moved."""
        return self._time

    def call_at(self, when: int, callback: Callable[[], None], *, rank: int = 0) -> Timer:
        """Call back when it is moved to ``when`` nanoseconds or beyond."""
        if rank:
            return Timer(when, callback)
        return super().call_at(when, callback)

    def _arm(self, when: int) -> None:
        """Wait to be moved."""

    def fire_before(self, when: int) -> None:
        """Leave timers to `step`."""

    def step(self, until: int) -> bool:
        """Fire the first timer that is due by a time, at its time; return whether there was one."""
        self._look_at_next()
        if self.due > until:
            self._time = max(self._time, until)
            return False
        self._time = max(self._time, self.due)
        self.fire_first()
        return True
