"""Whether models are the same: digests, and the first entry by which two differ, in words.

A digest is a short text that identifies a model in any process, on any machine. It covers names, discount and every bit
of the numbers: a flat model's matrices, a factored model's network.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.models.factored import Tree
from mdm.models.matrices import csr, is_compressed
from mdm.models.units import in_words

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from mdm.models.factored import Potential
    from mdm.models.factored.two_slice import TwoSliceNetwork
    from mdm.models.mdp import MDP
    from mdm.models.pomdp import POMDP

_MANY = 32
"""A model of more actions has one part for all of their matrices."""
_SHORT = 12

_encode = msgspec.msgpack.Encoder().encode


def of_parts(parts: Iterable[Any]) -> str:
    """Return the digest of arrays, matrices, and plain values (numbers, strings, None, lists of these)."""
    total = hashlib.blake2b(digest_size=16)
    for part in parts:
        if is_compressed(part):
            matrix = part.tocsr()
            total.update(of_parts([matrix.shape[0], matrix.shape[1], *_entries(matrix)]).encode())
        elif isinstance(part, np.ndarray):
            total.update(f"{part.dtype.str}{part.shape}".encode())
            total.update(np.ascontiguousarray(part).reshape(-1).view(np.uint8).data)
        else:
            total.update(msgspec.msgpack.encode(part, enc_hook=plain))
    return total.hexdigest()


def of_bytes(part: bytes) -> str:
    """Return the digest of these bytes alone, the same as of `of_parts`, and sooner."""
    return hashlib.blake2b(_encode(part), digest_size=16).hexdigest()


def plain(value: Any) -> Any:
    """Return a number of numpy as the plain one that it stands for, and an array as a list of these, for msgspec."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"a digest is of numbers, strings, lists and arrays, not of {value!r}")


def digest(model: MDP) -> str:
    """Return the digest of a model."""
    spaces = [model.state_space, model.action_space]
    head: list[Any] = [model.kind, model.discount, model.false_negative]
    head += [] if model.discount_of == "step" else [model.discount_of]
    if model.pomdp is not None:
        spaces.append(model.pomdp.observation_space)
        head += model.pomdp.waiting
    head += [[[factor.name, list(factor.names)] for factor in space.factors] for space in spaces]
    if model.network is not None:
        return of_parts([*head, *_network(model.network)])
    return of_parts([*head, *_flat(model)])


def parts(model: MDP) -> dict[str, str]:
    """Return the parts of a model, by names in words: numbers and symbols as they are, and digests of arrays.

    There are at most some seventy, whatever the model: beyond 32 actions, one is of the matrices of all actions.
    """
    unit = "" if model.discount_of == "step" else f" of {in_words(model.discount_of)}"
    told = {"discount": f"{model.discount!r}{unit}"}
    spaces = {"states": model.state_space, "actions": model.action_space}
    if model.pomdp is not None:
        spaces["observations"] = model.pomdp.observation_space
        told["false negative"] = f"{model.false_negative!r}"
        told["waiting"] = short(model.pomdp.waiting)
    for name, space in spaces.items():
        told[f"number of {name}"] = str(len(space))
        told[f"list of {name}"] = short([[factor.name, list(factor.names)] for factor in space.factors])
    if model.network is not None:
        network = model.network
        told["initial belief"] = short(_of_potentials(network.initial))
        told["transition function"] = short(_of_potentials(network.transitions))
        told["observation function"] = short(_of_potentials(network.observation))
        told["reward function"] = short(_of_potentials(network.utilities))
        told["form"] = short([list(network.fully_observed), network.event_observations])
        return told
    told["initial belief"] = short([model.initial_belief])
    actions = range(len(model.action_space))
    groups = [(f" of action {model.action_space.names[each]!r}", [each]) for each in actions]
    for name, group in groups if len(groups) <= _MANY else [("", list(actions))]:
        told[f"transition function{name}"] = short(model.transition_matrix(action) for action in group)
        if model.pomdp is not None:
            told[f"observation function{name}"] = short(
                matrix for action in group for matrix in _observation_matrices(model.pomdp, action)
            )
    told["reward function"] = short([model.rewards])
    if model.available is not None:
        told["available actions"] = short([model.available])
    return told


def short(values: Iterable[Any]) -> str:
    """Return a short digest, which begins with ``#``, for one of many in a list."""
    return f"#{of_parts(values)[:_SHORT]}"


def _flat(model: MDP) -> Iterable[Any]:
    if model.available is not None:
        yield model.available
    yield model.rewards
    yield model.initial_belief
    for action in range(len(model.action_space)):
        yield model.transition_matrix(action)
        if model.pomdp is not None:
            yield from _observation_matrices(model.pomdp, action)


