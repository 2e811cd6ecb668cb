"""Belief trackers of a user's own."""

from __future__ import annotations

import numpy as np


class Halving:
    """An information state of a user's own, with no more than the protocol asks for."""

    def __init__(self):
        self.reset()

    def reset(self, belief=None):
        self.current = np.full(2, 0.5) if belief is None else np.asarray(belief)

    def update(self, action, observation):
        if observation is not None:
            self.current = np.eye(2)[observation] * 0.5 + self.current / 2
        return 1.0
