"""What the leader of a term that has been called hears: who has joined, and whose history the term goes on from."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from mdm.team.agreement.entries import START
from mdm.team.agreement.history import contains

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mdm.team.agreement.entries import Joined

__all__ = ["Ballot"]


class Ballot:
    """The answers to a call.

    Args:
        invited: Who was called, with their incarnations.
    """

    def __init__(self, invited: Mapping[str, int]) -> None:
        self.invited = dict(invited)
        self.joined: dict[str, Joined] = {}
        self.patient = True

    def enough(self, majority: int) -> bool:
        """Return whether the term may begin.

        It waits for all who were called, while the leader has patience. Without some of them it needs a majority that
        has not just been started: who has lost its memory cannot vouch that nothing was decided.
        """
        if len(self.joined) < majority:
            return False
        if len(self.joined) == len(self.invited):
            return True
        if self.patient:
            return False
        remembering = sum(1 for joined in self.joined.values() if joined.lineage[-1] != START)
        return not remembering or remembering >= majority

    def source(self, leader: str, *, by_side: bool) -> str:
        """Return the agent whose history the term goes on from.

        It is the latest of those that no other goes on from; with ``by_side``, that of the larger side. Among equals
        the copy that most of them have counts, and the leader has it rather than another.
        """
        candidates = {agent: joined for agent, joined in self.joined.items() if joined.sound} or self.joined
        lineages = {joined.lineage for joined in candidates.values()}
        last = max(
            (joined.side if by_side else 0, joined.lineage[-1])
            for joined in candidates.values()
            if not any(
                contains(lineage, joined.lineage[-1]) and lineage[-1] != joined.lineage[-1] for lineage in lineages
            )
        )[1]
        equals = {agent: joined for agent, joined in candidates.items() if joined.lineage[-1] == last}
        copies = Counter(joined.digest for joined in equals.values())
        own = self.joined[leader]

        def weight(agent: str) -> tuple[int, bool, bool, str]:
            digest = equals[agent].digest
            return -copies[digest], digest != own.digest or leader not in equals, agent != leader, agent

        return min(equals, key=weight)
