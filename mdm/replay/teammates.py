"""What comes from a team in a replay: messages of other agents, who is live, answers, and commands from outside."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.recording.stimuli import Acknowledged, Answered, Asked, Commanded, Opened, Recalled, Received, Seen
from mdm.runtime.actor import descendants
from mdm.runtime.channel import Subscription
from mdm.team.layer import TeamLayer
from mdm.team.replicated import ReplicatedLayer
from mdm.team.sharing.predicates import PredicateSubscriber
from mdm.team.storage import Stored

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mdm.recording.stimuli import Stimulus
    from mdm.replay.player import Player
    from mdm.replay.transport import ReplayTransport
    from mdm.runtime import Runtime

__all__ = ["Teammates"]

_ROUNDS = 100
"""Rounds of the event loop within which a link takes note that it is open."""


class Teammates:
    """Stands for the other agents of a team, as far as one agent has heard of them.

    Args:
        runtime: The agent's.
        player: Its tape.
        transports: Those of the agents that are played, by agent.
    """

    def __init__(self, runtime: Runtime, player: Player, transports: Mapping[str, ReplayTransport]) -> None:
        self._runtime, self._player, self._transports = runtime, player, transports

    async def give(self, stimulus: Stimulus) -> None:
        """Give what came from teammates, or from outside to the team; another stimulus is none of these.

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
        before = self._player.noted
        transport.release()
        for _ in range(_ROUNDS):
            if self._player.noted > before:
                break
            await asyncio.sleep(0)

    def _command(self, commanded: Commanded) -> None:
        """Have a command carried out that was asked for from outside."""
        layer = self._layer(commanded.ensemble)
        if layer is not None:
            order: Any = commanded.command
            turn = Subscription[Any](None, layer, lambda token: layer.command(order, token))
            self._runtime.dispatcher.deliver(turn, commanded.token)

    def _recall(self, recalled: Recalled) -> None:
        """Have a layer begin as an earlier process of its agent had stopped."""
        layer = self._layer(recalled.ensemble)
        if layer is not None:
            stored = msgspec.json.decode(recalled.stored, type=Stored)
            self._runtime.dispatcher.deliver(Subscription[Any](None, layer, layer.recall), stored)

    def _layer(self, ensemble: str) -> TeamLayer | None:
        layers = (actor for actor in descendants(self._runtime.root) if isinstance(actor, TeamLayer))
        return next((one for one in layers if one.ensemble.name == ensemble), None)

    def _answer(self, answered: Answered) -> None:
        """Have an actor take the answer that it got."""
        for actor in descendants(self._runtime.root):
            if isinstance(actor, PredicateSubscriber) and actor.path == answered.actor:
                actor.repeat_answer(answered.body)

    def _acknowledge(self, acknowledged: Acknowledged) -> None:
        """Have a layer acknowledge a step where it did."""
        for actor in descendants(self._runtime.root):
            if isinstance(actor, ReplicatedLayer) and actor.path == acknowledged.actor:
                actor.repeat_acknowledgement()
