"""``mdm record repair``: what is left of a torn record as a complete one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.formats.target import check_place, replacing
from mdm.recording.reader import Record
from mdm.recording.repair import repair
from mdm.texts import counted

if TYPE_CHECKING:
    import argparse

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Write the record anew; return the exit status."""
    record = Record(arguments.file)
    check_place(arguments.output, *record.paths)
    with replacing(arguments.output) as file:
        count = repair(record, file)
    print(f"{arguments.output}: {counted(count, 'message', ',')} written")
    for sentence in record.flaws:
        print(sentence)
    if record.torn is not None and record.unread:
        print(f"{record.unread:,} bytes could not be read")
    if not record.flaws:
        print(f"{arguments.file}: it was complete")
    return 0
