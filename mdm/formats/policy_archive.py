"""Policies of any kind with the names of their model: ``.npz`` archives of numpy's, of mdm's own.

An archive holds the arrays of the policy's class, and in ``header`` a JSON text with its kind, its sizes, and the
factors and names of the states, actions and observations that it is for. It is stored without compression and read
without pickle, so that a file cannot claim more than it holds; the same policy gives the same bytes.
"""

from __future__ import annotations

import math
import re
import struct
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np
import numpy.typing as npt

from mdm.errors import FormatError, ModelError
from mdm.formats import packing
from mdm.formats.fit import LoadedPolicy, misfit
from mdm.models import POMDP, Factor, Space

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.models import MDP

__all__ = ["MAGIC", "read", "write"]

MAGIC = b"PK\x03\x04"
_DAMAGE = (
    ValueError,
    OSError,
    EOFError,
    zipfile.BadZipFile,
    NotImplementedError,
    RuntimeError,
    OverflowError,
    struct.error,
)
_START = b"\x93NUMPY\x01\x00"
_HEAD = re.compile(rb"\{'descr': '(<f8|<i8|\|u1)', 'fortran_order': (True|False), 'shape': \(([0-9, ]{0,99})\), \} *\n")


class _Names(msgspec.Struct):
    name: str
    names: list[str]


class _Header(msgspec.Struct):
    kind: str
    sizes: dict[str, int]
    states: list[_Names] | None = None
    actions: list[_Names] | None = None
    observations: list[_Names] | None = None
    format: Literal["mdm policy 1"] = "mdm policy 1"


def read(path: str | Path, model: MDP | None = None, *, seed: int | None = None) -> LoadedPolicy:
    """Return the policy in an archive.

    Args:
        path: The file.
        model: The model that it is for; sizes are checked, and names where the archive has them.
        seed: For the draws of a stochastic policy.

    Raises:
        FormatError: If the file is damaged or no such archive, or does not fit the model.
    """
    arrays = _arrays(Path(path))
    try:
        header = msgspec.json.decode(arrays.pop("header").tobytes(), type=_Header)
        policy = packing.unpack(header.kind, header.sizes, arrays, seed)
        wrong = None if model is None else misfit(policy, model) or _other_names(header, model)
    except KeyError as error:
        raise FormatError(f"the archive is no policy of mdm's: it has no {error}", file=path) from None
    except (ModelError, msgspec.MsgspecError, ValueError, OverflowError) as error:
        raise FormatError(f"the archive is no policy of mdm's: {error}", file=path) from None
    if wrong is not None:
        raise FormatError(wrong, file=path)
    return policy


def write(policy: LoadedPolicy, path: str | Path, model: MDP | None = None) -> None:
    """Write a policy to an archive.

    Args:
        policy: The policy.
        path: The file, as a rule a ``.npz``.
        model: The model that it is for, whose names are kept.

    Raises:
        ModelError: If the policy does not fit the model.
    """
    wrong = None if model is None else misfit(policy, model)
    if wrong is not None:
        raise ModelError(wrong)
    kind, sizes, arrays = packing.pack(policy)
    header = _Header(kind, sizes)
    if model is not None:
        header.states, header.actions = _names(model.state_space), _names(model.action_space)
        header.observations = _names(model.observation_space) if isinstance(model, POMDP) else None
    members: dict[str, Any] = {"header": np.frombuffer(msgspec.json.encode(header), dtype=np.uint8)}
    members |= {name: array.astype(array.dtype.newbyteorder("<")) for name, array in arrays.items()}
    with Path(path).open("wb") as file:  # by a name, numpy would add a suffix
        np.savez(file, **members)


def _names(space: Space) -> list[_Names]:
    return [_Names(factor.name, list(factor.names)) for factor in space.factors]


def _other_names(header: _Header, model: MDP) -> str | None:
    """Return where the names of an archive and of a model part, or None."""
    pairs: list[tuple[str, list[_Names] | None, Space]] = [
        ("state", header.states, model.state_space),
        ("action", header.actions, model.action_space),
    ]
    if isinstance(model, POMDP):
        pairs.append(("observation", header.observations, model.observation_space))
    for what, kept, space in pairs:
        if kept is None or [factor.names for factor in kept] == [list(factor.names) for factor in space.factors]:
            continue
        names: Sequence[str] = Space(Factor(factor.name, factor.names) for factor in kept).names
        if len(names) != len(space):
            return f"the policy is for a model of {len(names)} {what}s, but this one has {len(space)}"
        for index, (name, other) in enumerate(zip(names, space.names, strict=True)):
            if name != other:
                return f"{what} {index} is {name!r} in the policy's model, but {other!r} in this one"
    return None


def _arrays(path: Path) -> dict[str, npt.NDArray[Any]]:
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            size = path.stat().st_size
            # Overlapping or compressed members could unpack to far more than the file holds.
            if sum(member.file_size for member in members) > size or any(member.compress_type for member in members):
                raise FormatError("the archive is compressed, which those of policies are not", file=path)
            return {member.filename.removesuffix(".npy"): _array(archive.read(member)) for member in members}
    except FileNotFoundError:
        raise FormatError("there is no such file", file=path) from None
    except IsADirectoryError:
        raise FormatError("this is a folder, not a file", file=path) from None
    except _DAMAGE as error:
        message = " ".join(str(error).split())[:80]
        raise FormatError(f"the archive is damaged, or none of numpy's: {message}", file=path) from None


def _array(data: bytes) -> npt.NDArray[Any]:
    """Return an array in numpy's own form; its size is that of the data, whatever its head claims."""
    # Numpy's reader would evaluate the head as Python, and would allot what it claims before the data are seen.
    start = len(_START) + 2
    end = start + int.from_bytes(data[len(_START) : start], "little")
    head = _HEAD.fullmatch(data, start, end)
    if not data.startswith(_START) or head is None:
        raise ValueError("an array is none of whole numbers or floats in the first version of numpy's format")
    dtype = np.dtype(head[1].decode())
    shape = tuple(int(size) for size in head[3].split(b",") if size.strip())
    if math.prod(shape) * dtype.itemsize != len(data) - end:
        raise ValueError("an array has another size than its head says")
    return np.frombuffer(data, dtype, offset=end).reshape(shape, order="F" if head[2] == b"True" else "C")
