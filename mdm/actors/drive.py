"""Drives: when a control layer decides."""

from __future__ import annotations

import msgspec

from mdm.errors import ConfigError

__all__ = ["Drive", "FixedRate", "OnEvent"]


class OnEvent(msgspec.Struct, frozen=True):
    """Decide on each state or observation, as it comes."""


class FixedRate(msgspec.Struct, frozen=True):
    """Decide ``rate`` times a second, at times aligned to whole periods, on the latest state or observation."""

    rate: float

    def __post_init__(self) -> None:
        if not 0 < self.rate <= 1e6:
            raise ConfigError(f"a rate is more than 0 and at most 1,000,000 decisions a second, not {self.rate}")


Drive = OnEvent | FixedRate
