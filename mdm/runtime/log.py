"""The log: a subscriber that renders faults, life-cycle and, at debug level, decisions.

Messages come first and log lines after: a line is rendered when the turn has already called the action's callback.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from mdm.messages import Decision, Fault, StateChange
    from mdm.runtime.runtime import Runtime

__all__ = ["Log"]


class Log:
    """Renders what happens in a runtime through structlog.

    Args:
        target: ``"console"`` or ``"json"`` for lines on standard error, or a structlog logger.
        debug: Render decisions too.
    """

    def __init__(self, target: Literal["console", "json"] | Any, *, debug: bool) -> None:
        self._debug = debug
        self._logger = _logger(target) if isinstance(target, str) else target

    def open(self, runtime: Runtime) -> None:
        """Listen to a runtime."""
        runtime.faults.subscribe(self._fault)
        runtime.lives.subscribe(self._life)
        if self._debug:
            runtime.decisions.subscribe(self._decision)

    def close(self) -> None:
        """Write out what is still in a buffer."""
        sys.stderr.flush()

    def _fault(self, fault: Fault) -> None:
        self._logger.error("fault", time=fault.time / 1e9, source=fault.source, kind=fault.kind, detail=fault.detail)

    def _life(self, change: StateChange) -> None:
        if change.actor:
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


def _logger(target: str) -> Any:
    import structlog  # noqa: PLC0415 - 40 ms that a silent runtime need not spend

    if target not in {"console", "json"}:
        raise ValueError(f"a log is 'console', 'json', a structlog logger or None, not {target!r}")
    render = (
        structlog.processors.JSONRenderer()
        if target == "json"
        else structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty(), pad_event_to=12)
    )
    return structlog.wrap_logger(
        structlog.PrintLogger(sys.stderr), processors=[structlog.processors.add_log_level, render]
    )
