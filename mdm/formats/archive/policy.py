"""Policies of any kind with the names of their model: ``.npz`` archives of numpy's, of mdm's own.

An archive holds the arrays of the policy's class, and a header with its kind, its sizes, and the factors and names of
the states, actions and observations that it is for.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import msgspec

from mdm.errors import FormatError, ModelError
from mdm.formats.archive import npz
from mdm.formats.archive.npz import Names, names_of, space_of
from mdm.formats.cassandra.model import LARGEST
from mdm.models import POMDP
from mdm.policies import PACKABLE, mismatch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.models import MDP, Space
    from mdm.policies import Policy
    from mdm.policies.policy import Arrays

__all__ = ["read", "write"]


class _Header(msgspec.Struct):
    kind: str
    sizes: dict[str, int]
    states: list[Names] | None = None
    actions: list[Names] | None = None
    observations: list[Names] | None = None
    format: Literal["mdm policy 1"] = "mdm policy 1"


def read(path: str | Path, model: MDP | None = None, *, seed: int | None = None) -> Policy:
    """Return the policy in an archive.

    Args:
        path: The file.
        model: The model that it is for; sizes are checked, and names where the archive has them.
        seed: For the draws of a stochastic policy.

    Raises:
        FormatError: If the file is damaged or no such archive, or does not fit the model.
    """
    written, arrays = npz.read(Path(path))
    try:
        header = msgspec.json.decode(written, type=_Header)
        policy = _unpacked(header, arrays, seed)
        wrong = None if model is None else mismatch(policy, model) or _other_names(header, model)
    except KeyError as error:
        raise FormatError(f"the archive is no policy of mdm's: it has no {error}", file=path) from None
    except (ModelError, msgspec.MsgspecError, ValueError, OverflowError) as error:
        why = "it is a model" if b'"mdm model 1"' in written else error
        raise FormatError(f"the archive is no policy of mdm's: {why}", file=path) from None
    if wrong is not None:
        raise FormatError(wrong, file=path)
    return policy


def write(policy: Policy, path: str | Path, model: MDP | None = None) -> None:
    """Write a policy to an archive.

    Args:
        policy: The policy.
        path: The file, as a rule a ``.npz``.
        model: The model that it is for, whose names are kept.

    Raises:
        ModelError: If the policy does not fit the model.
    """
    wrong = None if model is None else mismatch(policy, model)
    if wrong is not None:
        raise ModelError(wrong)
    kind = getattr(policy, "kind", None)
    packed = policy.packed() if kind in PACKABLE else None  # type: ignore[attr-defined]
    if kind is None or packed is None:
        raise ModelError(f"files hold no policies of the kind {type(policy).__name__}")
    header = _Header(kind, packed[0])
    if model is not None:
        header.states, header.actions = names_of(model.state_space), names_of(model.action_space)
        header.observations = names_of(model.observation_space) if isinstance(model, POMDP) else None
    npz.write(Path(path), header, packed[1])


def _unpacked(header: _Header, arrays: Arrays, seed: int | None) -> Policy:
    if any(not 0 <= size <= LARGEST for size in header.sizes.values()):
        raise ModelError(f"a size is not one of 0 to {LARGEST}")
    if header.kind not in PACKABLE:
        raise ModelError(f"{header.kind[:40]!r} is no kind of policy")
    return PACKABLE[header.kind].unpacked(header.sizes, arrays, seed)


def _other_names(header: _Header, model: MDP) -> str | None:
    """Return where the names of an archive and of a model part, or None."""
    pairs: list[tuple[str, list[Names] | None, Space]] = [
        ("state", header.states, model.state_space),
        ("action", header.actions, model.action_space),
    ]
    if isinstance(model, POMDP):
        pairs.append(("observation", header.observations, model.observation_space))
    for what, kept, space in pairs:
        if kept is None:
            continue
        of_policy = space_of(kept)
        if [factor.names for factor in of_policy.factors] == [factor.names for factor in space.factors]:
            continue
        names: Sequence[str] = of_policy.names
        if len(names) != len(space):
            return f"the policy is for a model of {len(names)} {what}s, but this one has {len(space)}"
        for index, (name, other) in enumerate(zip(names, space.names, strict=True)):
            if name != other:
                return f"{what} {index} is {name!r} in the policy's model, but {other!r} in this one"
    return None
