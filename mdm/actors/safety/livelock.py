"""Livelock: an ensemble decides again and again, and nothing comes of it; idleness is its opposite.

No plain decision pays for it. Decisions for an action's end alone are counted where they are made; how quickly others
come is looked at some twice a second, and what flaps is heard only while they come too quickly.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Final

from mdm.messages import Fault, PredicateUpdate

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from mdm.actors.control.control_layer import ControlLayer
    from mdm.actors.ensemble import Ensemble
    from mdm.runtime.channel import Subscription

__all__ = ["Livelock"]

_TIMES: Final = 30
_AT_ONCE: Final = 100_000_000
_RATE: Final = 10
_LASTS: Final = 1_500_000_000
_FLAPS: Final = 8
_SECOND: Final = 1_000_000_000
_FEWEST, _MOST = 16, 256


class Livelock:
    """Reports, once a spell, an action that succeeds at once again and again, or a predicate that flaps.

    Args:
        ensemble: The ensemble.
        control: Its control layer.
        used: Returns the names of all that its decisions depend on.
    """

    def __init__(self, ensemble: Ensemble, control: ControlLayer, used: Callable[[], Collection[str]]) -> None:
        self._ensemble = ensemble
        self._control = control
        self._used = used
        self._action, self._times, self._again = "", 0, -1
        # At the last look: when it was, and how many decisions; the same at the begin of decisions that come quickly.
        self._looked = self._spell = -1, 0
        # Of the present spell of such decisions: hears its flapping, until that is told.
        self._heard: Subscription[PredicateUpdate] | None = None
        self._changes: Counter[str] = Counter()
        self._counted = -1
        if control.event_driven:
            control.output.look = self._look

    def decides_again(self, time: int) -> None:
        """Note that only the end of the action before led to this decision."""
        self._again = time

    def ended(self, action: str, *, well: bool) -> None:
        """Take the end of an action that is decided again; ``well`` if it succeeded, and no other decision came."""
        again, self._again = self._again, -1
        at_once = again >= 0 and self._ensemble.runtime.now() - again <= _AT_ONCE
        self._times = self._times + 1 if well and at_once and action == self._action else 0
        self._action = action
        if self._times == _TIMES:
            self._report(
                f"action {action!r} has succeeded at once {_TIMES} times in a row, and was decided again each time: "
                "its success changes nothing of what it is decided on"
            )

    def end(self) -> None:
        """Forget what was counted: the ensemble has stopped deciding."""
        self._times, self._again, self._looked = 0, -1, (-1, 0)
        self._calm()

    def _calm(self) -> None:
        self._spell = -1, 0
        if self._heard is not None:
            self._heard.cancel()
            self._heard = None

    def _look(self) -> int:
        """Look how quickly decisions come; return after how many to look again."""
        ensemble, (then, count) = self._ensemble, self._looked
        now, decisions = self._looked = ensemble.runtime.now(), self._control.decisions
        more, passed = decisions - count, now - then
        # Of a turn without end `endless_turn` is told.
        if then < 0 or more * _SECOND < _RATE * passed or ensemble.runtime.dispatcher.goes_on:
            self._calm()
            return _FEWEST
        if self._spell[0] < 0:
            self._spell = then, count
        lasts, shared = now - self._spell[0] >= _LASTS, self._control.source.shared  # others' input decides, too
        if lasts and not (self._heard or shared or ensemble.predicates is None) and (used := self._used()):
            self._heard = ensemble.predicates.updates.subscribe(self._on_update, ensemble, topics=used)
        return min(max(_FEWEST, more * _SECOND // (2 * passed)), _MOST) if passed else _MOST

    def _on_update(self, update: PredicateUpdate) -> None:
        if not 0 <= update.time - self._counted <= _SECOND:
            self._changes.clear()
            self._counted = update.time
        self._changes.update((*update.rising, *update.falling))
        flapping = sorted(name for name, count in self._changes.items() if count >= _FLAPS)
        if flapping and self._heard is not None:
            self._heard.cancel()
            manager, (since, count) = self._ensemble.predicates, self._spell
            assert manager is not None
            names = [name for name in flapping if not manager.declared.derived(name)] or flapping
            rate = (self._control.decisions - count) * _SECOND / (update.time - since)
            what = f"predicate {names[0]!r} flaps" if len(names) == 1 else f"predicates {', '.join(names)} flap"
            self._report(f"{what}: {rate:.3g} decisions a second")

    def _report(self, detail: str) -> None:
        runtime = self._ensemble.runtime
        runtime.faults.publish(Fault(runtime.now(), self._ensemble.path, "livelock", detail))
