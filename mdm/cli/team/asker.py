"""The asker: whoever asks the agents of a team from outside, such as ``mdm team status``."""

from __future__ import annotations

import asyncio
import os
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Mapping

    from mdm.team import Team
    from mdm.team.session import Session

__all__ = ["asking"]

_PATIENCE = 1.0


@asynccontextmanager
async def asking(team: Team) -> AsyncIterator[tuple[Session, Mapping[str, int]]]:
    """Yield a session that asks, and the agents that were there within a second, by incarnation."""
    from mdm.team.session import Session  # noqa: PLC0415 - `mdm --help` needs no numpy

    session = Session(
        team.name,
        f"asker-{os.getpid()}",
        listen=[],
        connect=[agent.endpoint for agent in team.agents if agent.endpoint is not None],
        lease=team.lease,
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
        with suppress(TimeoutError):
            await asyncio.wait_for(complete.wait(), _PATIENCE)
        yield session, live
    finally:
        await session.close()
