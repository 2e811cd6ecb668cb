"""Budgets: how many messages may be sent, by a token bucket."""

from __future__ import annotations

import math

from mdm.checks import is_number, is_whole
from mdm.errors import ConfigError

__all__ = ["TokenBucket"]

_WHOLE = 1 - 1e-9
"""A whole token, but for rounding."""


class TokenBucket:
    """Admits at most ``burst + rate x seconds`` messages in any interval of time.

    Args:
        rate: Messages per second.
        burst: How many may come at once after a pause.

    Raises:
        ConfigError: If the rate is not a positive number, or the burst is less than 1.

    Attributes:
        taken: The number of messages that were admitted.
        held_back: The number of those that were not.

    Example::

        bucket = mdm.team.TokenBucket(rate=2)
        bucket.take(0.0), bucket.take(0.1), bucket.take(0.5)  # True, False, True
    """

    def __init__(self, rate: float, burst: int = 1) -> None:
        if not is_number(rate) or not 0 < rate < math.inf:
            raise ConfigError(f"a rate is a positive number of messages per second, not {rate!r}")
        if not is_whole(burst) or burst < 1:
            raise ConfigError(f"a burst is at least 1 message, not {burst!r}")
        self.rate = float(rate)
        self.burst = int(burst)
        self.taken = self.held_back = 0
        self._tokens = float(burst)
        self._filled: float | None = None

    def take(self, now: float) -> bool:
        """Whether a message may be sent now; if so, it counts.

        Args:
            now: Seconds on a clock that does not go back.
        """
        if self.level(now) < _WHOLE:
            self.held_back += 1
            return False
        self.pay()
        self.taken += 1
        return True

    def level(self, now: float) -> float:
        """Return how many tokens there are now; fewer than 0 are owed."""
        if self._filled is not None and now > self._filled:
            self._tokens += self.rate * (now - self._filled)
        self._filled = now if self._filled is None else max(now, self._filled)
        self._tokens = min(self._tokens, float(self.burst))
        return self._tokens

    def pay(self, tokens: float = 1.0) -> None:
        """Take tokens, also those that are not there: they are owed, a burst at most."""
        self._tokens = max(self._tokens - tokens, -float(self.burst))
