"""The log: a subscriber that renders faults, modes, the lives of actors and, where they are asked for, decisions.

Messages come first and log lines after, on a thread of their own: what reads the log, or does not, delays nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from mdm.errors import Error
from mdm.runtime.virtual import VirtualClock
from mdm.runtime.writer import StandardError, Writer

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from mdm.messages import Decision, Fault, Mode, StateChange
    from mdm.runtime.rendering import Rendering
    from mdm.runtime.runtime import Runtime
    from mdm.runtime.statistics import LogStatistics

__all__ = ["Log"]


class Log:
    """Renders what happens in a runtime through structlog: faults, modes, the lives of the actors at the top.

    In virtual time lines are written at once: none is lost, and whoever reads them slowly slows the run down.

    Args:
        target: ``"console"`` or ``"json"`` for lines on standard error, or a structlog logger.
        debug: Render the lives of all actors, and decisions.
        decisions: Render decisions, and what this tells of each: of which input the decision is, say, in words.
    """

    def __init__(
        self,
        target: Literal["console", "json"] | Any = "console",
        *,
        debug: bool = False,
        decisions: Callable[[Decision], Mapping[str, object]] | None = None,
    ) -> None:
        self._debug = debug
        self._words = decisions or (_indices if debug else None)
        self._asked = decisions is not None
        self._writer = Writer()
        self._told: list[Fault] = []
        self._safe: set[str] = set()
        if not isinstance(target, str) and not all(hasattr(target, level) for level in ("debug", "info", "error")):
            raise _no_log(target)
        self._rendering: Rendering | None = None
        self._logger = self._lines(target) if isinstance(target, str) else target

    def open(self, runtime: Runtime) -> None:
        """Listen to a runtime."""
        put = self._writer.put
        virtual = isinstance(runtime.clock, VirtualClock)
        if not virtual:
            self._writer.open()
        if self._rendering is not None:
            self._rendering.virtual = virtual
        runtime.faults.subscribe(self._published)
        runtime.modes.subscribe(self._changed)
        runtime.lives.subscribe(lambda change: put(self._life, change) if self._tells(change.actor) else None)
        if self._words is not None:
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

    def _lines(self, target: str) -> Any:
        """Return a logger that writes lines on standard error."""
        import structlog  # noqa: PLC0415 - 40 ms that a silent runtime need not spend

        from mdm.runtime.rendering import Rendering  # noqa: PLC0415 - the same

        if target not in {"console", "json"}:
            raise _no_log(target)
        standard_error = StandardError(lambda: self._writer.given_up)
        render: Any = structlog.processors.JSONRenderer()
        if target == "console":
            render = self._rendering = Rendering(colours=standard_error.colours)
        return structlog.wrap_logger(standard_error, processors=[structlog.processors.add_log_level, render])

    def _tells(self, actor: str) -> bool:
        """Whether the life of an actor is told: the root's never, and those of what makes up an actor seldom."""
        return bool(actor) and (self._debug or "/" not in actor)

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
        write = self._logger.debug if "/" in change.actor else self._logger.info
        write(change.state, time=change.time / 1e9, actor=change.actor)

    def _decision(self, decision: Decision) -> None:
        assert self._words is not None
        write = self._logger.info if self._asked else self._logger.debug
        write(
            "decision",
            time=decision.time / 1e9,
            ensemble=decision.ensemble,
            epoch=decision.epoch,
            cause=decision.cause,
            **self._words(decision),
            action=decision.action_name,
            **({} if decision.reward is None else {"reward": decision.reward}),
        )


def _indices(decision: Decision) -> dict[str, object]:
    given = {"state": decision.state, "observation": decision.observation}
    return {name: value for name, value in given.items() if value is not None}


def _no_log(target: object) -> Error:
    return Error(f"a log is 'console', 'json', a structlog logger or None, not {target!r}")
