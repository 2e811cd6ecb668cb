"""The asker: whoever asks the agents of a team from outside, such as ``mdm team status``."""

from __future__ import annotations

import asyncio
import os
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Collection, Mapping

    from mdm.team import Team
    from mdm.team.transport.session import Session

__all__ = ["Asker", "asking"]

_FIRST, _REST = 0.8, 0.4
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
        """Return what each agent says of an ensemble, or an `Error` in its place; who does not answer is left out."""
        from mdm.team.sharing.calls import ask  # noqa: PLC0415 - `mdm --help` needs no numpy

        if not self.live:
            return {}
        return await ask(self._session, self._team, call, agent=agent, ensemble=ensemble, seconds=_ANSWER)


@asynccontextmanager
async def asking(file: str, team: Team) -> AsyncIterator[Asker]:
    """Yield whoever asks the agents of a file's team.

    Where the file has certificates, it shows that of the operator.
    """
    from mdm.cli.team.file import ensembles_of  # noqa: PLC0415
    from mdm.config import load_team_file  # noqa: PLC0415
    from mdm.team.transport.access import OPERATOR, access_settings  # noqa: PLC0415
    from mdm.team.transport.session import Session  # noqa: PLC0415

    described = load_team_file(file)
    access = None if described is None else described.access(OPERATOR)
    configuration = {} if access is None else access_settings(access, team.name, OPERATOR, team.names)
    # An agent that hangs holds the end of the session for so many milliseconds; and who is there is waited for here.
    configuration.setdefault("transport", {})["unicast"] = {"open_timeout": 700}
    configuration["open"] = {"return_conditions": {"connect_scouted": False, "declares": False}}
    session = Session(
        team.name,
        f"asker-{os.getpid()}",
        listen=[],
        connect=[agent.endpoint for agent in team.agents if agent.endpoint is not None],
        lease=team.lease,
        configuration=configuration,
    )
    try:
        ensembles, live = await asyncio.gather(asyncio.to_thread(ensembles_of, file, team), _meet(session, team))
        yield Asker(session, team, ensembles, live=bool(live))
    finally:
        await session.close()


async def _meet(session: Session, team: Team) -> Collection[str]:
    """Open a session; return the agents that were there within about a second."""
    live: set[str] = set()
    complete = asyncio.Event()

    def see(seen: Mapping[str, int]) -> None:
        live.clear()
        live.update(name for name in team.names if name in seen)
        if len(live) == len(team.names):
            complete.set()

    session.watch(see)
    await session.open()
    for seconds in (_FIRST, _REST):
        with suppress(TimeoutError):
            await asyncio.wait_for(complete.wait(), seconds)
        if not live:
            break
    return live
