"""First failures: where no log is written, an action that fails is printed all the same, once."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.runtime.virtual import VirtualClock
from mdm.runtime.writer import StandardError, Writer

if TYPE_CHECKING:
    from mdm.messages import Fault
    from mdm.runtime.runtime import Runtime

__all__ = ["FirstFailures"]


class FirstFailures:
    """Prints on standard error, of each action, its first failure; what waits for a reader delays nothing."""

    def __init__(self) -> None:
        self._writer: Writer | None = None
        self._told: set[tuple[str, str]] = set()
        self._virtual = False

    def open(self, runtime: Runtime) -> None:
        """Listen to a runtime."""
        self._virtual = isinstance(runtime.clock, VirtualClock)
        runtime.faults.subscribe(self._take)

    def close(self) -> None:
        """Write out what waits, within a bound."""
        if self._writer is not None:
            self._writer.close()

    def _take(self, fault: Fault) -> None:
        action = fault.source, fault.detail.partition("' ")[0]
        if fault.kind != "action" or action in self._told:
            return
        self._told.add(action)
        if self._writer is None:
            self._writer = Writer()
            if not self._virtual:
                self._writer.open()
        ensemble = fault.source.removesuffix("/action")
        self._writer.put(self._print, f"mdm: ensemble {ensemble!r}: {fault.detail}")

    def _print(self, line: str) -> None:
        writer = self._writer
        assert writer is not None
        StandardError(lambda: writer.given_up).write(f"{line} (told once, since the runtime has no log)")
