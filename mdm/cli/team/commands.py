"""``mdm team start``, ``stop`` and ``reset``: have the agents of a running team begin, end or begin anew to decide."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from mdm.errors import Error

if TYPE_CHECKING:
    import argparse

    from mdm.team import Team

__all__ = ["add_parser", "run"]

_WORDS = {
    "start": ("begin to decide", "Have a running team begin to decide: from the initial belief, in a new episode."),
    "stop": ("decide no more", "Have a running team decide no more and end its actions; the processes go on."),
    "reset": ("begin a new episode", "Have a running team begin a new episode now."),
}


def add_parser(verbs: Any, name: str) -> argparse.ArgumentParser:
    """Add the verb and its arguments."""
    summary, description = _WORDS[name]
    parser: argparse.ArgumentParser = verbs.add_parser(
        name,
        help=f"have a running team {summary}",
        description=description,
        epilog=f"example: mdm team {name} examples/team/meeting.toml",
    )
    parser.add_argument("file", metavar="FILE", help="the TOML file")
    parser.add_argument("--ensemble", metavar="NAME", help="this ensemble of the team alone")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Tell the team; return the exit status."""
    from mdm.cli.team.file import ensembles_of, team_of  # noqa: PLC0415 - `mdm --help` needs no numpy
    from mdm.logic import similar  # noqa: PLC0415

    team = team_of(arguments.file)
    ensembles = ensembles_of(arguments.file, team)
    wanted = arguments.ensemble
    if wanted is not None and wanted not in ensembles:
        hint = similar(wanted, ensembles) or f"; there are {', '.join(ensembles)}"
        raise Error(f"team {team.name!r} has no ensemble {wanted!r}{hint}")
    chosen = ensembles if wanted is None else {wanted: ensembles[wanted]}
    for ensemble, agent in asyncio.run(_tell(arguments.file, team, arguments.team_verb, chosen)).items():
        print(f"{ensemble}: {arguments.team_verb}, said to {agent}")
    return 0


async def _tell(file: str, team: Team, call: str, ensembles: dict[str, list[str]]) -> dict[str, str]:
    """Tell one agent of each ensemble, which tells the others; return who was told.

    Raises:
        Error: If nobody answers, or the agent refuses.
    """
    from mdm.cli.team.asker import asking  # noqa: PLC0415
    from mdm.team.sharing.calls import ask  # noqa: PLC0415

    told: dict[str, str] = {}
    async with asking(file, team) as (session, live):
        for name, agents in ensembles.items():
            for agent in agents:
                answer = (
                    (await ask(session, team, call, agent=agent, ensemble=name)).get(agent) if agent in live else None
                )
                if isinstance(answer, Error):
                    raise Error(f"agent {agent!r} does not {call} ensemble {name!r}: {answer}")
                if answer is not None:
                    told[name] = agent
                    break
            else:
                raise Error(f"nobody runs the team {team.name!r}: no agent answers")
    return told
