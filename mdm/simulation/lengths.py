"""Sampling of how long actions take."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ModelError
from mdm.models import Durations

if TYPE_CHECKING:
    from mdm.models import MDP

__all__ = ["Lengths"]


class Lengths:
    """Draws how long actions take; the same seed gives the same lengths.

    Args:
        model: The model that the durations are for.
        durations: Their distributions.
        seed: The seed of the draws, which are not those of a `Sampler` of the same seed.

    Raises:
        ModelError: If the durations are none, or for other numbers of states or actions.
    """

    def __init__(self, model: MDP, durations: Durations, seed: int | None = None) -> None:
        if not isinstance(durations, Durations):
            raise ModelError(f"durations are mdm.models.Durations(…), not {durations!r}")
        means, stages = durations.table(model)
        self._means, self._stages = means.tolist(), stages.tolist()
        self._generator = np.random.default_rng(None if seed is None else [seed, 1])

    def draw(self, state: int, action: int) -> float:
        """Draw the seconds that an action takes in a state."""
        stages = self._stages[state][action]
        return float(self._generator.gamma(stages, self._means[state][action] / stages))
