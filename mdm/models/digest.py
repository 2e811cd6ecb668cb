"""Digests of models: a short text that identifies a model in any process, on any machine.

It covers names, discount and every bit of the numbers: a flat model's matrices, a factored model's network.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.models.factored import Tree
from mdm.models.matrices import is_compressed

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mdm.models.factored import Potential
    from mdm.models.factored.two_slice import TwoSliceNetwork
    from mdm.models.mdp import MDP

__all__ = ["digest", "of_bytes", "of_parts", "plain"]

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
    if model.pomdp is not None:
        spaces.append(model.pomdp.observation_space)
        head += model.pomdp.waiting
    head += [[[factor.name, list(factor.names)] for factor in space.factors] for space in spaces]
    if model.network is not None:
        return of_parts([*head, *_network(model.network)])
    return of_parts([*head, *_flat(model)])


def _flat(model: MDP) -> Iterable[Any]:
    yield model.rewards
    yield model.initial_belief
    for action in range(len(model.action_space)):
        yield model.transition_matrix(action)
        if (pomdp := model.pomdp) is not None:
            if not pomdp.event_observations:
                yield pomdp.observation_matrix(action)
                continue
            for observation in range(len(pomdp.observation_space)):
                yield pomdp.event_matrix(action, observation)


def _network(network: TwoSliceNetwork) -> Iterable[Any]:
    yield list(network.fully_observed)
    yield network.event_observations
    for potentials in (network.initial, network.transitions, network.observation, network.utilities):
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