def _observation_matrices(pomdp: POMDP, action: int) -> Iterable[Any]:
    if not pomdp.event_observations:
        yield pomdp.observation_matrix(action)
        return
    for observation in range(len(pomdp.observation_space)):
        yield pomdp.event_matrix(action, observation)


def _network(network: TwoSliceNetwork) -> Iterable[Any]:
    yield list(network.fully_observed)
    yield network.event_observations
    for potentials in (network.initial, network.transitions, network.observation, network.utilities):
        yield from _of_potentials(potentials)


def _of_potentials(potentials: Sequence[Potential]) -> Iterable[Any]:
    yield len(potentials)
    for potential in potentials:
        yield from _potential(potential)


def _potential(potential: Potential) -> Iterable[Any]:
    if isinstance(potential, Tree):
        yield [list(potential.node), potential.choice.tolist(), len(potential.branches)]
        for branch in potential.branches:
            yield from _potential(branch)
    else:
        yield [list(node) for node in potential.scope]
        yield potential.values


def _entries(matrix: Any) -> list[Any]:
    return [matrix.indptr.astype(np.int64), matrix.indices.astype(np.int64), matrix.data]


# -- Differences -------------------------------------------------------------------------------------------------------


def first_difference(then: MDP, now: MDP) -> str | None:
    """Return in words the first entry of a model that is another than in an earlier one.

    Spaces come first, then the discount, transitions, observations and rewards, by actions and rows.

    Args:
        then: The earlier one.
        now: The model.

    Returns:
        The sentence; None where no entry differs, or the models are factored, whose entries are not laid out.

    Example:
        >>> from mdm.models import MDP
        >>> first_difference(MDP([[[1.0]]], [[0]], discount=0.9), MDP([[[1.0]]], [[2]], discount=0.9))
        "the reward of '0' in '0' was 0, and is 2"
    """
    for kind, was, is_now in _spaces(then, now):
        if was != is_now:
            return f"the {kind} were {was}, and are {is_now}"
    if then.discount_of != now.discount_of:
        return f"the discount was of {in_words(then.discount_of)}, and is of {in_words(now.discount_of)}"
    if then.discount != now.discount:
        return f"the discount was {then.discount:.12g}, and is {now.discount:.12g}"
    if then.network is not None or now.network is not None:
        return None
    return next(_differing(then, now), None)


def _spaces(then: MDP, now: MDP) -> Iterator[tuple[str, str, str]]:
    """Yield the first names of each kind that differ; their numbers where these do."""
    for kind in ("state", "action", "observation"):
        was, is_now = (getattr(each, f"{kind}_space", None) for each in (then, now))
        sizes = [0 if space is None else len(space) for space in (was, is_now)]
        yield f"numbers of {kind}s", str(sizes[0]), str(sizes[1])
        for one, other in zip(was.names if was else (), is_now.names if is_now else (), strict=False):
            yield f"names of a {kind}", one, other


def _differing(then: MDP, now: MDP) -> Iterator[str]:
    """Yield the first entry of each matrix that differs."""
    states, actions = now.state_space.names, now.action_space.names
    every = np.ones(now.rewards.shape, dtype=bool)
    was, is_now = (every if model.available is None else model.available for model in (then, now))
    for row, column in np.argwhere(was != is_now):
        yield f"whether {actions[column]!r} is available in {states[row]!r} is another thing"
    for action, name in enumerate(actions):
        found = _first(then.transition_matrix(action), now.transition_matrix(action))
        if found is not None:
            row, column, told = found
            yield f"the probability of {states[column]!r} after {name!r} in {states[row]!r} {told}"
    if then.pomdp is not None and now.pomdp is not None:
        names = now.pomdp.observation_space.names
        if then.pomdp.event_observations or now.pomdp.event_observations:
            names = ()
        for action, name in enumerate(actions if names else ()):
            found = _first(then.pomdp.observation_matrix(action), now.pomdp.observation_matrix(action))
            if found is not None:
                row, column, told = found
                yield f"the probability of observing {names[column]!r} in {states[row]!r} after {name!r} {told}"
    found = _first(np.asarray(then.rewards), np.asarray(now.rewards))
    if found is not None:
        row, column, told = found
        yield f"the reward of {actions[column]!r} in {states[row]!r} {told}"


def _first(was: Any, is_now: Any) -> tuple[int, int, str] | None:
    """Return row and column of the first entry of two matrices that differs, and its old and new value in words."""
    if was.ndim != 2 or was.shape != is_now.shape:
        return None
    if is_compressed(was) != is_compressed(is_now):
        was, is_now = csr(was), csr(is_now)
    rows, columns = (was != is_now).nonzero()
    if not len(rows):
        return None
    first = np.lexsort((columns, rows))[0]
    row, column = int(rows[first]), int(columns[first])
    return row, column, f"was {was[row, column]:.12g}, and is {is_now[row, column]:.12g}"
