"""Policies and trackers of a user's own, which a file names as ``module:name``."""

from __future__ import annotations

import inspect
import math
import re
from typing import TYPE_CHECKING, Any

from mdm.errors import ConfigError, Error
from mdm.policies import BeliefPolicy, StatePolicy
from mdm.runtime.supervision import describe

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mdm.actors import ObservationFactor, StateFactor
    from mdm.models import MDP
    from mdm.policies import Policy

__all__ = ["is_reference", "made", "unseen_policy"]

_REFERENCE = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")


def is_reference(text: object) -> bool:
    """Whether a text is ``module:name``, and no path."""
    return isinstance(text, str) and _REFERENCE.fullmatch(text) is not None


def made(make: Callable[..., Any], reference: str, model: MDP | None) -> Any:
    """Return what a class or function makes: it is called with the model, or without arguments where it takes none.

    Raises:
        ConfigError: If it raises, or takes other arguments.
    """
    try:
        needed = [
            one
            for one in inspect.signature(make).parameters.values()
            if one.default is one.empty and one.kind not in {one.VAR_POSITIONAL, one.VAR_KEYWORD}
        ]
        arguments = (model,) * len(needed)
        if len(needed) > 1 or any(one.kind is one.KEYWORD_ONLY for one in needed):
            names = ", ".join(one.name for one in needed)
            raise ConfigError(f"{reference!r} is called with the model, or without arguments, but needs {names}")
        return make(*arguments)
    except Error:
        raise
    except Exception as error:
        raise ConfigError(f"{reference!r} has raised {describe(error)}") from None


def unseen_policy(
    reference: str,
    model: MDP | None,
    actions: int,
    states: Sequence[StateFactor],
    observations: Sequence[ObservationFactor],
) -> Policy:
    """Return what stands for a policy whose module is not run: of the sizes, and the input, that all else says.

    Args:
        reference: The name of what makes it.
        model: Its model, if there is one.
        actions: The number of actions bound.
        states: The factors that the ensemble has.
        observations: Those of its observations.
    """
    over_beliefs = bool(observations) or (not states and model is not None and model.pomdp is not None)
    kind: Any = BeliefPolicy if over_beliefs else StatePolicy
    sizes = {
        "num_states": math.prod(factor.size for factor in states) if model is None else len(model.state_space),
        "num_actions": actions if model is None else len(model.action_space),
        "form": f"made by {reference}",
        "action": _first,
    }
    policy: Policy = type("UnseenPolicy", (kind,), sizes)()
    return policy


def _first(_policy: object, _x: object) -> int:
    return 0
