"""Records of runs, to be looked at and run again."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.recording.part import Attachment
from mdm.recording.reader import Record, Recorded, records_of

if TYPE_CHECKING:
    from mdm.recording.recorder import Recorder, RecorderOptions

__all__ = ["Attachment", "Record", "Recorded", "Recorder", "RecorderOptions", "records_of"]


def __getattr__(name: str) -> Any:
    """Load the recorder when it is first asked for: who reads a record needs no runtime."""
    if name in {"Recorder", "RecorderOptions"}:
        from mdm.recording import recorder  # noqa: PLC0415

        return getattr(recorder, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
