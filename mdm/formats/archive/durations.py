"""mdm's own ``.npz`` format for how long actions take."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from mdm.errors import FormatError, ModelError
from mdm.formats.archive import npz
from mdm.models import Durations

__all__ = ["read", "write"]


class _Header(msgspec.Struct):
    format: Literal["mdm durations 1"] = "mdm durations 1"


def read(path: str | Path) -> Durations:
    """Read durations from an archive.

    Raises:
        FormatError: If the file is damaged or holds no durations.
    """
    header, arrays = npz.read(Path(path))
    try:
        if b"mdm durations " not in header:
            raise ModelError("it holds something else")
        msgspec.json.decode(header, type=_Header)
        return Durations(arrays["means"], arrays["stages"])
    except KeyError as error:
        raise FormatError(f"the archive does not hold durations: {error} is missing", file=path) from None
    except (ModelError, msgspec.MsgspecError, ValueError) as error:
        why = npz.what_else(header, "durations", error)
        raise FormatError(f"the archive does not hold durations: {why}", file=path) from None


def write(durations: Durations, path: str | Path) -> None:
    """Write durations to an archive, usually a ``.npz``.

    Raises:
        FormatError: If the file cannot be written.
    """
    arrays = {"means": np.asarray(durations.means), "stages": np.asarray(durations.stages)}
    npz.write(Path(path), _Header(), arrays)
