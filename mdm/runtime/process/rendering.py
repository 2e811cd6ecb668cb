"""Rendering: a record of the log as a line that people read."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Any

import structlog

if TYPE_CHECKING:
    from collections.abc import Mapping


class Rendering:
    """Makes lines of records: the time of the day, or of virtual time the seconds, and numbers of six digits.

    Args:
        colours: Whether a terminal shows them, which has colours.

    Attributes:
        virtual: Whether the records have virtual times.
    """

    def __init__(self, *, colours: bool) -> None:
        self.virtual = False
        self._render = structlog.dev.ConsoleRenderer(colors=colours, pad_event_to=12, sort_keys=False)

    def __call__(self, _: Any, level: str, record: Mapping[str, Any]) -> str:
        """Return the line of a record; called as structlog calls a processor."""
        line = {name: f"{value:.6g}" if isinstance(value, float) else value for name, value in record.items()}
        for name in ("time", "since"):
            if isinstance(seconds := record.get(name), (int, float)):
                day = datetime.fromtimestamp(seconds).astimezone()
                line[name] = f"{seconds:.3f}" if self.virtual else f"{day:%H:%M:%S.%f}"[:-3]
        if "time" in line:
            line = {"timestamp": line.pop("time"), **line}
        return str(self._render(None, level, line))
