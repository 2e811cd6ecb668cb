"""What a controller is made of, from its options: each is refused where it does not fit the policy."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import numpy as np

from mdm.beliefs.choice import check_memory
from mdm.errors import ConfigError, ModelError
from mdm.loading import spared
from mdm.models.factored.flattening import RewardRow, RewardRows

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy.typing as npt

    from mdm.beliefs import Information
    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.models.space import Symbol
    from mdm.policies import Policy
    from mdm.symbols import Symbols

__all__ = ["expectation", "horizon_of", "informed", "reward_rows", "seeded", "with_false_negatives", "within"]


def informed(policy: Policy, model: MDP | None, tracker: Information | None) -> Information:
    """Return the information state that a policy decides by: its own, or a tracker of the user's."""
    if tracker is None:
        return policy.information(model)
    if getattr(policy, "input", "belief") != "belief":
        raise ConfigError("a tracker needs a policy over beliefs", key="tracker")
    if isinstance(tracker, type):
        raise ConfigError(f"a tracker is an object, not the class {tracker.__name__}: make one of it", key="tracker")
    missing = [name for name in ("current", "reset", "update") if not hasattr(tracker, name)]
    if missing:
        raise ConfigError(
            f"the tracker {type(tracker).__name__} has no {' and no '.join(missing)}; see mdm.beliefs.Information",
            key="tracker",
        )
    return tracker


def horizon_of(information: Information, given: int | None) -> int | None:
    """Return the decisions per episode: as many as given, or as the policy has stages."""
    stages: int | None = getattr(information, "horizon", None)
    if given is None:
        return stages
    if stages is not None and given > stages:
        raise ConfigError(f"the policy is for episodes of at most {stages} decisions, not of {given}", key="horizon")
    return given


def expectation(information: Information, *, own: bool) -> Callable[[Vector | RewardRow], float] | None:
    """Return the expectation of functions of the state; None if the information state has no states."""
    known: Callable[[Vector | RewardRow], float] | None = getattr(information, "expected", None)
    if known is None and own:
        return lambda values: float(values.dot(information.current))
    return known


def reward_rows(
    given: npt.ArrayLike | None, model: MDP | None, symbols: Symbols
) -> Sequence[Vector] | RewardRows | None:
    """Return R as a row of S numbers for each action; of a model that stays factored none of them is made."""
    if given is None and model is None:
        return None
    if given is None and model is not None and model.network is not None and model.stays_factored:
        return RewardRows(model.network)
    rewards = model.rewards if given is None and model is not None else given
    try:
        array = np.asarray(rewards, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"rewards are a states x actions array of numbers: {error}", key="rewards") from None
    if array.ndim != 2:
        raise ConfigError(f"rewards are a states x actions array, not of shape {array.shape}", key="rewards")
    if not np.isfinite(array).all():
        state, action = (int(place[0]) for place in np.nonzero(~np.isfinite(array)))
        raise ConfigError(f"the reward of action {action} in state {state} is {array[state, action]}", key="rewards")
    states, actions = array.shape
    if (states, actions) != (symbols.num_states or states, symbols.policy.num_actions):
        raise ConfigError(
            f"the rewards are for {states} states and {actions} actions, but the policy is for "
            f"{symbols.num_states} and {symbols.policy.num_actions}",
            key="rewards",
        )
    return list(np.ascontiguousarray(array.T))


def with_false_negatives(model: MDP | None, symbol: Symbol) -> MDP:
    """Return a model in which a symbol of observation is a false negative."""
    if model is None or model.pomdp is None:
        raise ConfigError(
            "false negatives need a POMDP to track the belief, but there is none",
            key="false_negative",
        )
    try:
        return model.with_false_negatives(symbol)
    except ModelError as error:
        raise ConfigError(str(error), key="false_negative") from None


def within(memory: float | None, model: MDP | None, policy: Policy, *, tracked: bool) -> MDP | None:
    """Return a model that takes no more memory than it may; refuse one that would, before anything of it is made.

    Args:
        memory: The most megabytes; None for the machine's free memory.
        model: The model, if there is one.
        policy: The policy.
        tracked: Whether the controller tracks the belief, if the policy is over beliefs.
    """
    kind = getattr(policy, "input", "belief")
    if model is None or kind == "observation":  # a plan, which needs nothing of the model but names
        return model
    held = model if memory is None else spared(model)
    search = "a search" if getattr(policy, "deliberates", False) else None
    check_memory(held, memory, beliefs=tracked and kind == "belief", matrices=search)
    return held


def seeded(policy: Policy, seed: int) -> Policy:
    """Return a policy that draws by a seed; the one that was given stays as it is."""
    if not hasattr(policy, "seed"):
        raise ConfigError("a seed is for policies that draw their actions, which this one does not", key="seed")
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ConfigError(f"a seed is a whole number from 0 on, not {seed!r}", key="seed")
    own = copy.copy(policy)
    own.seed(int(seed))
    return own
