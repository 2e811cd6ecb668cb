"""The allowance of an agent: how many messages and bytes a second it may send, by buckets, and which come first."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from mdm.checks import is_number, is_whole
from mdm.errors import ConfigError

if TYPE_CHECKING:
    from mdm.team.transport.transport import Priority


class Allowance:
    """The most that an agent may send: so many messages and bytes a second, with bursts.

    Messages of agreed steps always pass, and are paid for by the others. Values pass while there is a token, bulk while
    half of the tokens are there, so that values come before it.

    Args:
        messages: Messages a second; None is any number. It may be changed while the agent runs.
        bytes: Bytes a second, with envelopes; the same.
        burst: For how many seconds of silence tokens are kept.

    Raises:
        ConfigError: If a rate or the burst is no number above 0.

    Example::

        allowance = Allowance(messages=50, bytes=20_000)
        allowance.messages = 10  # the link got worse
    """

    def __init__(
        self,
        *,
        messages: float | None = None,
        bytes: float | None = None,  # noqa: A002 (what they are)
        burst: float = 1.0,
    ) -> None:
        _check(burst, "the burst of an allowance")
        self._burst = burst
        self._messages: TokenBucket | None = None
        self._bytes: TokenBucket | None = None
        self.messages = messages
        self.bytes = bytes

    @property
    def messages(self) -> float | None:
        """Messages a second."""
        return None if self._messages is None else self._messages.rate

    @messages.setter
    def messages(self, rate: float | None) -> None:
        self._messages = self._changed(self._messages, rate, "the rate of messages of an allowance")

    @property
    def bytes(self) -> float | None:
        """Bytes a second."""
        return None if self._bytes is None else self._bytes.rate

    @bytes.setter  # noqa: A003
    def bytes(self, rate: float | None) -> None:
        self._bytes = self._changed(self._bytes, rate, "the rate of bytes of an allowance")

    def _changed(self, bucket: TokenBucket | None, rate: float | None, what: str) -> TokenBucket | None:
        if rate is None:
            return None
        _check(rate, what)
        burst = max(round(rate * self._burst), 1)
        if bucket is None:
            return TokenBucket(rate, burst)
        bucket.rate, bucket.burst = rate, burst
        return bucket

    def spend(self, size: int, priority: Priority, now: float) -> bool:
        """Pay for a message of so many bytes at a time in seconds; return whether it may be sent."""
        buckets = [(bucket, cost) for bucket, cost in ((self._messages, 1), (self._bytes, size)) if bucket is not None]
        levels = [bucket.level(now) for bucket, _ in buckets]
        if priority != "step":
            for (bucket, cost), level in zip(buckets, levels, strict=True):
                reserve = bucket.burst / 2 if priority == "bulk" else 0.0
                # What is larger than the bucket would never pass: a full one lets it, and the rest is owed.
                if level < min(reserve + cost, bucket.burst) - 1e-9:
                    return False
        for bucket, cost in buckets:
            bucket.pay(cost)
        return True


def _check(rate: object, what: str) -> None:
    if not is_number(rate) or not 0 < rate <= 1e12:
        raise ConfigError(f"{what} is a number above 0, not {rate!r}")


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
