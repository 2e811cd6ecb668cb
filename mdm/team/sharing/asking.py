"""Requests to a team from outside: a session of its own, which is none of the team's agents."""

from __future__ import annotations

import asyncio
import os
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING, Any

from mdm.errors import Error

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Collection, Mapping

    from mdm.team.team import Team
    from mdm.team.transport.access import Access
    from mdm.team.transport.session import Session

__all__ = ["asking"]

_FIRST, _REST = 0.8, 0.4
_OPENING = 3.0
"""Seconds for which a router is waited for."""


@asynccontextmanager
async def asking(
    team: Team, access: Access | None = None, who: str = ""
) -> AsyncIterator[tuple[Session, Collection[str]]]:
    """Yield a session that asks the agents of a team, and those that were there within about a second.

    Args:
        team: The team.
        access: The certificates of the team's operator, where its agents have any; or of an agent.
        who: That agent.
    """
    from mdm.team.transport.access import OPERATOR, access_settings  # noqa: PLC0415 - nobody asks in most processes
    from mdm.team.transport.session import Session  # noqa: PLC0415 - the one that needs Zenoh

    configuration: dict[str, Any] = {}
    if access is not None:
        routed = team.router is not None
        configuration = access_settings(access, team.name, who or OPERATOR, team.names, routed=routed)
    # An agent that hangs holds the end of the session for so many milliseconds; and who is there is waited for here.
    configuration.setdefault("transport", {})["unicast"] = {"open_timeout": 700}
    configuration["open"] = {"return_conditions": {"connect_scouted": False, "declares": False}}
    session = Session(
        team.name,
        f"asker-{os.getpid()}",
        **team.addresses(protocol="tcp" if access is None else "tls"),
        lease=team.lease,
        configuration=configuration,
    )
    try:
        yield session, await _meet(session, team)
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
    try:
        async with asyncio.timeout(None if team.router is None else _OPENING):
            await session.open()
    except TimeoutError:
        raise Error(f"no router answers at {team.router}: start it, or correct the team's `router`") from None
    for seconds in (_FIRST, _REST):
        with suppress(TimeoutError):
            await asyncio.wait_for(complete.wait(), seconds)
        if not live:
            break
    return live
