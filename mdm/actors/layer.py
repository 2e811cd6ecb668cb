"""The base of an ensemble's layers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.runtime import Actor
from mdm.runtime.channel import Subscription
from mdm.runtime.dispatcher import Alarm

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.runtime import Timer


class Layer(Actor):
    """An actor whose channels carry the name of the ensemble that it is part of, such as ``patrol/state``."""

    @property
    def owner(self) -> Actor:
        """The ensemble, or the layer itself where it stands alone."""
        return self.parent if self.parent is not None and self.parent.path else self

    def after(self, seconds: float, function: Callable[[], object]) -> Timer:
        """Call a function in a turn, after so many seconds: also where this layer or its ensemble fails meanwhile."""
        runtime, turn = self.runtime, Subscription[None](None, self, lambda _: function())
        timer = Alarm(runtime.dispatcher, turn)
        timer.set(runtime.dispatcher.counts_from(self.path) + round(seconds * 1e9))
        return timer
