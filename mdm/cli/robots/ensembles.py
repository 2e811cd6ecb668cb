"""The ensembles of a TOML file, loaded to be looked at, and described."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.cli.files.document import Document, describe_model
from mdm.cli.robots.wiring import definitions, wiring
from mdm.config import load_system, look_over

if TYPE_CHECKING:
    from pathlib import Path

    from mdm.config import System
    from mdm.models import MDP

__all__ = ["Ensembles", "load_ensembles"]


class Ensembles(Document):
    """The ensembles of a TOML file.

    Args:
        content: The system.
    """

    holds_ensembles = True

    def __init__(self, content: System) -> None:
        super().__init__(content, "ensembles")

    def facts(self) -> dict[str, Any]:
        """Return the tree of ensembles and the definitions of predicates, ready for JSON."""
        ensembles = [_ensemble(ensemble) for ensemble in self.content.top]
        return {"kind": self.kind, "ensembles": ensembles, "definitions": definitions(self.content)}


def load_ensembles(
    path: str, agent: str | None = None, *, imports: bool, models: dict[Path, MDP] | None = None
) -> System:
    """Load a TOML file, of a team's file the part of an agent, in order to look at it.

    Args:
        path: The file.
        agent: The agent.
        imports: Import its functions, which runs their modules; otherwise they are looked for in the source.
        models: The models loaded before, by their files; newly loaded ones are added.
    """
    return (load_system if imports else look_over)(path, agent=agent, models=models)


def _ensemble(ensemble: Any) -> dict[str, Any]:
    controller = ensemble.controller
    return {
        "name": ensemble.name,
        "summary": ensemble.summary(),
        "policy": getattr(controller.policy, "form", type(controller.policy).__name__),
        "states": controller.symbols.num_states,
        "actions": {
            name: None if binding.ensemble is None else _ensemble(binding.ensemble)
            for name, binding in zip(ensemble.action.names, ensemble.action.bindings, strict=True)
        },
        "model": None if controller.model is None else describe_model(controller.model),
        "wiring": wiring(ensemble),
    }
