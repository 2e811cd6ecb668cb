"""Drives: when a control layer decides."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import msgspec

from mdm.checks import is_number
from mdm.errors import ConfigError, ModelError
from mdm.runtime.time.scheduler import check_rate

if TYPE_CHECKING:
    from mdm.models import Space

__all__ = ["Drive", "FixedRate", "OnEvent", "drive_of", "unobserved"]


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


def unobserved(given: str, space: Space | None) -> int | Literal["predict", "repeat"]:
    """Return the meaning of a tick without a new observation: itself, or the index of the observation that it names.

    Raises:
        ConfigError: If it is nothing of these.
    """
    if given == "predict":
        return "predict"
    if given == "repeat":
        return "repeat"
    if space is None:
        raise ConfigError(
            f"on_no_observation names {given!r}, but there is no model with observations", key="on_no_observation"
        )
    try:
        return int(space.index(given))
    except ModelError as error:
        raise ConfigError(
            f"on_no_observation is 'predict', 'repeat' or an observation's name: {error}", key="on_no_observation"
        ) from None
