"""Slotted ALOHA: a radio channel that many stations share."""

from __future__ import annotations

import math

import numpy as np

from mdm.errors import ModelError
from mdm.models import POMDP, Factor, Space
from mdm.problems.parameters import checked

__all__ = ["aloha"]


@checked
def aloha(levels: int = 10, *, arrivals: float = 0.9, discount: float = 0.999) -> POMDP:
    """Return the slotted ALOHA problem: with which probability stations that wait for a channel should transmit.

    In each slot every station of the backlog transmits with the probability that the controller announces: 1, 1/2, and
    so on to 1/(levels - 1). The slot stays idle, carries a message, or is lost to a collision, and that alone is seen.
    New messages arrive by a Poisson process; the backlog has at most levels - 1. A slot pays levels - 1 less the
    backlog.

    3 x levels states (the backlog, and what became of the last slot), levels - 1 actions, 3 observations: 30, 9 and 3,
    as in A. R. Cassandra's file aloha.10, or 90, 29 and 3 as in aloha.30. Numbers that the files round to six digits
    are exact here.

    Source: A. R. Cassandra, *Exact and approximate algorithms for partially observable Markov decision processes*, PhD
    thesis, Brown University, 1998.

    Args:
        levels: How many values the backlog has, from 0; at least 2.
        arrivals: The mean number of new messages a slot.
        discount: In (0, 1].

    Raises:
        ModelError: If there are fewer than two levels, or the mean is negative.
    """
    if levels < 2:
        raise ModelError(f"the backlog needs at least two levels, not {levels}")
    if not 0 <= arrivals < math.inf:
        raise ModelError(f"the mean number of arrivals is a number of 0 or more, not {arrivals}")
    backlog = np.arange(levels)
    poisson = np.array([math.exp(-arrivals) * arrivals**count / math.factorial(count) for count in range(levels)])
    arrive = np.zeros((levels, levels))  # to a backlog, up to the last level
    for count in range(levels):
        arrive[count, count:] = poisson[: levels - count]
        arrive[count, -1] = 1 - arrive[count, :-1].sum()
    send = 1 / np.arange(1, levels)[:, None]
    idle = (1 - send) ** backlog
    success = backlog * send * (1 - send) ** np.maximum(backlog - 1, 0)
    after_success = arrive[np.maximum(backlog - 1, 0)]
    # By action, backlog, next backlog and what became of the slot.
    moved = np.stack(
        [idle[:, :, None] * arrive, success[:, :, None] * after_success, (1 - idle - success)[:, :, None] * arrive],
        axis=3,
    )
    moved = np.clip(moved, 0, 1).reshape(levels - 1, levels, 3 * levels)
    seen = np.tile(np.eye(3), (levels, 1))
    return POMDP(
        np.repeat(moved, 3, axis=1),
        [seen] * (levels - 1),
        np.repeat(levels - 1.0 - backlog, 3),
        discount=discount,
        states=Space([Factor("backlog", map(str, backlog)), Factor("slot", ["idle", "success", "collision"])]),
        actions=[f"send-1/{stations}" for stations in range(1, levels)],
        observation_names=["idle", "success", "collision"],
        initial_belief=np.eye(3 * levels)[0],
    )
