"""Whether a policy ends up for ever in states that it could be kept out of, on a way to better ones."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.texts import counted
from mdm.verification.chains import chain_of_policy
from mdm.verification.choices import Choices
from mdm.verification.reaching import reach

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models import MDP
    from mdm.models.matrices import Vector

_LARGEST = 50_000
"""States up to which it is looked at."""
_DIFFERENT = 1e-6


def avoidable_end(model: MDP, policy: Any) -> str | None:
    """Return a sentence about absorbing states that a policy reaches more often than needed; None if there are none.

    These are worth less than the best absorbing states that can be reached: by the rewards there, and on the most
    probable step into them.

    Args:
        model: The model.
        policy: A policy over its states; of others nothing is said.
    """
    size, count = len(model.state_space), len(model.action_space)
    if size > _LARGEST or getattr(policy, "input", None) != "state":
        return None
    stays = np.stack([np.asarray(model.transition_matrix(action).diagonal()) for action in range(count)])
    absorbing = (stays == 1).all(axis=0)
    if absorbing.sum() < 2 or (chain := chain_of_policy(model, policy)) is None or len(chain.state) != size:
        return None
    worth = _worth(model, absorbing)
    best = worth.max()
    good = absorbing & (worth >= best - _DIFFERENT * max(1, abs(best)))
    bad = absorbing & ~good & np.isfinite(worth)
    if not bad.any():
        return None
    its = Choices.of_chain(chain.moves, bad.astype(float), good.astype(float))
    ends = float(chain.start @ reach(its, greatest=True).values)
    masks = (np.repeat(each[:, None], count + 1, axis=1) for each in (good, bad))
    least = 1 - float(chain.start @ reach(Choices.of_model(model, *masks), greatest=True).values)
    if ends <= least + _DIFFERENT:
        return None
    name = model.state_space.names[int(np.flatnonzero(bad)[np.argmax(its.hit[bad])])]
    others = f" or {counted(int(bad.sum()) - 1, 'other absorbing state')}" if bad.sum() > 1 else ""
    goal = model.state_space.names[int(np.flatnonzero(good)[0])]
    return (
        f"the policy ends in {name!r}{others} with probability {ends:.3g}, and {least:.3g} is possible on a way to "
        f"{goal!r}: see mdm verify MODEL POLICY 'P(reach \"{name}\")'"
    )


def _worth(model: MDP, absorbing: npt.NDArray[np.bool_]) -> Vector:
    """Return the value of an end in each absorbing state; -inf for others, and for those that nothing enters."""
    worth, chance = np.full(len(absorbing), -np.inf), np.zeros(len(absorbing))
    ends = np.flatnonzero(absorbing)
    for action in range(len(model.action_space)):
        entries = model.transition_matrix(action)
        columns = entries[:, ends]
        into = np.array(columns.toarray() if hasattr(columns, "toarray") else columns)
        into[ends] = 0
        rows = into.argmax(axis=0)
        for place, (row, end) in enumerate(zip(rows.tolist(), ends.tolist(), strict=True)):
            if into[row, place] > chance[end]:
                chance[end] = into[row, place]
                stays = model.rewards[end].max()
                rest = stays / (1 - model.discount) if model.discount < 1 else stays
                worth[end] = model.reward(action, row, end) + model.discount * rest
    return worth
