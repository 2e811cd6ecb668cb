"""``mdm info``: the content of a file of any kind, and its description."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.cli.report import as_json, printable
from mdm.cli.usage import UsageError
from mdm.formats import load_durations, load_model, load_policy
from mdm.formats.archive.npz import is_archive, kind
from mdm.formats.files import is_policy as text_is_policy
from mdm.formats.source import suffixes
from mdm.models import MDP, Durations
from mdm.models.units import in_words

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from mdm.team import Team

_NAMES = ("state_names", "action_names", "observation_names")
_ROOM = 80
"""Characters of a line for names."""


def run(arguments: argparse.Namespace) -> int:
    """Describe the file; return the exit status."""
    if suffixes(arguments.file) == ".toml":
        return _tell_ensembles(arguments)
    if arguments.imports or suffixes(arguments.file) == ".mcap":
        record = f"{arguments.file} is the record of a run: mdm record info {arguments.file} describes it"
        raise UsageError("--import is for TOML files" if arguments.imports else record)
    content = _load(arguments.file)
    if isinstance(content, Durations):
        facts = _describe_durations(content)
    else:
        facts = describe_model(content) if isinstance(content, MDP) else describe_policy(content)
    if arguments.json:
        print(as_json(facts))
        return 0
    names = {key: facts.pop(key) for key in _NAMES if key in facts}
    for key, value in facts.items():
        if value is not None and value != []:
            print(f"{key.replace('_', ' '):24}{_text(value)}")
    if names:
        print("\n".join(_names(content, names)))
    return 0


def _load(path: str) -> Any:
    """Load a policy, a model or durations.

    Raises:
        FormatError: If it is malformed, or none of these.
    """
    if is_archive(Path(path)) and kind(Path(path)) == "durations":
        return load_durations(path)
    return load_policy(path) if is_policy(path) else load_model(path)


def kind_of(content: Any) -> str:
    """Return the kind of a model or a policy in a few words."""
    return f"a model ({content.kind})" if isinstance(content, MDP) else f"a policy ({content.form})"


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
    from mdm.cli.robots.ensembles import facts, lines, load_ensembles  # noqa: PLC0415 - a model needs no actors
    from mdm.config import load_team  # noqa: PLC0415

    team = load_team(arguments.file)
    agents = [None] if team is None else [each.name for each in team.agents]
    systems = [load_ensembles(arguments.file, agent, imports=arguments.imports) for agent in agents]
    told = [facts(each) if arguments.json else "\n".join([each.tree(), *lines(each)]) for each in systems]
    if team is not None:
        return _tell_team(arguments, team, told)
    print(as_json(told[0]) if arguments.json else told[0])
    return 0


def _tell_team(arguments: argparse.Namespace, team: Team, told: list[Any]) -> int:
    """Describe a team's file: the team, and the part of each agent, as it was told."""
    own: dict[str, Any] = {
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
        agents = {each.name: {"endpoint": each.reached, **facts} for each, facts in zip(team.agents, told, strict=True)}
        print(as_json({**own, "agents": agents}))
        return 0
    for key, value in own.items():
        print(f"{key.replace('_', ' '):24}{_text(value)}")
    for agent, text in zip(team.agents, told, strict=True):
        print(f"\n{agent.name} at {agent.reached or team.router}\n\n{text}")
    return 0


def _text(value: Any) -> str:
    if isinstance(value, list):
        parts = [_text(part) for part in value[:12]] + (["…"] if len(value) > 12 else [])
        return "; ".join(parts) if any(isinstance(part, list) for part in value) else ", ".join(parts)
    if isinstance(value, dict):
        return f"{value['name']} ({value['size']})"
    return {True: "yes", False: "no"}.get(value, str(value)) if isinstance(value, bool) else str(value)


def is_policy(path: str) -> bool:
    """Return True for a policy, False for a model or durations.

    Raises:
        FormatError: If the file is a damaged archive, or neither.
    """
    if is_archive(Path(path)):
        return kind(Path(path)) not in ("model", "durations")
    return text_is_policy(path)


def describe_policy(policy: Any) -> dict[str, Any]:
    """Return a policy's form and sizes."""
    form = getattr(policy, "form", type(policy).__name__)
    unit = in_words(getattr(policy, "discount_of", "step"))
    return {"kind": "policy", "form": form, "input": policy.input, **policy.facts(), "discount_of": unit}


def describe_model(model: MDP) -> dict[str, Any]:
    """Return a model's sizes and names."""
    observations, network = model.observation_space, model.network
    seen = () if observations is None or network is None else network.fully_observed
    return {
        "kind": model.kind,
        "agents": model.num_agents,
        "states": len(model.state_space),
        "actions": len(model.action_space),
        "observations": 0 if observations is None else len(observations),
        "actions_per_agent": [len(factor) for factor in model.action_space.factors],
        "observations_per_agent": [] if observations is None else [len(factor) for factor in observations.factors],
        "state_factors": [{"name": factor.name, "size": len(factor)} for factor in model.state_space.factors],
        "state_names": [list(factor.names) for factor in model.state_space.factors],
        "fully_observed": [f.name for f, s in zip(model.state_space.factors, seen, strict=False) if s],
        "event_observations": model.event_observations,
        "false_negative": None
        if observations is None or model.false_negative is None
        else observations.names[model.false_negative],
        "discount": model.discount,
        "discount_of": in_words(model.discount_of),
        "factored": network is not None,
        # A factored model would have to be flattened to know this.
        "sparse": None if network is not None else model.is_sparse,
        "unavailable_actions": None if model.available is None else int((~model.available).sum()),
        "action_names": [list(factor.names) for factor in model.action_space.factors],
        "observation_names": [] if observations is None else [list(factor.names) for factor in observations.factors],
    }


def _describe_durations(durations: Durations) -> dict[str, Any]:
    """Return of which states and actions the durations are, and how long they are."""
    means, stages = durations.means, durations.stages
    shape = np.broadcast_shapes(means.shape, stages.shape, durations.rates.shape)
    sizes = [f"{size} {what}" for size, what in zip(reversed(shape), ("actions", "states"), strict=False)]
    return {
        "kind": "durations",
        "of": " and ".join(sizes) or "all states and actions",
        f"least_{durations.of}s": float(means.min()),
        f"most_{durations.of}s": float(means.max()),
        "stages": sorted({int(count) for count in stages.flat}),
        f"least_reward_a_{durations.of}": float(durations.rates.min()),
        f"most_reward_a_{durations.of}": float(durations.rates.max()),
    }
