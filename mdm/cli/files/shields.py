"""Notes of `mdm check` on shields: the numbers before and after, and fallbacks and safe actions without one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import Error
from mdm.policies import BudgetedTable
from mdm.policies.shielded import Budgeted

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mdm.actors import Ensemble
    from mdm.cli.files.oddities import Odd

_SECONDS = 10.0
"""The time for the numbers of a shield, where they are simulated."""


def of_shields(ensembles: Iterable[Ensemble]) -> Iterator[Odd]:
    """Yield the numbers that each shield changes, and where something without one stands in for the policy."""
    known: set[str] = set()
    for ensemble in ensembles:
        policy: Any = ensemble.controller.policy
        if not hasattr(policy, "wanted") or ensemble.name in known:  # a joint policy is the same at all agents
            continue
        known.add(ensemble.name)
        key = ("ensembles", ensemble.name, "shield")
        try:
            yield key, _changes(policy, ensemble.controller.model)
        except Error as error:
            yield key, f"the numbers that the shield changes are not known: {error}"
        fallback = getattr(policy, "fallback", None)
        if fallback is not None and not hasattr(fallback, "wanted"):
            yield key, f"the fallback of the search is not shielded: it may lead to {policy.avoid}"
        state = _beyond(ensemble, policy)
        if state is not None:
            key = (*key[:2], "safe_action")
            yield key, f"the safe action is not shielded: in {state} it may lead to {policy.avoid}"


def _changes(policy: Any, model: Any) -> str:
    from mdm.verification import effect  # noqa: PLC0415 - other files verify nothing

    found = effect(policy, model, seconds=_SECONDS)
    told = [(f"P(reach {policy.avoid})", *map(_number, found.avoid))]
    told += [] if found.keep is None else [(f"P({policy.keep})", *map(_number, found.keep))]
    told += [] if found.value is None else [("the expected return", *(f"{value:.4g}" for value in found.value))]
    less, how = found.lost, "gained" if (found.lost or 0) < -1e-9 else "lost"
    lost = "" if less is None else f": {abs(less):.4g} of the return is {how}"
    return f"the shield changes {', '.join(f'{name} from {first} to {then}' for name, first, then in told)}{lost}"


def _number(found: Any) -> str:
    return f"{found.value:.4g}" if hasattr(found, "value") else f"[{found.lower:.4g}, {found.upper:.4g}]"


def _beyond(ensemble: Ensemble, policy: Any) -> str | None:
    """Return the name of a state in which the shield forbids the safe action, if that is one of the model's."""
    bindings, space = ensemble.action.bindings, ensemble.controller.symbols.state_space
    safe = next((place for place, each in enumerate(bindings) if each is ensemble.action.safe), None)
    if safe is None or space is None or len(bindings) != policy.num_actions:
        return None
    for state, name in enumerate(space.names):
        x: Any = state if policy.input == "state" else np.eye(1, len(space), state)[0]
        allowed = policy.allowed(Budgeted(state, 0.0) if isinstance(policy, BudgetedTable) else x)
        if allowed.any() and not allowed[safe]:
            return name
    return None
