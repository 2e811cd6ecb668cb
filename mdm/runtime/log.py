"""The log: a subscriber that renders faults, life-cycle and, at debug level, decisions.

Messages come first and log lines after, on a thread of their own: what reads the log, or does not, delays nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from mdm.errors import Error
from mdm.runtime.virtual import VirtualClock
from mdm.runtime.writer import StandardError, Writer

if TYPE_CHECKING:
    from mdm.messages import Decision, Fault, Mode, StateChange
    from mdm.runtime.runtime import Runtime
    from mdm.runtime.statistics import LogStatistics

__all__ = ["Log"]


class Log:
    """Renders what happens in a runtime through structlog.

    In virtual time lines are written at once: none is lost, and whoever reads them slowly slows the run down.

    Args:
        target: ``"console"`` or ``"json"`` for lines on standard error, or a structlog logger.
        debug: Render decisions too.
    """

    def __init__(self, target: Literal["console", "json"] | Any, *, debug: bool) -> None:
        self._debug = debug
        self._writer = Writer()
        self._told: list[Fault] = []
        self._safe: set[str] = set()
        if not isinstance(target, str) and not all(hasattr(target, level) for level in ("debug", "info", "error")):
            raise _no_log(target)
        self._logger = _logger(target, self._writer) if isinstance(target, str) else target

    def open(self, runtime: Runtime) -> None:
        """Listen to a runtime."""
        put = self._writer.put
        if not isinstance(runtime.clock, VirtualClock):
            self._writer.open()
        runtime.faults.subscribe(self._published)
        runtime.modes.subscribe(self._changed)
        runtime.lives.subscribe(lambda change: put(self._life, change) if change.actor else None)
        if self._debug:
            runtime.decisions.subscribe(lambda decision: put(self._decision, decision))

    def tell(self, fault: Fault) -> None:
        """Write a fault at once, from any thread; when it is published, it is not written again."""
        self._told.append(fault)
        self._writer.put(self._fault, fault)

    def close(self) -> None:
        """Write out what waits, within a bound."""
        self._writer.close()

    def statistics(self) -> LogStatistics:
        """Return how many lines were written, and how many lost."""
        return self._writer.statistics()

    def _published(self, fault: Fault) -> None:
        if fault in self._told:
            self._told.remove(fault)
        else:
            self._writer.put(self._fault, fault)

    def _fault(self, fault: Fault) -> None:
        self._logger.error("fault", time=fault.time / 1e9, source=fault.source, kind=fault.kind, detail=fault.detail)

    def _changed(self, mode: Mode) -> None:
        """Take a mode: safe ones are told, and what comes after them; the others come and go with decisions."""
        was_safe = mode.ensemble in self._safe
        (self._safe.add if mode.mode == "safe" else self._safe.discard)(mode.ensemble)
        if was_safe or mode.mode == "safe":
            self._writer.put(self._mode, mode)

    def _mode(self, mode: Mode) -> None:
        causes = ", ".join(cause.kind for cause in mode.causes)
        self._logger.warning(
            mode.mode, time=mode.time / 1e9, ensemble=mode.ensemble, since=mode.since / 1e9, causes=causes
        )

    def _life(self, change: StateChange) -> None:
        self._logger.info(change.state, time=change.time / 1e9, actor=change.actor)

    def _decision(self, decision: Decision) -> None:
        self._logger.debug(
            "decision",
            time=decision.time / 1e9,
            ensemble=decision.ensemble,
            epoch=decision.epoch,
            cause=decision.cause,
            state=decision.state,
            observation=decision.observation,
            action=decision.action_name,
            reward=decision.reward,
        )


def _no_log(target: object) -> Error:
    return Error(f"a log is 'console', 'json', a structlog logger or None, not {target!r}")


def _logger(target: str, writer: Writer) -> Any:
    import structlog  # noqa: PLC0415 - 40 ms that a silent runtime need not spend

    if target not in {"console", "json"}:
        raise _no_log(target)
    standard_error = StandardError(lambda: writer.given_up)
    render = (
        structlog.processors.JSONRenderer()
        if target == "json"
        else structlog.dev.ConsoleRenderer(colors=standard_error.colours, pad_event_to=12)
    )
    return structlog.wrap_logger(standard_error, processors=[structlog.processors.add_log_level, render])
