"""The content of a file: ensembles, a model, a policy or durations, recognised by suffix and content."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mdm.formats import load_durations, load_model, load_policy
from mdm.formats.archive.npz import is_archive, kind
from mdm.formats.files import is_policy as text_is_policy
from mdm.formats.source import suffixes
from mdm.models import MDP, Durations
from mdm.models.units import in_words

__all__ = ["Document", "describe_model", "describe_policy", "is_policy", "load"]


class Document:
    """A file's content and its description.

    Args:
        content: The system, model, policy or durations.
        kind: In a few words; by default that of a model, a policy or durations.

    Attributes:
        holds_ensembles: Whether it is a TOML file's.
    """

    holds_ensembles = False

    def __init__(self, content: Any, kind: str | None = None) -> None:
        self.content = content
        self.kind = kind or (
            f"a model ({content.kind})"
            if isinstance(content, MDP)
            else "durations"
            if isinstance(content, Durations)
            else f"a policy ({content.form})"
        )

    def facts(self) -> dict[str, Any]:
        """Return the facts about the content, ready for JSON."""
        content = self.content
        if isinstance(content, Durations):
            return _describe_durations(content)
        return describe_model(content) if isinstance(content, MDP) else describe_policy(content)


def load(path: str, *, imports: bool = False) -> Document:
    """Load a file of any kind.

    Args:
        path: The file.
        imports: Whether the functions of a TOML file are imported.

    Raises:
        ConfigError: If it is a TOML file with problems; lists all of them.
        FormatError: If it is a malformed model or policy, or neither.
    """
    if suffixes(path) == ".toml":
        from mdm.cli.robots.ensembles import Ensembles, load_ensembles  # noqa: PLC0415 - a model needs no actors

        return Ensembles(load_ensembles(path, imports=imports))
    if is_archive(Path(path)) and kind(Path(path)) == "durations":
        return Document(load_durations(path))
    return Document(load_policy(path) if is_policy(path) else load_model(path))


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
