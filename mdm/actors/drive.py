"""Drives: when a control layer decides."""

from __future__ import annotations

import msgspec

from mdm.runtime.scheduler import check_rate

__all__ = ["Drive", "FixedRate", "OnEvent"]


class OnEvent(msgspec.Struct, frozen=True):
    """Decide on each state or observation, as it comes."""


class FixedRate(msgspec.Struct, frozen=True):
    """Decide ``rate`` times a second, at times aligned to whole periods, on the latest state or observation."""

    rate: float

    def __post_init__(self) -> None:
        check_rate(self.rate)


Drive = OnEvent | FixedRate
