"""Returns: the rewards of each episode's decisions, as the model in use expected, or as a simulated world has paid."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.estimation.chains import BREAKS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mdm.estimation.chains import Chain
    from mdm.models.mdp import MDP

__all__ = ["returns_of"]

_EPISODES = BREAKS - {"resume", "release", "belief"}


def returns_of(model: MDP, chains: Iterable[Chain], *, in_time: bool = False, paid: bool = False) -> tuple[float, ...]:
    """Return the discounted return of each episode, in their order.

    An episode goes on across ticks that were missed, safe modes and beliefs from outside; a start, a reset or the
    stimulus after a horizon begins another one. Rewards are those of the decisions; decisions without one earn R(s, a),
    or its expectation under the belief. So a return is what the model in use expected, and not what the world has paid.

    Args:
        model: The model; its discount is that of a decision.
        chains: The chains.
        in_time: Whether the model's discount is that of a second.
        paid: Whether rewards are those that a simulated world has paid, of chains that tell these, and not the model's.
    """
    rewards = model.rewards
    returns: list[float] = []
    began, count = 0, 0
    for chain in chains:
        for place, decision in enumerate(chain.decisions):
            if not returns or (place == 0 and (decision.cause in _EPISODES or decision.epoch == 0)):
                returns.append(0.0)
                began, count = decision.time, 0
            earned = decision.reward if not paid else chain.paid[place] if place < len(chain.paid) else 0.0
            if earned is None and decision.state is not None:
                earned = float(rewards[decision.state, decision.action])
            elif earned is None and decision.belief is not None:
                earned = float(decision.belief @ rewards[:, decision.action])
            passed = (decision.time - began) / 1e9 if in_time else count
            returns[-1] += model.discount**passed * (earned or 0.0)
            count += 1
    return tuple(returns)
