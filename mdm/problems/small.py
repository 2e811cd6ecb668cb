"""Small problems of one agent, in any size: a shared channel, a forest, a cart, a river."""

from __future__ import annotations

import math

import numpy as np

from mdm.errors import ModelError
from mdm.models import MDP, POMDP, Factor, Space
from mdm.problems.parameters import checked


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


@checked
def forest(
    ages: int = 3, *, fire: float = 0.1, old_reward: float = 4.0, cut_reward: float = 2.0, discount: float = 0.9
) -> MDP:
    """Return the forest problem: whether to cut a forest or to let it grow, under the risk of fire.

    Waiting makes the forest a class older, unless a fire burns it down; the oldest class pays for being left alone.
    Cutting pays 1, nothing for the youngest class, and another sum for the oldest.

    As many states as there are ages, 2 actions. By default the values of the states are 26.244, 29.484 and 33.484:
    never cut.

    Source: the example of I. Chadès, G. Chapron, M.-J. Cros, F. Garcia and R. Sabbadin, *MDPtoolbox: a multi-platform
    toolbox to solve stochastic dynamic programming problems*, Ecography 37, 2014.

    Args:
        ages: How many classes of age there are; at least 2.
        fire: The probability of a fire in a year without cutting.
        old_reward: The reward of leaving the oldest forest alone.
        cut_reward: The reward of cutting the oldest forest.
        discount: In (0, 1].

    Raises:
        ModelError: If there are fewer than two ages, or the risk of fire is not a probability.
    """
    if ages < 2:
        raise ModelError(f"a forest needs at least two classes of age, not {ages}")
    if not 0 <= fire <= 1:
        raise ModelError(f"the risk of fire is a probability, not {fire}")
    age = np.arange(ages)
    wait, cut = np.zeros((2, ages, ages))
    wait[age, np.minimum(age + 1, ages - 1)] = 1 - fire
    wait[:, 0] += fire
    cut[:, 0] = 1
    rewards = np.zeros((ages, 2))
    rewards[-1, 0] = old_reward
    rewards[1:, 1] = 1
    rewards[-1, 1] = cut_reward
    return MDP(
        [wait, cut],
        rewards,
        discount=discount,
        states=[f"age-{number}" for number in age],
        actions=["wait", "cut"],
        initial_belief=np.eye(ages)[0],
    )


@checked
def load_unload(positions: int = 8, *, discount: float = 0.95) -> POMDP:
    """Return the load/unload problem: a cart that goes to and fro on a track, and sees only its two ends.

    At the right end the cart is loaded, at the left end it is unloaded, which pays 1. It does not see whether it is
    loaded, nor where between the ends it is. It begins at the left end, unloaded.

    2 x positions - 2 states: 14 in the paper. 2 actions, 3 observations. The best policy goes from end to end; with
    n = 2 x positions - 2 it is worth discount^(n - 1) / (1 - discount^n), which is 1.0020 by default.

    Source: N. Meuleau, K.-E. Kim, L. P. Kaelbling and A. R. Cassandra, *Solving POMDPs by searching the space of finite
    policies*, Uncertainty in Artificial Intelligence, 1999, section 5.

    Args:
        positions: How many places the track has, the ends included; at least 2.
        discount: In (0, 1].

    Raises:
        ModelError: If there are fewer than two positions.
    """
    if positions < 2:
        raise ModelError(f"the track needs at least its two ends, not {positions} positions")
    last = positions - 1
    # Empty at 0 .. last - 1, then loaded at 1 .. last: at the ends the cart is unloaded or loaded at once.
    place = np.r_[0:last, 1 : last + 1]
    loaded = np.arange(2 * last) >= last
    transitions = np.zeros((2, 2 * last, 2 * last))
    rewards = np.zeros((2 * last, 2))
    for action, step in enumerate((-1, 1)):
        there = np.clip(place + step, 0, last)
        full = (there == last) | (loaded & (there > 0))
        transitions[action, np.arange(2 * last), np.where(full, there + last - 1, there)] = 1
        rewards[:, action] = loaded & (there == 0)
    seen = np.eye(3)[np.where(place == 0, 0, np.where(place == last, 2, 1))]
    return POMDP(
        transitions,
        [seen, seen],
        rewards,
        discount=discount,
        states=[f"{'loaded' if full else 'empty'}-{at}" for at, full in zip(place, loaded, strict=True)],
        actions=["left", "right"],
        observation_names=["unload-end", "between", "load-end"],
        initial_belief=np.eye(2 * last)[0],
    )


@checked
def river_swim(
    length: int = 6, *, left_reward: float = 5.0, right_reward: float = 10_000.0, discount: float = 0.95
) -> MDP:
    """Return river swim: a small reward at the left end is easy to get, a large one at the right end hard.

    Swimming left always succeeds and pays at the left end. Swimming right, against the current, gets on with a
    probability of 0.3, and is driven back with one of 0.1 (0.7 at the right end); staying at the right end pays.

    As many states as the river is long, 2 actions. The swimmer begins in one of the two states beside the left end.

    Source: A. L. Strehl and M. L. Littman, *An analysis of model-based interval estimation for Markov decision
    processes*, Journal of Computer and System Sciences 74, 2008, section 5.

    Args:
        length: How many states there are; at least 3.
        left_reward: The reward of swimming left at the left end.
        right_reward: The reward of holding out at the right end.
        discount: In (0, 1].

    Raises:
        ModelError: If there are fewer than three states.
    """
    if length < 3:
        raise ModelError(f"a river needs at least three states, not {length}")
    place = np.arange(length)
    left, right = np.zeros((2, length, length))
    left[place, np.maximum(place - 1, 0)] = 1
    right[place[:-1], place[1:]] = 0.3
    right[place[1:], place[:-1]] = 0.1
    right[place, place] = 0.6
    right[0, 0] = 0.7
    right[-1, -2:] = 0.7, 0.3
    rewards = np.zeros((2, length, length))
    rewards[0, 0, 0] = left_reward
    rewards[1, -1, -1] = right_reward
    return MDP(
        [left, right],
        rewards,
        discount=discount,
        states=[f"place-{number}" for number in place],
        actions=["left", "right"],
        initial_belief=np.isin(place, [1, 2]) / 2,
    )
