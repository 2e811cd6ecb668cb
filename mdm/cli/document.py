"""What a file holds: ensembles, a model or a policy, found by its suffix and content."""

from __future__ import annotations

from typing import Any

from mdm.config import System, load_system
from mdm.errors import FormatError
from mdm.formats import load_model, load_policy
from mdm.formats.source import Source, suffixes
from mdm.models import MDP, POMDP
from mdm.policies import AlphaVectors, DeterministicPolicy, QTable, StochasticPolicy

__all__ = ["Document", "describe_model", "load"]

_MODELS = frozenset({".pomdp", ".mdp", ".dpomdp"})
_POLICIES = frozenset({".vf", ".policy"})
_KINDS = {
    AlphaVectors: "alpha vectors",
    DeterministicPolicy: "an action per state",
    StochasticPolicy: "probabilities of actions per state",
    QTable: "values of actions per state",
}


class Document:
    """A file's content, and how to tell of it.

    Attributes:
        kind: What it is, in a word or two.
        content: The system, model or policy.
    """

    def __init__(self, content: System | MDP | Any) -> None:
        self.content = content
        self.kind = (
            "ensembles"
            if isinstance(content, System)
            else f"a model ({content.kind})"
            if isinstance(content, MDP)
            else f"a policy ({_KINDS[type(content)]})"
        )

    def facts(self) -> dict[str, Any]:
        """Return what there is to know, ready for JSON."""
        content = self.content
        if isinstance(content, System):
            return {"kind": "ensembles", "ensembles": [_ensemble(ensemble) for ensemble in content.top]}
        if isinstance(content, MDP):
            return describe_model(content)
        facts = {"kind": "policy", "form": _KINDS[type(content)], "input": content.input}
        facts |= {"states": content.num_states, "actions": content.num_actions}
        if isinstance(content, AlphaVectors):
            facts["vectors"] = len(content.vectors)
        return facts


def load(path: str) -> Document:
    """Load whatever a file holds.

    Raises:
        ConfigError: If an ensemble's file is wrong, with all its problems.
        FormatError: If a model or policy is wrong.
    """
    suffix = suffixes(path)
    if suffix == ".toml":
        return Document(load_system(path))
    if suffix in _MODELS:
        return Document(load_model(path))
    text = Source(path).text.lstrip()
    if suffix in _POLICIES or text.startswith("["):
        return Document(load_policy(path))
    try:
        return Document(load_model(path))
    except FormatError as error:
        if suffix or ":" in text:
            raise
        try:
            return Document(load_policy(path))
        except FormatError:
            raise error from None


def describe_model(model: MDP) -> dict[str, Any]:
    """Return a model's sizes and names."""
    observations = model.observation_space if isinstance(model, POMDP) else None
    return {
        "kind": model.kind,
        "agents": model.num_agents,
        "states": len(model.state_space),
        "actions": len(model.action_space),
        "observations": 0 if observations is None else len(observations),
        "actions_per_agent": [len(factor) for factor in model.action_space.factors],
        "observations_per_agent": [] if observations is None else [len(factor) for factor in observations.factors],
        "state_factors": [{"name": factor.name, "size": len(factor)} for factor in model.state_space.factors],
        "event_observations": False,
        "discount": model.discount,
        "sparse": model.is_sparse,
        "action_names": [list(factor.names) for factor in model.action_space.factors],
        "observation_names": [] if observations is None else [list(factor.names) for factor in observations.factors],
    }


def _ensemble(ensemble: Any) -> dict[str, Any]:
    control = ensemble.control
    return {
        "name": ensemble.name,
        "summary": ensemble.summary(),
        "policy": _KINDS.get(type(control.policy), type(control.policy).__name__),
        "states": control.policy.num_states,
        "actions": {
            name: None if binding.ensemble is None else _ensemble(binding.ensemble)
            for name, binding in zip(ensemble.action.names, ensemble.action.bindings, strict=True)
        },
        "model": None if control.model is None else describe_model(control.model),
    }
