"""Episodes of a communicating team: from which tick its steps count, and the messages of agents in them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from mdm.runtime import ActorStatistics
from mdm.team.communicating.recollection import Experience
from mdm.team.transport.bounds import Name, Number, Text

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

__all__ = ["CommunicatingStatistics", "Episode", "Standstill", "Stops", "Update", "decode", "encode"]

_MOST = 1 << 62
"""No stop has a number as great: they are about as many as nanoseconds have passed since 1970."""


class Episode(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """An episode of a communicating team, or the time between two of them.

    Args:
        number: It grows with each command.
        origin: The number of the tick of step 0: ticks are at multiples of the period since 1970, on every clock.
        by: Who began it.
        running: Whether the agents decide in it, unless one of them was stopped that this does not know of.
        stops: The last stop of each agent of which the agent that began it knew.
        token: The identifier of the command that began it.
    """

    number: Number
    origin: Number
    by: Name
    running: bool
    stops: dict[Name, Number] = {}
    token: Name = ""

    def supersedes(self, other: Episode | None) -> bool:
        """Whether it counts in place of another: the later command does, and of two at once the earlier origin.

        Of any two that differ one does, so that all come to the same. Those of one agent at one time differ where
        another has spoken in its name: then a stop counts.
        """
        return other is None or self.rank > other.rank

    @property
    def rank(self) -> tuple[Any, ...]:
        """The order of episodes; no two that differ have the same."""
        return self.number, -self.origin, self.by, not self.running, sorted(self.stops.items()), self.token


class Stops:
    """The last stop of each agent that one of them knows of; a later one has a greater number, in any life of an agent.

    A stop beats each start that was asked for by somebody who did not know of it, whichever came first.

    Args:
        agents: All agents.

    Attributes:
        last: The numbers, by agent.
    """

    def __init__(self, agents: Iterable[str]) -> None:
        self._agents = frozenset(agents)
        self.last: dict[str, int] = {}

    def take(self, agent: str, life: int) -> None:
        """Take note of a stop that is asked of an agent."""
        self.last[agent] = max(self.last.get(agent, 0), life) + 1

    def hear(self, others: Mapping[str, int]) -> None:
        """Take note of the stops that another agent knows of."""
        for agent, number in others.items():
            if agent in self._agents and self.last.get(agent, 0) < number < _MOST:
                self.last[agent] = number

    def allow(self, episode: Episode) -> bool:
        """Return whether the agents decide in an episode."""
        return episode.running and all(episode.stops.get(agent, 0) >= number for agent, number in self.last.items())


class Update(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """A message of an agent to all others.

    Args:
        episode: The episode that it is in.
        configuration: The digest of the configuration, which must be the same at all agents.
        experiences: The part of its history that it shares; their steps count from the episode's origin.
        stops: The last stop of each agent that it knows of.
    """

    episode: Episode
    configuration: Text
    experiences: tuple[Experience, ...] = ()
    stops: dict[Name, Number] = {}


class Standstill(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """The stop that an agent obeys, as it outlives its process.

    Args:
        episode: The episode in which nothing is decided; None where there was none.
        stops: The stops that the agent knew of.
    """

    episode: Episode | None
    stops: dict[Name, Number]


encode = msgspec.msgpack.Encoder().encode
decode = msgspec.msgpack.Decoder(Update).decode


class CommunicatingStatistics(ActorStatistics, frozen=True):
    """Where an agent of a communicating team stands.

    Attributes:
        role: ``talking``; ``joining`` before the first episode; ``refused`` where it
            takes no part, for agents that were there before it have another configuration.
        term: The number of the episode.
        step: The present step.
        digest: Of the agent's knowledge.
        members: The agents that it hears, itself included.
        sent: Messages with a part of the history, each to all others.
        held: Of those, messages that the transport did not take; they are lost.
        heard: Experiences of others that came.
        late: Of those, applied to a step before the present one.
        too_late: Of those, not applied: from before the window, or before this agent came.
        refused: Of those, not applied: from far ahead, or another thing than was told before.
        malformed: Messages that were none.
    """

    role: str
    term: int
    step: int
    digest: str
    members: tuple[str, ...]
    sent: int
    held: int
    heard: int
    late: int
    too_late: int
    refused: int
    malformed: int
