"""Decisions of a communicating team, put together from the records of all its agents.

An agent that is silent has told something: it keeps to itself what would change nothing. Counted as missing at random,
that falsifies what observations are said to depend on. What each agent saw and did is in its own record: its component
of the observation and of the action at each tick.
"""

from __future__ import annotations

from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from mdm.errors import ModelError
from mdm.messages import Decision
from mdm.recording.names import Names, names_of
from mdm.recording.reader import Record

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from mdm.models.mdp import MDP

__all__ = ["Told", "joint_decisions"]


class Told(msgspec.Struct):
    """What a record tells of decisions.

    Args:
        record: The record.
        decisions: The decisions by the path of the ensemble.
        stops: When each stopped or went safe, in nanoseconds.
        agent: Of a team which agent it is.
        facts: What all agents of that team have in common.
    """

    record: Record
    decisions: dict[str, list[Decision]] = {}
    stops: dict[str, list[int]] = {}
    agent: str = ""
    facts: dict[str, str] = {}

    def mode_of(self, path: str) -> str | None:
        """Return the mode of the team in which an ensemble decides; None where it decides alone."""
        name = path.rpartition("/")[2]
        return self.facts.get("team's mode") if f"configuration of ensemble {name!r}" in self.facts else None


def joint_decisions(agents: Mapping[str, Sequence[Told]], ensemble: str, model: MDP | None) -> Iterator[Decision]:
    """Yield the joint decisions of a communicating team, at ticks at which all agents have decided.

    Args:
        agents: The records by the path of the ensemble at each agent.
        ensemble: The name of the ensemble.
        model: Its model.

    Raises:
        ModelError: If there is no model, a record of an agent is missing, or two of one agent are of the same time.
    """
    by_agent = {each.agent: (path, several) for path, several in agents.items() for each in several}
    team = next(iter(agents.values()))[0].facts["team's agents"].split(", ")
    missing = [agent for agent in team if agent not in by_agent]
    if missing:
        raise ModelError(
            f"{ensemble!r} decides in a communicating team, whose agents are silent because of what they saw: without "
            f"the records of {', '.join(missing)} that would count as chance: give those of {', '.join(team)} together"
        )
    if model is None:
        raise ModelError(f"{ensemble!r} decides in a communicating team: which actions are whose is told by its model")
    own = [dict(_own(*by_agent[agent], place, model)) for place, agent in enumerate(team)]
    previous: tuple[int, ...] = ()
    for number, tick in enumerate(sorted(set.intersection(*map(set, own)))):
        parts = [each[tick] for each in own]
        epochs = tuple(part[0].epoch for part in parts)
        follows = previous and epochs == tuple(epoch + 1 for epoch in previous)
        previous = epochs
        action = model.action_space.ravel([part[1] for part in parts])
        yield Decision(
            parts[0][0].time,
            ensemble,
            number,
            "tick" if follows else "start",
            None,
            tuple(part[2] for part in parts),
            parts[0][0].belief,
            action,
            model.action_space.names[action],
            None,
        )


def _own(
    path: str, records: Sequence[Told], place: int, model: MDP
) -> Iterator[tuple[int, tuple[Decision, int, int | None]]]:
    """Yield by the number of the tick an agent's decisions, with its components of the action and the observation."""
    decisions = [(each, decision) for each in records for decision in each.decisions[path]]
    times = sorted(decision.time for _, decision in decisions)
    gaps = [later - earlier for earlier, later in pairwise(times)]
    period = median(gaps) if gaps else 1
    if len(set(times)) < len(times):
        raise ModelError(f"two records of {path!r} are of the same time: count the runs of a communicating team apart")
    for told, decision in decisions:
        names = names_of(told.record).get(path, Names())
        seen = decision.observation
        factors = names.observation_factors.values() or (model.observation_space or model.state_space).factors
        if isinstance(seen, int):
            seen = int(np.unravel_index(seen, [len(factor) for factor in factors])[place])
        elif seen is not None:
            seen = seen[place]
        yield round(decision.time / period), (decision, model.action_space.unravel(decision.action)[place], seen)
