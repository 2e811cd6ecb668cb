"""Records of runs, to be looked at and run again."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.recording.reader import Attachment, Record, Recorded, records_of

if TYPE_CHECKING:
    from mdm.recording.recorder import Recorder

__all__ = ["Attachment", "Record", "Recorded", "Recorder", "records_of"]


def __getattr__(name: str) -> Any:
    """Load the recorder when it is first asked for: who reads a record needs no runtime."""
    if name == "Recorder":
        from mdm.recording.recorder import Recorder  # noqa: PLC0415

        globals()[name] = Recorder
        return Recorder
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
