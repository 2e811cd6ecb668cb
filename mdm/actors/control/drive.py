"""Drives: when a control layer decides."""

from __future__ import annotations

import msgspec

from mdm.errors import ConfigError
from mdm.number import is_number
from mdm.runtime.scheduler import check_rate

__all__ = ["Drive", "FixedRate", "OnEvent", "drive_of"]


class OnEvent(msgspec.Struct, frozen=True):
    """Decide on each state or observation, as it comes."""


class FixedRate(msgspec.Struct, frozen=True):
    """Decide ``rate`` times a second, at times aligned to whole periods, on the latest state or observation."""

    rate: float

    def __post_init__(self) -> None:
        check_rate(self.rate, key="drive")
        msgspec.structs.force_setattr(self, "rate", float(self.rate))


Drive = OnEvent | FixedRate


def drive_of(given: Drive | float | str | None) -> Drive:
    """Return the drive that is given as itself, as ``"event"`` (the default), or as a rate in decisions a second.

    Raises:
        ConfigError: If it is nothing of these.
    """
    if given is None or (isinstance(given, str) and given == "event"):
        return OnEvent()
    if isinstance(given, OnEvent | FixedRate):
        return given
    if is_number(given):
        return FixedRate(float(given))
    raise ConfigError(
        f"a drive is 'event', a number of decisions per second, OnEvent() or FixedRate(rate), not {given!r}",
        key="drive",
    )
