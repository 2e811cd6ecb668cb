"""What the verbs that show a record share: the record as snapshots, with what its configuration tells."""

from __future__ import annotations

import tempfile
from typing import TYPE_CHECKING

from mdm.config.recorded import load_recorded
from mdm.errors import Error
from mdm.recording import Record
from mdm.replay import transports_of
from mdm.snapshots import RecordedRun

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["recorded_run"]


def recorded_run(path: str | Path, *, replay: bool = True) -> RecordedRun:
    """Return a record as snapshots; without the names, maps and predicates of its configuration where it has none.

    Args:
        path: The record.
        replay: Have predicates from a replay.
    """
    record = Record(path)
    if "configuration" not in record.head:
        return RecordedRun(record)
    with tempfile.TemporaryDirectory() as folder:
        transports = transports_of(record)
        try:
            system = load_recorded(record, folder, transport=next(iter(transports.values()), None))
        except Error as error:
            run = RecordedRun(record)
            run.remark(f"the record's configuration cannot be loaded: {error}")
            return run
        run = RecordedRun(
            *(record, system),
            ensembles=system.ensembles,
            predicates=system.predicates,
            places=system.places,
        )
    if replay:
        try:
            run.restore(transports)
        except Error as error:
            run.remark(f"predicates are not known, for the run cannot be replayed: {error}")
    return run
