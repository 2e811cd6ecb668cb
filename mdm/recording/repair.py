"""Writes a torn record anew: what of it can be read, as a complete file."""

from __future__ import annotations

import importlib.util
from typing import IO, TYPE_CHECKING

from mdm.errors import Error
from mdm.recording.process import File
from mdm.version import __version__

if TYPE_CHECKING:
    from mdm.recording.reader import Record

__all__ = ["repair"]


def repair(record: Record, file: IO[bytes]) -> int:
    """Write all that can be read of a record to one file; return the number of messages.

    Args:
        record: The record; of a split one, all files become one.
        file: What it is written to, opened for writing bytes.

    Raises:
        Error: If mcap is not installed.
    """
    if importlib.util.find_spec("mcap") is None:
        raise Error("records need mcap: pip install 'markov-decision-making[record]'")
    written = File(file, f"mdm/{__version__}")
    for name, mapping in record.metadata.items():
        if name == "mdm.file":  # a whole of its own, which other files do not follow
            written.metadata(name, {"record": f"{mapping.get('record', '')} repaired", "number": "0"})
        else:
            written.metadata(name, mapping)
    for attachment in record.attachments:
        written.attach(*attachment)
    topics = {name: written.topic(*topic) for name, topic in record.topics.items()}
    count = 0
    for topic, time, sequence, data in record.raw():
        written.add_message(topics[topic], time, data, time, sequence)
        count += 1
    if record.torn is not None or record.damage:
        facts = {"torn": record.torn or "", "damage": "\n".join(record.damage), "unread": str(record.unread)}
        facts["files"] = "\n".join(record.damaged_files)
        written.metadata("mdm.repaired", {name: fact for name, fact in facts.items() if fact})
    written.finish()
    return count
