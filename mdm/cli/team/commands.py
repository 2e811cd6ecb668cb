"""``mdm team start``, ``stop``, ``reset`` and ``release``: sent to every agent, which answers with its status."""

from __future__ import annotations

import asyncio
import sys
from typing import TYPE_CHECKING

from mdm.cli.team.asker import asker_of, table
from mdm.cli.team.file import team_of
from mdm.errors import Error
from mdm.logic import similar

if TYPE_CHECKING:
    import argparse

    from mdm.team import Team
    from mdm.team.sharing.commanding import Confirmation

__all__ = ["run"]

_COLUMNS = ("agent", "ensemble", "mode", "role", "term", "step", "confirmed")


def run(arguments: argparse.Namespace) -> int:
    """Tell the team; return the exit status."""
    team = team_of(arguments.file)
    verb = arguments.team_verb
    found = asyncio.run(_tell(arguments.file, team, verb, arguments.ensemble, arguments.wait))
    print("\n".join(table(_COLUMNS, [_row(one) for one in found])))
    for one in found:
        if not one.confirmed:
            print(
                f"mdm team {verb}: {one.ensemble}: agent {one.agent!r} did not confirm: {one.problem}", file=sys.stderr
            )
    return 0 if all(one.confirmed for one in found) else 1


def _row(one: Confirmation) -> list[str]:
    known = (one.mode, one.role, one.term, one.step)
    told = ["-" if value is None else str(value) for value in known]
    return [one.agent, one.ensemble, *told, "yes" if one.confirmed else "no"]


async def _tell(file: str, team: Team, call: str, wanted: str | None, wait: float) -> list[Confirmation]:
    """Send the command to the agents of each ensemble; return the status of each afterwards.

    Raises:
        Error: If nobody answers, or there is no such ensemble.
    """
    async with asker_of(file, team) as asker:
        if wanted is not None and wanted not in asker.ensembles:
            hint = similar(wanted, asker.ensembles) or f"; there are {', '.join(asker.ensembles)}"
            raise Error(f"team {team.name!r} has no ensemble {wanted!r}{hint}")
        chosen = list(asker.ensembles) if wanted is None else [wanted]
        if not asker.live:
            raise Error(f"nobody runs the team {team.name!r}: no agent answers")
        told = await asyncio.gather(*(asker.command(call, name, wait) for name in chosen))
    return [one for each in told for one in each]
