"""``mdm team status``, ``start``, ``stop``, ``reset`` and ``release``: every agent of a team is asked, or told."""

from __future__ import annotations

import asyncio
import sys
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.cli.report import as_json, columns
from mdm.cli.team.file import ensembles_of, team_of
from mdm.config import load_team_file
from mdm.errors import Error
from mdm.logic import similar
from mdm.runtime.statistics import Histogram
from mdm.team.sharing import commanding
from mdm.team.sharing.calls import ask, asking
from mdm.team.transport.access import OPERATOR, WARNING, days_left, ending

if TYPE_CHECKING:
    import argparse
    from collections.abc import AsyncIterator, Iterator

    from mdm.team import Team
    from mdm.team.sharing.commanding import Confirmation
    from mdm.team.transport.session import Session

_COLUMNS = (
    *("agent", "ensemble", "mode", "role", "term", "step", "digest"),
    *("late (ms)", "clock (ms)", "dropped", "sees", "action", "certificate (days)"),
)
_DAY = 86400.0
_CONFIRMED = ("agent", "ensemble", "mode", "role", "term", "step", "confirmed")
_ANSWER = 0.8


def run(arguments: argparse.Namespace) -> int:
    """Ask all agents; return the exit status."""
    team = team_of(arguments.file)
    found = asyncio.run(_ask(arguments.file, team))
    silent = [agent for agent in team.names if agent not in found]
    if arguments.json:
        print(as_json({"team": team.name, "agents": found, "silent": silent}))
    elif found:
        rows = [_row(agent, name, status) for agent, ensembles in found.items() for name, status in ensembles.items()]
        count = max(len(_COLUMNS) - 1, *map(len, rows))  # the last where there are certificates
        table = [_COLUMNS[:count], *([*row, *[""] * (count - len(row))] for row in rows)]
        print("\n".join(line.rstrip() for line in columns(table)))
    troubles = [*_doubles(found, team), *_troubles(found)]
    described = load_team_file(arguments.file)
    own = None if described is None else days_left(described.access(OPERATOR))
    for told in [*troubles, *_ending(found, own)]:
        print(f"mdm team status: {told}", file=sys.stderr)
    if len(silent) == len(team.names):
        print(f"mdm team status: nobody runs the team {team.name!r}: no agent answers", file=sys.stderr)
    elif silent:
        print(f"mdm team status: no answer from {', '.join(silent)}", file=sys.stderr)
    return 1 if silent or troubles else 0


def _doubles(found: dict[str, dict[str, Any]], team: Team) -> list[str]:
    """Return which names two processes have, in words."""
    known = team.endpoints()
    statuses = [status for ensembles in found.values() for status in ensembles.values()]
    doubles = {double for status in statuses for double in status.get("doubles", {}).items() if double[0] in known}
    # Those who have another file than the one who asks know the one that answers as the second.
    apart = sorted((agent, where) for agent, where in doubles if where != known[agent])
    return [f"two robots are called {agent}: at {known[agent]} and {where}" for agent, where in apart]


def _troubles(found: dict[str, dict[str, Any]]) -> Iterator[str]:
    """Yield in words why agents that answer do not decide together."""
    for agent, ensembles in found.items():
        for name, status in ensembles.items():
            others = [other for other in found if other != agent and "live" in found[other].get(name, {})]
            apart = [other for other in others if other not in status.get("live", others)]
            if "error" in status:
                yield f"{name}: agent {agent!r}: {status['error']}"
            elif status.get("role") == "refused":
                yield f"{name}: agent {agent!r} is refused: its configuration is another one"
            elif unmet := status.get("unmet"):
                yield f"{name}: agent {agent!r} has never met {', '.join(unmet)}, and waits for a start"
            elif apart:
                yield f"{name}: the team is split: agent {agent!r} does not see {', '.join(apart)}"
            if status.get("mode") == "safe":
                yield f"{name}: agent {agent!r} is safe: {'; '.join(status['causes'])}"


def _ending(found: dict[str, dict[str, Any]], own: float | None) -> Iterator[str]:
    """Yield which certificates end soon, those of the agents and of who asks, in words."""
    days = {agent: status.get("certificate") for agent, ensembles in found.items() for status in ensembles.values()}
    for name, left in {**days, OPERATOR: own}.items():
        if left is not None and left < WARNING:
            yield f"warning: {ending(left, name)}"


async def _ask(file: str, team: Team) -> dict[str, dict[str, Any]]:
    """Return each agent's answer about each of its ensembles."""
    found: dict[str, dict[str, Any]] = {}
    async with _asking(file, team) as (session, ensembles, live):
        questions = [(name, call) for name in ensembles for call in ("status", "statistics") if live]
        asked = (ask(session, team, call, ensemble=name, seconds=_ANSWER) for name, call in questions)
        answers = dict(zip(questions, await asyncio.gather(*asked), strict=True))
    for name in ensembles:
        figures = answers.get((name, "statistics"), {})
        for agent, status in answers.get((name, "status"), {}).items():
            figure = figures.get(agent)
            if isinstance(status, Error) or isinstance(figure, Error):
                status = {"error": str(status if isinstance(status, Error) else figure)}  # noqa: PLW2901
            elif figure is not None:
                status |= _carried(figure["transport"])  # noqa: PLW2901
            for clock in status.get("clocks", {}).values():
                clock["seconds"] = _plausible(clock["seconds"])
            found.setdefault(agent, {})[name] = status
    return {agent: found[agent] for agent in team.names if agent in found}


