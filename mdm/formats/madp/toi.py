"""MADP's ``.toi-dpomdp`` sets: Dec-POMDPs with transition and observation independence and joint rewards.

The ``.base`` file has the number of agents and the discount, a line each. ``.agent0``, ``.agent1`` and so on are
``.dpomdp`` files of one agent. A line of ``.rewards`` has each agent's state, each agent's action, and a reward that is
added to the agents' own. The first agent is the most significant in joint states, actions and observations; T and O are
Kronecker products. ``.interactionStates`` and ``.interactionReward`` repeat the rewards for MADP's planners and are not
read.
"""

from __future__ import annotations

import math
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.formats.madp import dpomdp
from mdm.formats.source import Source, number
from mdm.models import POMDP, Factor, Space
from mdm.models.matrices import csr

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mdm.models.matrices import Matrix, Vector

_MOST_AGENTS = 20
_LARGEST = 100_000_000


def read(path: str | Path, *, sparse: bool | None = None) -> POMDP:
    """Read the team's model.

    Args:
        path: The ``.base`` file, or the common stem of the set's files.
        sparse: Force CSR (True) or dense (False) matrices; None chooses by size and density.

    Raises:
        FormatError: If a file is missing or malformed, with the place and the expected form.
    """
    source = Source(path if Path(path).suffix == ".base" else f"{path}.base")
    count, discount = _base(source)
    stem = source.path.with_suffix("")
    agents = []
    for agent in range(count):
        file = Path(f"{stem}.agent{agent}")
        model = dpomdp.read(file)
        if model.num_agents != 1:
            Source(file).fail(f"a file of one agent was expected, but this has {model.num_agents}")
        agents.append(model)
    states, actions, observations = (_joint(agents, of) for of in ("state_space", "action_space", "observation_space"))
    try:
        rewards = _own_rewards(agents)
        _add_rewards(Source(f"{stem}.rewards"), rewards)
        transitions = _products(agents, actions, lambda model, action: model.transition_matrix(action))
        observed = _products(agents, actions, lambda model, action: model.observation_matrix(action))
        return POMDP(
            transitions,
            observed,
            rewards.reshape(len(states), len(actions)),
            discount=discount,
            states=states,
            actions=actions,
            observation_names=observations,
            initial_belief=reduce(_outer, [model.initial_belief for model in agents]),
            sparse=sparse,
        )
    except ModelError as error:
        source.fail(str(error))
    except MemoryError:
        source.fail("the team's model is too large for this machine's memory")


def _outer(left: Vector, right: Vector) -> Vector:
    return np.multiply.outer(left, right).ravel()


def _base(source: Source) -> tuple[int, float]:
    lines = [(at, line.strip()) for at, line in enumerate(source.text.split("\n"), 1) if line.strip()]
    at, text = lines[0]
    if not text.isdecimal() or not 0 < int(text[:9]) <= _MOST_AGENTS:
        source.fail(f"a number of agents from 1 to {_MOST_AGENTS} was expected, not {text[:40]!r}", line=at)
    if len(lines) < 2:
        source.fail("a second line, with the discount, was expected", line=at)
    at, stated = lines[1]
    discount = number(stated)
    if discount is None or not 0 < discount <= 1:
        source.fail(f"a discount is more than 0 and at most 1, not {stated[:40]!r}", line=at)
    return int(text), discount


def _joint(agents: Sequence[POMDP], of: str) -> Space:
    factors = [getattr(model, of).factors[0] for model in agents]
    return Space(Factor(f"agent{agent}", factor.names) for agent, factor in enumerate(factors))


def _own_rewards(agents: Sequence[POMDP]) -> npt.NDArray[np.float64]:
    """Return the sum of the agents' own rewards; axes are each agent's states, then each agent's actions."""
    count = len(agents)
    shape = [*(len(model.state_space) for model in agents), *(len(model.action_space) for model in agents)]
    total = math.prod(shape)
    if total > _LARGEST:
        raise ModelError(f"{total} joint states and actions exceed the limit of {_LARGEST}")
    rewards = np.zeros(shape)
    for agent, model in enumerate(agents):
        own = [1] * (2 * count)
        own[agent], own[count + agent] = model.rewards.shape
        rewards += model.rewards.reshape(own)
    return rewards


def _add_rewards(source: Source, rewards: npt.NDArray[np.float64]) -> None:
    """Add the rewards of a file; a later line for the same states and actions replaces an earlier one."""
    shape = rewards.shape
    extra = np.zeros(shape)
    for at, line in enumerate(source.text.split("\n"), 1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        if len(words) != len(shape) + 1:
            expected = f"{len(shape) // 2} states, {len(shape) // 2} actions and a reward were expected"
            source.fail(f"{expected}, not {len(words)} words", line=at)
        value = number(words[-1])
        if value is None or not math.isfinite(value):
            source.fail(f"{words[-1][:40]!r} is not a finite number", line=at)
        for place, (word, size) in enumerate(zip(words, shape, strict=False)):
            if not word.isdecimal() or len(word) > 9 or int(word) >= size:
                what = "state" if 2 * place < len(shape) else "action"
                agent = place % (len(shape) // 2)
                source.fail(f"{word[:40]!r} is not one of agent {agent}'s {what}s, 0 to {size - 1}", line=at)
        extra[tuple(map(int, words[:-1]))] = value
    rewards += extra


def _products(agents: Sequence[POMDP], actions: Space, matrix: Callable[[POMDP, int], Matrix]) -> list[Any]:
    """Return the Kronecker product of the agents' matrices for each joint action."""
    from scipy.sparse import kron  # noqa: PLC0415 - takes as long to import as all the rest

    own = [[matrix(model, action) for action in range(len(model.action_space))] for model in agents]
    done: dict[tuple[int, ...], Any] = {}
    result = []
    for joint in range(len(actions)):
        factors = [matrices[action] for matrices, action in zip(own, actions.unravel(joint), strict=True)]
        key = tuple(map(id, factors))  # actions with the same factors share their matrix
        if key not in done:
            done[key] = reduce(lambda left, right: kron(left, right, format="csr"), map(csr, factors))
        result.append(done[key])
    return result
