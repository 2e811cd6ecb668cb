"""The probe: notes when a stimulus began and when the first action after it was called."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.actors import FixedRate
from mdm.runtime.observing import Choices

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.actors import ActionLayer, Binding


class Probe(Choices):
    """Puts a stamp in the place of every action; or ahead of it, where actions are carried out.

    Args:
        clock: The time in nanoseconds.
        with_actions: Call the actions' functions, too.

    Attributes:
        began: When the last stimulus began.
        at: When the first action after it was called; None before.
        by: The ensemble whose action that was.
        late: How late each call of an action of a fixed rate was behind its tick in nanoseconds, while it is a list.
    """

    def __init__(self, clock: Callable[[], int], *, with_actions: bool) -> None:
        self._clock = clock
        self._with_actions = with_actions
        self.began = 0
        self.at: int | None = None
        self.by = ""
        self.late: list[int] | None = None

    def acts(self, ensemble: str, layer: Any) -> None:
        """Put the stamps into an action layer."""
        acting: ActionLayer = layer
        runtime = acting.runtime
        rated = layer.parent is not None and isinstance(layer.parent.status().drive, FixedRate)

        def stamp(binding: Binding, *action: object) -> object:
            if self.at is None:
                self.at, self.by = self._clock(), ensemble
            if rated and self.late is not None:
                self.late.append(runtime.clock.now() - runtime.now())
            return binding.function(*action) if self._with_actions else None

        acting.substitute(stamp, asks=self._with_actions)
