"""How long decisions take on this machine, with one's own system, and how they would take less.

`measure` gives random stimuli to a system's ensembles, and stamps in place of their actions tell when each was decided.
The report has a row for each way in which stimuli come, a histogram in each, and advice::

    report = mdm.latency.measure("robot.toml", seconds=10)
    for row in report.rows:
        print(row.name, row.p50, row.p99, row.worst, row.needs)

A bare loop, a function behind one queue of asyncio, is measured in turn with the rows: ratios to it mean more than
microseconds, for other programs slow both down alike.
"""

from mdm.latency.measure import measure
from mdm.latency.report import Report, Row

__all__ = ["Report", "Row", "measure"]
