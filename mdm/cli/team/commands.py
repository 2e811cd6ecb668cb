"""``mdm team start``, ``stop``, ``reset`` and ``release``: said to every agent, which says what it is then."""

from __future__ import annotations

import asyncio
import sys
from typing import TYPE_CHECKING, Any

from mdm.cli.usage import seconds
from mdm.errors import Error

if TYPE_CHECKING:
    import argparse

    from mdm.team import Team
    from mdm.team.sharing.commanding import Confirmation

__all__ = ["add_parser", "run"]

_COLUMNS = ("agent", "ensemble", "mode", "role", "term", "step", "confirmed")

_WORDS = {
    "start": ("begin to decide", "Have a running team begin to decide: from the initial belief, in a new episode."),
    "stop": ("decide no more", "Have a running team decide no more and end its actions; the processes go on."),
    "reset": ("begin a new episode", "Have a running team begin a new episode now."),
    "release": ("leave its safe mode", "Take a person's word that nothing holds any more that made agents safe."),
}


def add_parser(verbs: Any, name: str) -> argparse.ArgumentParser:
    """Add the verb and its arguments."""
    summary, description = _WORDS[name]
    parser: argparse.ArgumentParser = verbs.add_parser(
        name,
        help=f"have a running team {summary}",
        description=(
            f"{description} It is said to every agent of the file, and waits until each says what it is by then. The "
            "exit status is 1 if an agent did not confirm."
        ),
        epilog=f"example: mdm team {name} examples/team/meeting.toml",
    )
    parser.add_argument("file", metavar="FILE", help="the TOML file")
    parser.add_argument("--ensemble", metavar="NAME", help="this ensemble of the team alone")
    parser.add_argument("--wait", type=seconds, default=5.0, metavar="SECONDS", help="how long to wait (default: 5)")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Tell the team; return the exit status."""
    from mdm.cli.team.file import team_of  # noqa: PLC0415 - `mdm --help` needs no numpy
    from mdm.cli.team.table import table  # noqa: PLC0415

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
    """Tell the agents of each ensemble; return what each is by then.

    Raises:
        Error: If nobody answers, or there is no such ensemble.
    """
    from mdm.cli.team.asker import asker_of  # noqa: PLC0415
    from mdm.logic import similar  # noqa: PLC0415

    async with asker_of(file, team) as asker:
        if wanted is not None and wanted not in asker.ensembles:
            hint = similar(wanted, asker.ensembles) or f"; there are {', '.join(asker.ensembles)}"
            raise Error(f"team {team.name!r} has no ensemble {wanted!r}{hint}")
        chosen = list(asker.ensembles) if wanted is None else [wanted]
        if not asker.live:
            raise Error(f"nobody runs the team {team.name!r}: no agent answers")
        told = await asyncio.gather(*(asker.command(call, name, wait) for name in chosen))
    return [one for each in told for one in each]