def _carried(transport: dict[str, Any]) -> dict[str, Any]:
    """Return the traffic of an agent's transport, in few numbers; times in seconds."""
    lateness = msgspec.convert(transport["lateness"], Histogram)
    carried = {
        way: {what: sum(traffic[what] for traffic in transport[way].values()) for what in ("messages", "bytes")}
        for way in ("sent", "received")
    }
    return {
        "late": {"median": _plausible(lateness.quantile(0.5)), "worst": _plausible(lateness.maximum)},
        "dropped": transport["dropped"],
        **carried,
    }


def _row(agent: str, name: str, status: dict[str, Any]) -> list[str]:
    if "error" in status:
        return [agent, name, "error", status["error"]]
    held = ["held"] * status.get("held", False) + [cause.partition(":")[0] for cause in status["causes"]]
    since = [stopped.removeprefix("stopped ")] if (stopped := status.get("stopped")) is not None else []
    unkept = [status["unkept"]] if status.get("unkept") is not None else []
    causes = ", ".join([*since, *held, *unkept])
    idle = status.get("idle")
    if isinstance(idle, int | float) and _plausible(idle) is not None:
        causes = ", ".join(filter(None, (causes, f"idle for {idle:.0f} s")))
    if status.get("waiting"):
        causes = ", ".join(filter(None, (causes, f"waits for {', '.join(status['waiting'])}")))
    late = status.get("late")
    return [
        *(agent, name),
        f"{status['mode']} ({causes})" if causes else status["mode"],
        *(_text(status.get(key)) for key in ("role", "term", "step")),
        _text(status.get("digest"))[:8],
        "-" if late is None else f"{_milliseconds(late['median'])}, {_milliseconds(late['worst'])}",
        _worst(status.get("clocks", {})),
        str(sum(status.get("dropped", {}).values())),
        ", ".join(other for other in status["live"] if other != agent) or "-",
        _text(status.get("action")),
        *([] if status.get("certificate") is None else [f"{status['certificate']:.1f}"]),
    ]


def _worst(clocks: dict[str, dict[str, float | None]]) -> str:
    """Return the offset of the clock that is most off."""
    if not clocks:
        return "-"
    offsets = [clock["seconds"] for clock in clocks.values()]
    known = [offset for offset in offsets if offset is not None]
    return _milliseconds(max(known, key=abs) if len(known) == len(offsets) else None, sign="+")


def _plausible(seconds: float) -> float | None:
    return seconds if abs(seconds) <= _DAY else None


def _milliseconds(seconds: float | None, sign: str = "") -> str:
    return "more than a day" if seconds is None else f"{1e3 * seconds:{sign}.1f}"


def _text(value: object) -> str:
    return "-" if value is None else str(value)


def command(arguments: argparse.Namespace) -> int:
    """Tell the team; return the exit status."""
    team = team_of(arguments.file)
    verb = arguments.team_verb
    found = asyncio.run(_tell(arguments.file, team, verb, arguments.ensemble, arguments.wait))
    print("\n".join(columns([_CONFIRMED, *map(_confirmed, found)])))
    others = [one for one in found if not one.confirmed]
    for one in others:
        told = f"{one.ensemble}: agent {one.agent!r} did not confirm: {one.problem}"
        print(f"mdm team {verb}: {told}", file=sys.stderr)
    return 1 if others else 0


def _confirmed(one: Confirmation) -> list[str]:
    known = (one.mode, one.role, one.term, one.step)
    return [one.agent, one.ensemble, *map(_text, known), "yes" if one.confirmed else "no"]


async def _tell(file: str, team: Team, call: str, wanted: str | None, wait: float) -> list[Confirmation]:
    """Send the command to the agents of each ensemble; return the status of each afterwards."""
    async with _asking(file, team) as (session, ensembles, live):
        if wanted is not None and wanted not in ensembles:
            hint = similar(wanted, ensembles) or f"; there are {', '.join(ensembles)}"
            raise Error(f"team {team.name!r} has no ensemble {wanted!r}{hint}")
        if not live:
            raise Error(f"nobody runs the team {team.name!r}: no agent answers")
        chosen = list(ensembles) if wanted is None else [wanted]
        commands = (
            commanding.command(session, team, call, ensemble=name, agents=ensembles[name], seconds=wait)
            for name in chosen
        )
        return [one for each in await asyncio.gather(*commands) for one in each]


@asynccontextmanager
async def _asking(file: str, team: Team) -> AsyncIterator[tuple[Session, dict[str, list[str]], bool]]:
    """Yield a session that asks a file's team, the agents of each of its ensembles, and whether any agent is there.

    Where the file has certificates, the session shows that of the operator.
    """
    described = load_team_file(file)
    reading = asyncio.create_task(asyncio.to_thread(ensembles_of, file, team))
    try:
        async with asking(team, None if described is None else described.access(OPERATOR)) as (session, live):
            yield session, await reading, bool(live)
    finally:
        reading.cancel()
