"""Waiting: an ensemble that should decide, and does not know its state, says so."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.messages import PredicateUpdate, State

if TYPE_CHECKING:
    from mdm.actors.ensemble import Ensemble
    from mdm.runtime import Subscription, Timer

__all__ = ["Waiting"]

_PATIENCE = 1.0


class Waiting:
    """Reports what an ensemble waits for, a second after it began to wait, and again when that changes.

    It listens while the ensemble waits, and not otherwise, so that a decision costs nothing for it.

    Args:
        ensemble: Whose.

    Attributes:
        names: What it waits for now; empty where it waits for nothing.
    """

    def __init__(self, ensemble: Ensemble) -> None:
        self.names: tuple[str, ...] = ()
        self._ensemble = ensemble
        self._subscriptions: list[Subscription[State] | Subscription[PredicateUpdate]] = []
        self._timer: Timer | None = None
        self._told: tuple[str, ...] = ()
        self._waits = False

    def unknown(self) -> tuple[str, ...]:
        """Return the unknown predicates that keep the state unknown; empty where no state layer tells it."""
        layer = self._ensemble.state
        return () if layer is None else layer.unknown()

    def begin(self) -> None:
        """Take it that the ensemble waits for its state."""
        if self._waits:
            return
        ensemble = self._ensemble
        self._waits = True
        self.names = self._wanted()
        self._told = ()
        self._timer = ensemble.call_later(_PATIENCE, self._tell)
        self._subscriptions = [ensemble.channel("state", State, retain=True).subscribe(self._on_state, ensemble)]
        if ensemble.state is not None:
            updates = ensemble.state.predicates.updates
            self._subscriptions.append(updates.subscribe(self._on_update, ensemble, topics=ensemble.state.inputs()))

    def end(self) -> None:
        """Take it that it waits no more."""
        self._waits = False
        self.names = ()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        for subscription in self._subscriptions:
            subscription.cancel()
        self._subscriptions.clear()

    def _wanted(self) -> tuple[str, ...]:
        if self._ensemble.state is None:
            return (f"a state on {self._ensemble.path}/state",)
        return self.unknown()  # nothing, where all is known by now and the state is about to come

    def _on_state(self, state: State) -> None:
        if state.index is not None:
            self.end()

    def _on_update(self, _: PredicateUpdate) -> None:
        self.names = self._wanted()
        if self._timer is None:
            self._tell()

    def _tell(self) -> None:
        self._timer = None
        self.names = self._wanted()
        if self._waits and self.names and self.names != self._told:
            self._told = self.names
            *most, last = self.names
            names = f"{', '.join(most)} and {last} are" if most else f"{last} is"
            self._ensemble.report("waiting", f"cannot decide while {names} unknown")
