"""Validity: for how long certificates are valid."""

from __future__ import annotations

import time
from contextlib import suppress
from typing import TYPE_CHECKING

from mdm.errors import ConfigError
from mdm.runtime import Actor
from mdm.team.transport.access import valid_until

if TYPE_CHECKING:
    from mdm.team.transport.access import Access

__all__ = ["WARNING", "Validity", "days_left", "ending"]

WARNING = 7.0
"""Days before its end at which a certificate is noted by who looks."""

_LAST = 2.0  # days before it at which the running team reports it
_PAUSE = 6 * 3600.0


def days_left(access: Access | None) -> float | None:
    """Return for how many days certificates are valid that lie here, and are valid; None where there are none."""
    with suppress(ConfigError):  # who uses them is told
        return None if access is None else (valid_until(access) - time.time()) / 86400
    return None


def ending(days: float, agent: str) -> str:
    """Say when a certificate ends."""
    when = f"ends in {days:.1f} days" if days > 0 else "has ended"
    return f"the certificate of {agent!r}, or of the authority that signed it, {when}"


class Validity(Actor):
    """Reports a fault ``certificate`` in the last two days of an agent's certificates, every six hours.

    Zenoh reads their files whenever it connects; what it shows to those who connect to it, at its start alone.

    Args:
        access: The files.
        agent: Whose they are.
        listens: Whether others connect to the agent.
    """

    def __init__(self, access: Access, agent: str, *, listens: bool) -> None:
        super().__init__("certificate")
        self._access = access
        self._agent = agent
        self._listens = listens
        self._until = valid_until(access)

    @property
    def days(self) -> float:
        """For how many days the certificates that the agent shows are valid."""
        if not self._listens:
            with suppress(ConfigError):  # they have ended, or are being written
                self._until = valid_until(self._access)
        return (self._until - time.time()) / 86400

    def on_running(self) -> None:
        """Look, and look again later."""
        if self.days < _LAST:
            taken = "is started again" if self._listens else "connects to its router again"
            told = "renew the files, for then nobody connects anew; this agent takes them up when it"
            self.report("certificate", f"{ending(self.days, self._agent)}: {told} {taken}")
        self.call_later(_PAUSE, self.on_running)
