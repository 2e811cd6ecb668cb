"""The asker: whoever asks the agents of a team from outside, such as ``mdm team status``."""

from __future__ import annotations

import asyncio
import os
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Mapping

    from mdm.team import Team
    from mdm.team.transport.session import Session

__all__ = ["asking"]

_FIRST, _REST = 0.4, 0.6


@asynccontextmanager
async def asking(file: str, team: Team) -> AsyncIterator[tuple[Session, Mapping[str, int]]]:
    """Yield a session that asks, and the agents that were there within a second, by incarnation.

    Where the file has certificates, it shows that of the operator.
    """
    from mdm.config import load_team_file  # noqa: PLC0415 - `mdm --help` needs no numpy
    from mdm.team.transport.access import OPERATOR, access_settings  # noqa: PLC0415
    from mdm.team.transport.session import Session  # noqa: PLC0415

    described = load_team_file(file)
    access = None if described is None else described.access(OPERATOR)
    session = Session(
        team.name,
        f"asker-{os.getpid()}",
        listen=[],
        connect=[agent.endpoint for agent in team.agents if agent.endpoint is not None],
        lease=team.lease,
        configuration=None if access is None else access_settings(access, team.name, OPERATOR, team.names),
    )
    live: dict[str, int] = {}
    complete = asyncio.Event()

    def see(seen: Mapping[str, int]) -> None:
        live.clear()
        live.update({name: seen[name] for name in team.names if name in seen})
        if len(live) == len(team.names):
            complete.set()

    session.watch(see)
    try:
        await session.open()
        for seconds in (_FIRST, _REST):
            with suppress(TimeoutError):
                await asyncio.wait_for(complete.wait(), seconds)
            if not live:
                break
        yield session, live
    finally:
        await session.close()
