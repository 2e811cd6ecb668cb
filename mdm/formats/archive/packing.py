"""A policy of any kind as a few arrays and whole numbers, and back: what a policy's archive holds."""

from __future__ import annotations

from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import ModelError
from mdm.formats.cassandra.model import LARGEST
from mdm.policies import (
    AlphaVectors,
    DeterministicPolicy,
    FiniteStateController,
    JointController,
    MaskedAlphaVectors,
    MixedAlphaVectors,
    QTable,
    StagedPolicy,
    StochasticPolicy,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    import numpy.typing as npt

    from mdm.formats.fit import LoadedPolicy

    Arrays = Mapping[str, npt.NDArray[Any]]
    Packed = tuple[str, dict[str, int], dict[str, npt.NDArray[Any]]]

__all__ = ["pack", "unpack"]


def pack(policy: LoadedPolicy) -> Packed:
    """Return a policy's kind, its sizes and its arrays."""
    match policy:
        case DeterministicPolicy():
            return "deterministic", {"actions": policy.num_actions}, {"actions": _whole(policy.actions)}
        case StochasticPolicy():
            return "stochastic", {}, {"probabilities": policy.probabilities}
        case QTable() | StagedPolicy():
            return "q" if isinstance(policy, QTable) else "staged", {}, {"values": policy.values}
        case AlphaVectors():
            arrays = {"vectors": policy.vectors, "actions": _whole(policy.actions)}
            return "alpha", {"actions": policy.num_actions}, arrays
        case MixedAlphaVectors():
            return _pack_mixed(policy)
        case MaskedAlphaVectors():
            arrays = {
                "starts": np.cumsum([0, *map(len, policy.vectors)], dtype=np.int64),
                "states": _whole(chain.from_iterable(policy.vectors)),
                "values": np.array([value for vector in policy.vectors for value in vector.values()], dtype=np.float64),
                "actions": _whole(policy.actions),
            }
            return "masked", {"actions": policy.num_actions, "states": policy.num_states}, arrays
        case FiniteStateController():
            return "controller", *_pack_controller(policy, "")
        case JointController():
            sizes, arrays = {"agents": policy.num_agents}, {}
            for agent, controller in enumerate(policy.controllers):
                own_sizes, own_arrays = _pack_controller(controller, f"agent{agent}_")
                sizes |= own_sizes
                arrays |= own_arrays
            return "joint", sizes, arrays


def unpack(kind: str, sizes: Mapping[str, int], arrays: Arrays, seed: int | None = None) -> LoadedPolicy:
    """Return the policy that was packed.

    Args:
        kind: Its kind.
        sizes: Its sizes.
        arrays: Its arrays.
        seed: For the draws of a stochastic policy.

    Raises:
        KeyError: If something is missing.
        ModelError: If something does not fit.
    """
    if any(not 0 <= size <= LARGEST for size in sizes.values()):
        raise ModelError(f"a size is not one of 0 to {LARGEST}")
    match kind:
        case "deterministic":
            return DeterministicPolicy(_list(arrays["actions"]), sizes["actions"])
        case "stochastic":
            return StochasticPolicy(arrays["probabilities"], seed=seed)
        case "q" | "staged":
            return (QTable if kind == "q" else StagedPolicy)(arrays["values"])
        case "alpha":
            return AlphaVectors(arrays["vectors"], _list(arrays["actions"]), sizes["actions"])
        case "mixed":
            return MixedAlphaVectors(
                arrays["vectors"],
                _list(arrays["actions"]),
                _list(arrays["observed"]),
                sizes["actions"],
                states=arrays["layout"],
            )
        case "masked":
            states, values = _list(arrays["states"]), arrays["values"].ravel().tolist()
            parts = pairwise(_list(arrays["starts"]))
            vectors = [dict(zip(states[a:b], values[a:b], strict=True)) for a, b in parts]
            return MaskedAlphaVectors(vectors, _list(arrays["actions"]), sizes["states"], sizes["actions"])
        case "controller":
            return _unpack_controller(sizes, arrays, "")
        case "joint":
            return JointController(_unpack_controller(sizes, arrays, f"agent{i}_") for i in range(sizes["agents"]))
    raise ModelError(f"{kind[:40]!r} is no kind of policy")


def _pack_mixed(policy: MixedAlphaVectors) -> Packed:
    sets = [(x, vectors) for x, vectors in enumerate(policy.sets) if vectors is not None]
    arrays = {
        "vectors": np.concatenate([vectors.vectors for _, vectors in sets]),
        "actions": _whole(chain.from_iterable(vectors.actions for _, vectors in sets)),
        "observed": _whole(x for x, vectors in sets for _ in vectors.actions),
        "layout": policy.states.astype(np.int64),
    }
    return "mixed", {"actions": policy.num_actions}, arrays


def _pack_controller(
    controller: FiniteStateController, prefix: str
) -> tuple[dict[str, int], dict[str, npt.NDArray[Any]]]:
    rows = [[-1 if node is None else node for node in row] for row in controller.successors]
    arrays: dict[str, npt.NDArray[Any]] = {
        f"{prefix}actions": _whole(controller.actions),
        f"{prefix}successors": np.array(rows, dtype=np.int64),
    }
    if controller.values is not None:
        arrays[f"{prefix}values"] = controller.values
    return {f"{prefix}actions": controller.num_actions, f"{prefix}start": controller.start}, arrays


def _unpack_controller(sizes: Mapping[str, int], arrays: Arrays, prefix: str) -> FiniteStateController:
    table = arrays[f"{prefix}successors"]
    if table.ndim != 2:
        raise ModelError(f"successors are a nodes x observations array, not one of shape {table.shape}")
    return FiniteStateController(
        _list(arrays[f"{prefix}actions"]),
        [[None if node == -1 else int(node) for node in row] for row in table.tolist()],
        sizes[f"{prefix}actions"],
        values=arrays.get(f"{prefix}values"),
        start=sizes[f"{prefix}start"],
    )


def _whole(numbers: Iterable[int]) -> npt.NDArray[np.int64]:
    return np.fromiter(numbers, dtype=np.int64)


def _list(array: npt.NDArray[Any]) -> list[int]:
    """Return an array of one dimension of whole numbers as a list.

    Raises:
        ModelError: If it is none.
    """
    if array.ndim != 1 or array.dtype.kind not in "iu":
        raise ModelError("an array of indices has other numbers or dimensions")
    whole: list[int] = array.tolist()
    return whole
