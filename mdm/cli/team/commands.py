"""``mdm team start``, ``stop`` and ``reset``: have the agents of a running team begin, end or begin anew to decide."""

from __future__ import annotations

import asyncio
import sys
from typing import TYPE_CHECKING, Any

from mdm.errors import Error

if TYPE_CHECKING:
    import argparse

    from mdm.cli.team.asker import Asker
    from mdm.team import Team

__all__ = ["add_parser", "run", "tell"]

Told = tuple[str, str, str | None]
"""An ensemble, an agent, and why it does not do what it is told, if so."""

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
    from mdm.cli.team.file import team_of  # noqa: PLC0415 - `mdm --help` needs no numpy

    team = team_of(arguments.file)
    verb = arguments.team_verb
    told = asyncio.run(_tell(arguments.file, team, verb, arguments.ensemble))
    for ensemble, agent, problem in told:
        if problem is None:
            print(f"{ensemble}: {verb}, said to {agent}")
        else:
            print(f"mdm team {verb}: {ensemble}: {problem}", file=sys.stderr)
    return 1 if any(problem is not None for _, _, problem in told) else 0


async def _tell(file: str, team: Team, call: str, wanted: str | None) -> list[Told]:
    """Tell the agents of each ensemble; return who was told what, and what went wrong with whom.

    Raises:
        Error: If nobody answers, or there is no such ensemble.
    """
    from mdm.cli.team.asker import asking  # noqa: PLC0415
    from mdm.logic import similar  # noqa: PLC0415

    async with asking(file, team) as asker:
        if wanted is not None and wanted not in asker.ensembles:
            hint = similar(wanted, asker.ensembles) or f"; there are {', '.join(asker.ensembles)}"
            raise Error(f"team {team.name!r} has no ensemble {wanted!r}{hint}")
        chosen = list(asker.ensembles) if wanted is None else [wanted]
        states = await asyncio.gather(*(asker.ask("status", name) for name in chosen))
        if not any(states):
            raise Error(f"nobody runs the team {team.name!r}: no agent answers")
        told = [tell(asker, call, name, states) for name, states in zip(chosen, states, strict=True)]
        return [each for results in await asyncio.gather(*told) for each in results]


async def tell(asker: Asker, call: str, name: str, states: dict[str, Any]) -> list[Told]:
    """Tell one agent after the other of an ensemble, but for those whom another that was told tells itself.

    Args:
        asker: Who asks.
        call: What the agents are to do.
        name: The ensemble.
        states: What each agent said of its ensemble.
    """
    told: list[Told] = []
    reached: set[str] = set()
    for agent in asker.ensembles[name]:
        if agent in reached:
            continue
        answer = (await asker.ask(call, name, agent)).get(agent) if agent in states else None
        if answer is None:
            told.append((name, agent, f"agent {agent!r} does not answer"))
        elif isinstance(answer, Error):
            told.append((name, agent, f"agent {agent!r} does not {call}: {answer}"))
        else:
            told.append((name, agent, None))
            reached.update(_seen_by(agent, states))
    return told


def _seen_by(agent: str, states: dict[str, Any]) -> list[str]:
    """Return the agents that one sees, and that the team did not refuse."""
    refused = {other for other, state in states.items() if isinstance(state, dict) and state.get("role") == "refused"}
    state = states[agent]
    return [other for other in state["live"] if other not in refused] if isinstance(state, dict) else []
