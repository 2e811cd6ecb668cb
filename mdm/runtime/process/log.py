"""The log: a subscriber that renders faults, modes, the lives of actors and of actions, and decisions.

Messages come first and log lines after, on a thread of their own: a reader of the log, or its absence, delays nothing.
Where no log is written, an action that fails is printed all the same, once.
"""

from __future__ import annotations

from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from msgspec.structs import replace

from mdm.errors import Error
from mdm.faults import KINDS
from mdm.messages import Action
from mdm.runtime.observing import Observer
from mdm.runtime.process.pace import Pace
from mdm.runtime.process.writer import StandardError, Writer
from mdm.runtime.time.virtual import VirtualClock

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from mdm.messages import ActionLife, Decision, Fault, Mode, StateChange
    from mdm.runtime.observing import Deciding, Guard
    from mdm.runtime.process.rendering import Rendering
    from mdm.runtime.runtime import Runtime
    from mdm.runtime.statistics import LogStatistics

_RECENT = 64
"""How many details are remembered, so that a mode does not repeat those of the faults before it."""


class FirstFailures(Observer):
    """Prints the first failure of each action on standard error; a slow reader delays nothing."""

    name = "the log"

    def __init__(self) -> None:
        self._writer: Writer | None = None
        self._told: set[tuple[str, str]] = set()
        self._virtual = False
        self._tell: Callable[[Exception | str], None] = lambda _: None

    def open(self, runtime: Runtime) -> None:
        """Listen to a runtime."""
        self._virtual = isinstance(runtime.clock, VirtualClock)
        self._tell = runtime.observe(self).tell

    def on_end(self) -> None:
        """Write out the waiting lines, within a bound."""
        if self._writer is not None:
            self._writer.close()

    def on_fault(self, fault: Fault) -> None:
        """Print a failure of an action, where it is the first."""
        action = fault.source, fault.detail.partition("' ")[0]
        if fault.kind != "action" or action in self._told:
            return
        if self._writer is None:
            writer = Writer()
            writer.on_loss = self._tell
            if not self._virtual:
                writer.open()
            self._writer = writer
        self._told.add(action)
        ensemble = fault.source.removesuffix("/action")
        self._writer.put(self._print, f"mdm: ensemble {ensemble!r}: {fault.detail}")

    def _print(self, line: str) -> None:
        writer = self._writer
        assert writer is not None
        StandardError(lambda: writer.given_up).write(f"{line} (told once, since the runtime has no log)")


