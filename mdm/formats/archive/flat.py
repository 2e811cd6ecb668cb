"""The matrices of factored models in files that all processes of a user map into memory, see `Store`.

A process that needs the matrices of a model (a search, false negatives, a filter over all states) and that is to take
little memory does not hold them itself. They are made once on a machine, by the first of them, and all have the same
pages. What is mapped is equal to the last bit to what the model's own process would make.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, TypeVar, cast
from weakref import WeakValueDictionary

import msgspec
import numpy as np

from mdm.errors import ModelWarning
from mdm.formats.archive.store import Store, StoreError, user_folder
from mdm.models import MDP, POMDP
from mdm.models.digest import digest, of_parts
from mdm.models.dynamics import Rows, distinct, stacked
from mdm.models.events import DenseEvents, TransitionEvents
from mdm.models.matrices import Checked, csr, is_compressed, read_only
from mdm.version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import numpy.typing as npt

    from mdm.models.matrices import Matrix

__all__ = ["mapped"]

_FORM = 1
"""The version of what is in a file, and of how it is computed."""
_LEAST = 1_000_000
"""The bytes of matrices from which a file is worth its while."""

_Flat = TypeVar("_Flat", bound=MDP)

_here: WeakValueDictionary[str, MDP] = WeakValueDictionary()
"""What this process has mapped already."""


class _Header(msgspec.Struct):
    format: str = "mdm flat 1"


def mapped(model: MDP, make: Callable[[], _Flat]) -> _Flat:
    """Return the matrices of a factored model, mapped from a file; where that cannot be, in this process's own memory.

    Args:
        model: The factored model.
        make: Makes the matrices; called once at most.
    """
    if model.matrix_size.total < _LEAST:
        return make()
    own: list[_Flat] = []

    def written() -> tuple[_Header, dict[str, npt.NDArray[Any]]]:
        own.append(make())
        return _Header(), _packed(own[0])

    try:
        folder = user_folder()
        if folder is None:
            return make()
        # The digest of all that the matrices follow from.
        key = of_parts([__version__, _FORM, np.__version__, type(model).__name__, model.sparse, digest(model)])
        known = _here.get(key)
        if known is None:
            _, arrays = Store(folder).obtain(key, written)
            known = _here[key] = _model(model, arrays)
    except StoreError as error:
        text = f"the model's matrices are not shared with other processes, which takes more memory: {error}"
        warnings.warn(text, ModelWarning, stacklevel=2)
        return own[0] if own else make()
    return cast("_Flat", known)


def _packed(model: MDP) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays that a flat model is made of."""
    actions = range(len(model.action_space))
    arrays = {"R": model.rewards}
    _pack("T", [model.transition_matrix(action) for action in actions], arrays)
    if (pomdp := model.pomdp) is None:
        return arrays
    if pomdp.events is None:
        _pack("O", [pomdp.observation_matrix(action) for action in actions], arrays)
    elif isinstance(pomdp.events, DenseEvents):
        arrays["E"] = np.stack(pomdp.events.events)
    elif isinstance(pomdp.events, TransitionEvents):
        events = pomdp.events.events  # of all actions, in CSC: entries of T x O
        arrays |= {
            "E.values": np.concatenate([matrix.data for matrix in events]),
            "E.entries": np.concatenate([matrix.indices for matrix in events]),
            "E.starts": np.stack([matrix.indptr for matrix in events]),
            "E.cuts": np.cumsum([0, *(matrix.nnz for matrix in events)]),
        }
    return arrays


def _pack(name: str, matrices: Sequence[Matrix], arrays: dict[str, npt.NDArray[Any]]) -> None:
    """Add the matrices of all actions, those that several actions share once; sparse ones as `Rows`."""
    kept, places = distinct(matrices)
    arrays[f"{name}.places"] = np.array(places)
    if not is_compressed(kept[0]):
        arrays[name] = np.stack(kept)
        return
    rows = stacked(matrices)
    arrays |= {
        f"{name}.first": rows.first,
        f"{name}.starts": rows.starts.view(np.int64),
        f"{name}.columns": rows.columns.view(np.int32),
        f"{name}.values": rows.values,
        # Where each row begins within its own matrix, and that matrix within all.
        f"{name}.rows": np.stack([matrix.indptr for matrix in kept]),
        f"{name}.cuts": np.cumsum([0, *(matrix.nnz for matrix in kept)]),
    }


def _model(model: MDP, arrays: Mapping[str, npt.NDArray[Any]]) -> MDP:
    """Return the flat model of which these are the arrays."""
    size = len(model.state_space)
    transitions, moved = _matrices("T", arrays, size, size)
    stacks = {"T": moved}
    common: dict[str, Any] = {
        "discount": model.discount,
        "states": model.state_space,
        "actions": model.action_space,
        "initial_belief": model.initial_belief,
        "outcome_rewards": model.outcome_rewards,
    }
    rewards = Checked([read_only(arrays["R"].view())])
    if model.observation_space is None:
        flat = MDP(transitions, rewards, **common)
    else:
        names = {"actions": model.action_space, "states": model.state_space}
        told: Any
        if "E" in arrays:
            told = DenseEvents(transitions, list(arrays["E"]), **names)
        elif "E.values" in arrays:
            told = TransitionEvents(transitions, _events(arrays, transitions, len(model.observation_space)), **names)
        else:
            told, stacks["O"] = _matrices("O", arrays, size, len(model.observation_space))
        flat = POMDP(transitions, told, rewards, observation_names=model.observation_space, **common)
    flat.stacked = {name: rows for name, rows in stacks.items() if rows is not None} | {"R": arrays["R"]}
    return flat.timed_as(model)


def _matrices(
    name: str, arrays: Mapping[str, npt.NDArray[Any]], height: int, width: int
) -> tuple[Checked, Rows | None]:
    """Return a matrix for each action, and where they are sparse all below each other; both have the same memory."""
    places = arrays[f"{name}.places"].tolist()
    if name in arrays:
        whole = [read_only(matrix) for matrix in arrays[name]]
        return Checked(whole[place] for place in places), None
    first, starts, columns, values, rows, cuts = (
        arrays[f"{name}.{part}"] for part in ("first", "starts", "columns", "values", "rows", "cuts")
    )
    kept = [
        read_only(csr((values[start:end], columns[start:end], own), (height, width), copy=False))
        for own, start, end in zip(rows, cuts[:-1].tolist(), cuts[1:].tolist(), strict=True)
    ]
    stack = Rows(first, starts.view(np.uint64), columns.view(np.uint32), values)
    return Checked(kept[place] for place in places), stack


def _events(arrays: Mapping[str, npt.NDArray[Any]], transitions: Sequence[Matrix], width: int) -> list[Matrix]:
    from scipy.sparse import csc_array  # noqa: PLC0415 - slow to import

    values, entries, starts, cuts = (arrays[f"E.{part}"] for part in ("values", "entries", "starts", "cuts"))
    return [
        csc_array((values[start:end], entries[start:end], own), (transition.nnz, width), copy=False)
        for transition, own, start, end in zip(transitions, starts, cuts[:-1].tolist(), cuts[1:].tolist(), strict=True)
    ]
