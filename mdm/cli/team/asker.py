"""The asker: asks the agents of a team from outside, for verbs such as ``mdm team status``, and their tables."""

from __future__ import annotations

import asyncio
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

from mdm.cli.team.file import ensembles_of
from mdm.config import load_team_file
from mdm.team.sharing.asking import asking
from mdm.team.sharing.calls import ask
from mdm.team.sharing.commanding import command
from mdm.team.transport.access import OPERATOR

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Sequence

    from mdm.team import Team
    from mdm.team.sharing.commanding import Confirmation
    from mdm.team.transport.session import Session

__all__ = ["Asker", "asker_of"]

_ANSWER = 0.8


class Asker:
    """Asks the agents of a team, all at once: one that does not answer takes no longer than those that do.

    Attributes:
        ensembles: The agents that run each ensemble of the team, by its name.
        live: Whether any agent was there within a second.
    """

    def __init__(self, session: Session, team: Team, ensembles: dict[str, list[str]], *, live: bool) -> None:
        self._session = session
        self._team = team
        self.ensembles = ensembles
        self.live = live

    async def ask(self, call: str, ensemble: str, agent: str = "*") -> dict[str, Any]:
        """Return each agent's answer about an ensemble, or an `Error` in its place; silent agents are left out."""
        if not self.live:
            return {}
        return await ask(self._session, self._team, call, agent=agent, ensemble=ensemble, seconds=_ANSWER)

    async def command(self, name: str, ensemble: str, seconds: float) -> tuple[Confirmation, ...]:
        """Send a command to every agent of an ensemble; return the status of each afterwards."""
        agents = self.ensembles[ensemble]
        return await command(self._session, self._team, name, ensemble=ensemble, agents=agents, seconds=seconds)


@asynccontextmanager
async def asker_of(file: str, team: Team) -> AsyncIterator[Asker]:
    """Yield the asker of a file's team.

    Where the file has certificates, it shows that of the operator.
    """
    described = load_team_file(file)
    reading = asyncio.create_task(asyncio.to_thread(ensembles_of, file, team))
    try:
        async with asking(team, None if described is None else described.access(OPERATOR)) as (session, live):
            yield Asker(session, team, await reading, live=bool(live))
    finally:
        reading.cancel()


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows as lines of aligned columns, below the columns' names; a row may end before the last column."""
    wide = [list(columns), *rows]
    widths = [max((len(row[place]) for row in wide if place < len(row)), default=0) for place in range(len(columns))]
    return ["  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=False)).rstrip() for row in wide]