class Log(Observer):
    """Renders the events of a runtime through structlog: faults, modes, the lives of the actors at the top.

    The console also shows decisions and the ends of actions that take time, ten lines a second at most: those that come
    again or are left out are counted. In virtual time lines are written at once: none is lost, and a slow reader slows
    the run down.

    Args:
        target: ``"console"`` or ``"json"`` for lines on standard error, or a structlog logger.
        debug: Render the lives of all actors, and all decisions.
        decisions: Render all decisions; or a function that returns the words of one, which stand for the names of its
            state and observation. With False none; by default the console shows those that people can follow.
    """

    name = "the log"

    def __init__(
        self,
        target: Literal["console", "json"] | Any = "console",
        *,
        debug: bool = False,
        decisions: Callable[[Decision], Mapping[str, object]] | bool | None = None,
    ) -> None:
        self._debug = debug
        self._deciding: dict[str, Deciding] = {}
        self._words = decisions if callable(decisions) else self._named
        self._pace = Pace()
        self._asked = bool(decisions)
        if decisions or (debug and decisions is None):
            self.on_decision = self._decided  # type: ignore[method-assign]
        elif decisions is None and target == "console":
            self.on_step, self.on_life = self._stepped, self._lived  # type: ignore[method-assign,assignment]
        self._writer = Writer()
        self._guard: Guard | None = None
        self._runtime: Runtime | None = None
        self._told: list[Fault] = []
        self._early: list[tuple[str, Callable[[], Mapping[str, object]]]] = []
        self._helped: set[str] = set()
        self._details: deque[str] = deque(maxlen=_RECENT)
        self._safe: set[str] = set()
        if not isinstance(target, str) and not all(hasattr(target, level) for level in ("debug", "info", "error")):
            raise _no_log(target)
        self._rendering: Rendering | None = None
        self._logger = self._lines(target) if isinstance(target, str) else target

    def open(self, runtime: Runtime) -> None:
        """Listen to a runtime."""
        virtual = isinstance(runtime.clock, VirtualClock)
        if not virtual:
            self._writer.open()
        if self._rendering is not None:
            self._rendering.virtual = virtual
        self._runtime, self._guard = runtime, runtime.observe(self)
        self._writer.on_loss = self._guard.tell
        for event, facts in self._early:
            self.write(event, facts)

    def tell(self, fault: Fault) -> None:
        """Write a fault at once, from any thread; when it is published, it is not written again."""
        self._told.append(fault)
        self._writer.put(self._fault, fault)

    def write(self, event: str, facts: Callable[[], Mapping[str, object]]) -> None:
        """Write a line behind those of earlier messages, with facts that are made on the log's thread."""
        if self._guard is None:
            self._early.append((event, facts))
            return
        self._writer.put(lambda make: self._logger.info(event, **make()), facts)

    def on_end(self) -> None:
        """Write out the waiting lines, within a bound."""
        rest = self._pace.rest()
        if again := self._pace.repeated.total():
            rest["again"] = again
        if rest:
            self.write("more", lambda: rest)
        self._writer.close()

    def on_control(self, output: Deciding) -> None:
        """Know an ensemble by its path, which names its states and observations, and hear where it is shielded."""
        if output.avoids and output.ensemble not in self._deciding and self._runtime is not None and self._guard:
            acted = self._guard(partial(self._acted, output))
            self._runtime.channel(f"{output.ensemble}/action", Action).subscribe(acted)
        self._deciding[output.ensemble] = output

    def _acted(self, output: Deciding, action: Action) -> None:
        """Write, at a bounded pace, that a shield has taken an action in place of the policy's."""
        wanted, subject = action.wanted, f"{output.ensemble} shield"
        counts = None if wanted is None else self._pace.counts(subject, (action.index, wanted), action.time)
        if wanted is None or counts is None:
            return
        head = {"time": action.time / 1e9, "ensemble": output.ensemble}
        names = {"action": output.name_of(action.index), "wanted": output.name_of(wanted), "avoids": output.avoids}
        self.write("shielded", lambda: {**head, **output.words(action.state, None), **names, **counts})

    def statistics(self) -> LogStatistics:
        """Return how many lines were written, and how many lost."""
        found = self._writer.statistics()
        return found if self._guard is None else replace(found, lost=found.lost + self._guard.lost)

    def _lines(self, target: str) -> Any:
        """Return a logger that writes lines on standard error."""
        import structlog  # noqa: PLC0415 - 40 ms that a silent runtime need not spend

        from mdm.runtime.process.rendering import Rendering  # noqa: PLC0415 - the same

        if target not in {"console", "json"}:
            raise _no_log(target)
        standard_error = StandardError(lambda: self._writer.given_up)
        render: Any = structlog.processors.JSONRenderer()
        if target == "console":
            render = self._rendering = Rendering(colours=standard_error.colours)
        return structlog.wrap_logger(standard_error, processors=[structlog.processors.add_log_level, render])

    def _tells(self, actor: str) -> bool:
        """Whether the life of an actor is logged: the root's never, and those of an actor's own parts seldom."""
        return bool(actor) and (self._debug or "/" not in actor)

    def on_fault(self, fault: Fault) -> None:
        """Write a fault that was not told before it was published."""
        if fault in self._told:
            self._told.remove(fault)
        else:
            self._writer.put(self._fault, fault)

    def _fault(self, fault: Fault) -> None:
        help_ = {}
        if fault.kind in KINDS and fault.kind not in self._helped:  # once a kind: who reads it knows then
            self._helped.add(fault.kind)
            help_ = {"help": KINDS[fault.kind].remedy}
        self._details.append(fault.detail)
        self._logger.error(
            "fault", time=fault.time / 1e9, source=fault.source, kind=fault.kind, detail=fault.detail, **help_
        )

    def on_change(self, change: StateChange) -> None:
        """Write that an actor has come to another state, where that is logged."""
        if self._tells(change.actor):
            self._writer.put(self._life, change)

    def _decided(self, decision: Decision) -> None:
        self._writer.put(self._decision, decision)

    def on_mode(self, mode: Mode) -> None:
        """Handle a mode: safe ones are logged, and the next after them; the others come and go with decisions."""
        was_safe = mode.ensemble in self._safe
        (self._safe.add if mode.mode == "safe" else self._safe.discard)(mode.ensemble)
        if was_safe or mode.mode == "safe":
            self._writer.put(self._mode, mode)

    def _mode(self, mode: Mode) -> None:
        causes = ", ".join(cause.kind for cause in mode.causes)
        untold = [cause.detail for cause in mode.causes if cause.detail not in self._details]
        self._details.extend(untold)
        why = {"why": "; ".join(untold)} if untold else {}
        write = self._logger.info if causes == "end" else self._logger.warning  # nothing is wrong with an end
        write(mode.mode, time=mode.time / 1e9, ensemble=mode.ensemble, since=mode.since / 1e9, causes=causes, **why)

    def _life(self, change: StateChange) -> None:
        write = self._logger.debug if "/" in change.actor else self._logger.info
        write(change.state, time=change.time / 1e9, actor=change.actor)

    def _stepped(self, output: Deciding, time: int, _: int, __: str, state: Any, observation: Any, *rest: Any) -> None:
        action = rest[1]
        counts = self._pace.counts(output.ensemble, (state, observation, action), time)
        if counts is not None:
            self._writer.put(self._step, (output, time, state, observation, action, counts))

    def _step(self, step: tuple[Deciding, int, Any, Any, int, dict[str, int]]) -> None:
        output, time, state, observation, action, counts = step
        words = output.words(state, observation)
        head = {"time": time / 1e9, "ensemble": output.ensemble}
        self._logger.info("decision", **head, **words, action=output.name_of(action), **counts)

    def _lived(self, life: ActionLife) -> None:
        if life.status == "running":
            return
        counts = self._pace.counts(f"{life.ensemble} {life.action}", life.status, life.time)
        if counts is not None:
            self._writer.put(self._ended, (life, counts))

    def _ended(self, ended: tuple[ActionLife, dict[str, int]]) -> None:
        life, counts = ended
        head = {"time": life.time / 1e9, "ensemble": life.ensemble}
        self._logger.info(life.status, **head, action=life.action, **counts)

    def _named(self, decision: Decision) -> Mapping[str, object]:
        output = self._deciding.get(decision.ensemble)
        if output is not None:
            return output.words(decision.state, decision.observation)
        given = {"state": decision.state, "observation": decision.observation}
        return {name: value for name, value in given.items() if value is not None}

    def _decision(self, decision: Decision) -> None:
        write = self._logger.info if self._asked else self._logger.debug
        write(
            "decision",
            time=decision.time / 1e9,
            ensemble=decision.ensemble,
            epoch=decision.epoch,
            cause=decision.cause,
            **self._words(decision),
            action=decision.action_name,
            **({} if decision.wanted is None else {"wanted": decision.wanted_name}),
            **({} if decision.reward is None else {"reward": decision.reward}),
        )


def _no_log(target: object) -> Error:
    return Error(f"a log is 'console', 'json', a structlog logger or None, not {target!r}")
