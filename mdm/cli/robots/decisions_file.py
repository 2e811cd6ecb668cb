"""A file of decisions, a line of JSON each, beside the run of a robot alone."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from mdm.errors import Error

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mdm.messages import Decision
    from mdm.runtime import Runtime

__all__ = ["decisions_to"]


@contextmanager
def decisions_to(path: str | None) -> Iterator[Callable[[Runtime], None]]:
    """Open a file before a run begins; what is yielded adds each decision of a runtime to it, as a line of JSON.

    Raises:
        Error: If the file cannot be opened.
    """
    if path is None:
        yield lambda _: None
        return
    if not path.endswith(".jsonl"):
        raise Error(f"decisions are lines of JSON: name a file that ends in .jsonl, not {path}")
    encode = msgspec.json.Encoder(enc_hook=_plain).encode
    try:
        file = open(path, "ab", buffering=0)  # noqa: SIM115, PTH123 - it is closed below
    except OSError as error:
        raise Error(f"decisions cannot be written to {path}: {error.strerror}") from None

    def begin(runtime: Runtime) -> None:
        def write(decision: Decision) -> None:
            try:
                file.write(encode(decision) + b"\n")
            except OSError as error:
                subscription.cancel()
                runtime.root.report("decisions", f"lines cannot be written to {path}: {error.strerror}")

        subscription = runtime.decisions.subscribe(write)

    with file:
        yield begin


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise NotImplementedError
