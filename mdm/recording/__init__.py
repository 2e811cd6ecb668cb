"""Records: what happened in a run, so that it can be looked at and run again."""

from mdm.recording.reader import Attachment, Record, Recorded, records_of
from mdm.recording.recorder import Recorder

__all__ = ["Attachment", "Record", "Recorded", "Recorder", "records_of"]
