"""``mdm info``: sizes and names of a model or policy; tree and wiring of ensembles."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.cli.files.document import load
from mdm.cli.report import as_json, printable
from mdm.cli.usage import UsageError
from mdm.formats.source import suffixes

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from mdm.models import MDP
    from mdm.team import Team

__all__ = ["run"]

_NAMES = ("state_names", "action_names", "observation_names")
_ROOM = 80
"""Characters of a line for names."""


def run(arguments: argparse.Namespace) -> int:
    """Describe the file; return the exit status."""
    if suffixes(arguments.file) == ".toml":
        return _tell_ensembles(arguments)
    if arguments.imports:
        raise UsageError("--import is for TOML files")
    document = load(arguments.file)
    if arguments.json:
        print(as_json(document.facts()))
    else:
        facts = document.facts()
        names = {key: facts.pop(key) for key in _NAMES if key in facts}
        for key, value in facts.items():
            if value is None or value == []:
                continue
            print(f"{key.replace('_', ' '):24}{_text(value)}")
        if names:
            print("\n".join(_names(document.content, names)))
    return 0


def _names(model: MDP, names: dict[str, list[list[str]]]) -> Iterator[str]:
    """Yield the names of a model's states, actions and observations, a line for each factor or agent."""
    spaces = {"state_names": model.state_space, "action_names": model.action_space}
    if model.observation_space is not None:
        spaces["observation_names"] = model.observation_space
    for key, each in names.items():
        title = key.replace("_", " ")
        for factor, own in zip(spaces[key].factors if each else (), each, strict=True):
            whose = f"{factor.name}: " if len(each) > 1 else ""
            yield f"{title:24}{whose}{_shortened(own)}"
            title = ""


def _shortened(names: list[str]) -> str:
    """Return names in as many words as a line has room for, and how many there are if these are not all."""
    names = [printable(name, _ROOM) for name in names]
    text = ", ".join(names)
    if len(text) <= _ROOM:
        return text
    count = 1
    while len(", ".join(names[: count + 1])) + len(names[-1]) <= _ROOM:
        count += 1
    return f"{', '.join(names[:count])}, …, {names[-1]} ({len(names)})"


def _tell_ensembles(arguments: argparse.Namespace) -> int:
    """Describe the ensembles of a file, or the team of one."""
    from mdm.cli.robots.wiring import lines  # noqa: PLC0415 - a model needs no actors
    from mdm.config import load_team  # noqa: PLC0415

    team = load_team(arguments.file)
    if team is not None:
        return _tell_team(arguments, team)
    document = load(arguments.file, imports=arguments.imports)
    if arguments.json:
        print(as_json(document.facts()))
    else:
        print("\n".join([document.content.tree(), *lines(document.content)]))
    return 0


def _tell_team(arguments: argparse.Namespace, team: Team) -> int:
    """Describe a team's file: the team, and the part of each agent."""
    from mdm.cli.robots.ensembles import Ensembles, load_ensembles  # noqa: PLC0415 - a model needs no actors
    from mdm.cli.robots.wiring import lines  # noqa: PLC0415

    names, imports = [agent.name for agent in team.agents], arguments.imports
    systems = {name: load_ensembles(arguments.file, name, imports=imports) for name in names}
    facts: dict[str, Any] = {
        "kind": "team",
        "name": team.name,
        "mode": team.mode,
        "steps": "at each event" if team.period is None else f"every {team.period:g} s",
        "deadline": team.deadline,
        "quorum": team.quorum,
        "lease": team.lease,
        "max_age": team.max_age,
    }
    if arguments.json:
        agents = {
            agent.name: {"endpoint": agent.reached, **Ensembles(systems[agent.name]).facts()} for agent in team.agents
        }
        print(as_json({**facts, "agents": agents}))
        return 0
    for key, value in facts.items():
        print(f"{key.replace('_', ' '):24}{_text(value)}")
    for agent in team.agents:
        system = systems[agent.name]
        print("\n".join(["", f"{agent.name} at {agent.reached or team.router}", "", system.tree(), *lines(system)]))
    return 0


def _text(value: Any) -> str:
    if isinstance(value, list):
        parts = [_text(part) for part in value[:12]] + (["…"] if len(value) > 12 else [])
        return "; ".join(parts) if any(isinstance(part, list) for part in value) else ", ".join(parts)
    if isinstance(value, dict):
        return f"{value['name']} ({value['size']})"
    return {True: "yes", False: "no"}.get(value, str(value)) if isinstance(value, bool) else str(value)
