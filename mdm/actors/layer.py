"""What the layers of an ensemble have in common."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.runtime import Actor

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mdm.errors import ConfigError

__all__ = ["Layer"]


class Layer(Actor):
    """An actor whose channels carry the name of the ensemble that it is part of, such as ``patrol/state``."""

    @property
    def owner(self) -> Actor:
        """The ensemble, or the layer itself where it stands alone."""
        return self.parent if self.parent is not None and self.parent.path else self

    def problems(self) -> Iterator[ConfigError]:
        """Yield everything that would keep this layer from starting."""
        yield from ()
