"""Solving by name: the solvers there are, and which one suits a model."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from mdm.errors import ConfigError
from mdm.models import POMDP
from mdm.solvers.limits import Watch

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.models import MDP
    from mdm.solvers.solution import Solution

__all__ = ["SOLVERS", "default_solver", "solve"]

SOLVERS: dict[str, tuple[str, str, str]] = {
    "value-iteration": ("mdp.value_iteration", "value_iteration", "MDP"),
    "prioritised-sweeping": ("mdp.prioritised_sweeping", "prioritised_sweeping", "MDP"),
    "policy-iteration": ("mdp.policy_iteration", "policy_iteration", "MDP"),
    "modified-policy-iteration": ("mdp.policy_iteration", "modified_policy_iteration", "MDP"),
    "qmdp": ("qmdp", "qmdp", "POMDP"),
    "fib": ("fast_informed_bound", "fast_informed_bound", "POMDP"),
    "perseus": ("perseus", "perseus", "POMDP"),
    "sarsop": ("sarsop", "sarsop", "POMDP"),
    "jesp": ("jesp", "jesp", "POMDP"),
}
"""For each name the module, its function, and the kind of model that it solves."""


def default_solver(model: MDP) -> str:
    """Return the solver for a model of this kind where nobody names one."""
    if not isinstance(model, POMDP):
        return "modified-policy-iteration"
    return "perseus" if model.event_observations else "sarsop"


def solve(model: MDP, solver: str | None = None, *, watch: Watch | None = None, **options: Any) -> Solution:
    """Solve a model.

    Args:
        model: The model.
        solver: One of `SOLVERS`; by default what suits the model.
        watch: Its limits, and where it reports.
        options: What the solver itself takes.

    Raises:
        ConfigError: If there is no such solver, or it is not for such models.
        ModelError: If the model has no solution, such as one with a discount of 1 that never ends.
    """
    name = default_solver(model) if solver is None else solver
    if name not in SOLVERS:
        raise ConfigError(f"there is no solver {name!r}; there are {', '.join(SOLVERS)}", key="solver")
    module, function, kind = SOLVERS[name]
    if kind != model.kind:
        others = ", ".join(other for other, (*_, of) in SOLVERS.items() if of == model.kind)
        raise ConfigError(f"{name} solves {kind}s, not {model.kind}s: take {others}", key="solver")
    run: Callable[..., Solution] = getattr(importlib.import_module(f"mdm.solvers.{module}"), function)
    return run(model, watch=Watch() if watch is None else watch, **options)
