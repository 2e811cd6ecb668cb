"""mdm's own ``.npz`` format for policies of any kind.

An archive holds the policy's arrays, and a header with its kind, its sizes, and the factors and names of its model's
states, actions and observations.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from mdm.errors import FormatError, ModelError
from mdm.formats.archive import npz
from mdm.formats.archive.npz import Names, names_of, space_of
from mdm.formats.source import LARGEST
from mdm.models.units import Unit, checked_unit
from mdm.policies import PACKABLE, mismatch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.models import MDP, Space
    from mdm.policies import Policy


class _Header(msgspec.Struct):
    kind: str
    sizes: dict[str, int]
    states: list[Names] | None = None
    actions: list[Names] | None = None
    observations: list[Names] | None = None
    discount_of: Unit = "step"
    format: Literal["mdm policy 1"] = "mdm policy 1"


def read(path: str | Path, model: MDP | None = None, *, seed: int | None = None) -> Policy:
    """Read a policy from an archive.

    Args:
        path: The file.
        model: The policy's model. Sizes are checked against it, and names where the archive has them.
        seed: Seed of a stochastic policy's draws.

    Raises:
        FormatError: If the file is damaged, not a policy archive, or does not fit the model.
    """
    written, arrays = npz.read(Path(path))
    try:
        header = msgspec.json.decode(written, type=_Header)
        if any(not 0 <= size <= LARGEST for size in header.sizes.values()):
            raise ModelError(f"a size is not between 0 and {LARGEST}")
        if header.kind not in PACKABLE:
            raise ModelError(f"the kind of policy {header.kind[:40]!r} is unknown")
        policy: Any = PACKABLE[header.kind].unpacked(header.sizes, arrays, seed)
        policy.discount_of = checked_unit(header.discount_of)
        wrong = None if model is None else mismatch(policy, model) or _name_mismatch(header, model)
    except KeyError as error:
        raise FormatError(f"the archive does not hold a policy: {error} is missing", file=path) from None
    except (ModelError, msgspec.MsgspecError, ValueError, OverflowError) as error:
        why = npz.what_else(written, "policy", error)
        raise FormatError(f"the archive does not hold a policy: {why}", file=path) from None
    if wrong is not None:
        raise FormatError(wrong, file=path)
    result: Policy = policy
    return result


def write(policy: Policy, path: str | Path, model: MDP | None = None) -> None:
    """Write a policy to an archive.

    Args:
        policy: The policy.
        path: The file, usually a ``.npz``.
        model: The policy's model, whose names are stored.

    Raises:
        ModelError: If the policy does not fit the model.
    """
    wrong = None if model is None else mismatch(policy, model)
    if wrong is not None:
        raise ModelError(wrong)
    kind = getattr(policy, "kind", None)
    packed = policy.packed() if kind in PACKABLE else None  # type: ignore[attr-defined]
    if kind is None or packed is None:
        raise ModelError(f"{type(policy).__name__} policies cannot be written to files")
    header = _Header(kind, packed[0], discount_of=getattr(policy, "discount_of", "step"))
    if model is not None:
        header.states, header.actions = names_of(model.state_space), names_of(model.action_space)
        header.observations = None if model.observation_space is None else names_of(model.observation_space)
    npz.write(Path(path), header, packed[1])


def _name_mismatch(header: _Header, model: MDP) -> str | None:
    """Return the first difference between an archive's names and a model's, or None."""
    pairs: list[tuple[str, list[Names] | None, Space]] = [
        ("state", header.states, model.state_space),
        ("action", header.actions, model.action_space),
    ]
    if model.observation_space is not None:
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
