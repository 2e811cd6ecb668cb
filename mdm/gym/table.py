"""Models from the tables of transitions of Gymnasium's tabular environments."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from mdm.errors import ModelError
from mdm.models import MDP

_END = "terminated"


def model(
    env: Any, *, discount: float, initial: Any = None, states: Iterable[str] = (), actions: Iterable[str] = ()
) -> MDP:
    """Return the MDP of a tabular environment, such as Gymnasium's FrozenLake, Taxi and CliffWalking.

    ``env.unwrapped.P[s][a]`` is a list of (probability, next state, reward, terminated). Outcomes that are terminated
    earn their reward and lead to one more state, the last, ``terminated``: it is absorbing and earns nothing. A limit
    of time is no part of the table, nor is anything else that ``step`` adds, such as Taxi's fickle passengers.

    Args:
        env: The environment.
        discount: In (0, 1], of a step.
        initial: A state, or a probability by state; by default the environment's ``initial_state_distrib`` or ``isd``,
            else the state in which 100 resets begin.
        states: Names of the states, in the order of the table; by default their numbers.
        actions: The same of actions.

    Raises:
        ModelError: If there is no table, something in it is wrong, or the first state is not known.

    Example::

        lake = mdm.gym.model(gymnasium.make("FrozenLake-v1"), discount=0.99, actions=["left", "down", "right", "up"])
        mdm.solve(lake).policy.action(0)  # 0: left
    """
    base = getattr(env, "unwrapped", env)
    rows = {state: _items(row) for state, row in _items(getattr(base, "P", None)).items()}
    if not any(rows.values()):
        raise ModelError(f"{type(base).__name__} has no table P[state][action]: describe it by mdm.MDP.from_functions")
    state_of = _named(states, rows, "state")
    action_of = _named(actions, dict.fromkeys(action for row in rows.values() for action in row), "action")
    outcomes = {
        (state_of[state], action_of[action]): _merged(found, state_of, f"P[{state!r}][{action!r}]")
        for state, row in rows.items()
        for action, found in row.items()
    }
    ends = [_END] if any(_END in each for each in outcomes.values()) else []
    stays, every = {_END: (1.0, 0.0)}, len(outcomes) == len(state_of) * len(action_of)
    return MDP.from_functions(
        [*state_of.values(), *ends],
        [*action_of.values()],
        transition=lambda s, a: {to: chance for to, (chance, _) in outcomes.get((s, a), stays).items()},
        reward=lambda s, a, to: outcomes.get((s, a), stays)[to][1],
        discount=discount,
        initial=_first(base, initial, state_of),
        available=None if every else lambda s, a: s == _END or (s, a) in outcomes,
    )


def _items(given: Any) -> dict[Any, Any]:
    given = given.tolist() if isinstance(given, np.ndarray) else given
    if isinstance(given, Sequence) and not isinstance(given, str):
        return dict(enumerate(given))
    return dict(given) if isinstance(given, Mapping) else {}


def _named(names: Iterable[str], keys: Mapping[Any, Any], kind: str) -> dict[Any, Any]:
    if not isinstance(names, Iterable):
        raise ModelError(f"names of {kind}s are a list of texts, not {type(names).__name__}")
    given = [*names] or [*keys]
    if len(given) != len(keys):
        raise ModelError(f"names of {kind}s: as many as the environment has, {len(keys)}, are needed, not {len(given)}")
    return dict(zip(keys, given, strict=True))


def _merged(found: Any, state_of: Mapping[Any, Any], where: str) -> dict[Any, tuple[float, float]]:
    """Return the probability and the mean reward of each next state."""
    merged: dict[Any, tuple[float, float]] = {}
    try:
        for chance, state, reward, terminated in found:
            after = _END if terminated else state_of[state]
            before, mean = merged.get(after, (0.0, 0.0))
            total = before + float(chance)
            merged[after] = total, mean + (float(reward) - mean) * (float(chance) / total if total else 0.0)
    except (KeyError, TypeError, ValueError):
        raise ModelError(f"{where} is not [(probability, known state, reward, terminated), …]: {found!r}") from None
    return merged


def _first(base: Any, given: Any, state_of: Mapping[Any, Any]) -> dict[Any, float]:
    given = getattr(base, "initial_state_distrib", getattr(base, "isd", None)) if given is None else given
    if given is None:
        given, *others = [base.reset()[0] for _ in range(100)]
        if any(str(other) != str(given) for other in others):
            raise ModelError(f"{type(base).__name__} begins in several states: say initial={{state: probability}}")
    known = {name: name for name in state_of.values()} | dict(state_of)
    first = {given: 1.0} if isinstance(given, Hashable) and given in known else _items(given)
    if not first.keys() <= known.keys() or not first:
        raise ModelError(f"the first state is one of the table, or a probability by state, not {given!r}")
    return {known[state]: chance for state, chance in first.items() if chance}
