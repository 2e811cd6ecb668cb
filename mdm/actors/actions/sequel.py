"""The sequel of an action's end: declared by its binding, counted by plain data.

No actor, no clock and no event loop is known here: ends are handed in, and the due sequel is returned.
"""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple

from msgspec import Meta

from mdm.options import Options, Seconds

__all__ = ["LONGEST_PAUSE", "Due", "Sequel", "Then", "Tries"]

Then = Literal["wait", "decide"]

LONGEST_PAUSE = 60.0
"""Seconds to which the pause between failures grows at most, where it does not begin longer."""


class Sequel(Options, frozen=True):
    """A binding's declaration of how its action's end is followed.

    Attributes:
        then: ``decide``: where nothing else is decided within the pause, decide again on the same state or belief.
            ``wait``: wait for the next input, on purpose. By default it waits, too, and is told as idle.
        pause: Seconds before it is decided again, doubled with each failure in a row up to `LONGEST_PAUSE`.
        attempts: Failures in a row after which it is not decided again: ``Go.gave_up`` occurs, and where nothing
            depends on that, the ensemble goes safe. None by default: there are always more.
    """

    then: Then | None = None
    pause: Seconds = 1.0
    attempts: Annotated[int, Meta(ge=1)] | None = None

    @property
    def counts(self) -> bool:
        """Whether each end counts, a success of a plain function, too."""
        return self.then == "decide" or self.attempts is not None


class Due(NamedTuple):
    """The sequel that is due after an action's end.

    Attributes:
        pause: Seconds after which to decide again, or None.
        gave_up: Whether it has failed as often as it may.
    """

    pause: float | None = None
    gave_up: bool = False


class Tries:
    """Counts how often the same action has failed in a row, and returns the sequel of each end."""

    __slots__ = ("_failures", "_name")

    def __init__(self) -> None:
        self._name = ""
        self._failures = 0

    @property
    def counting(self) -> bool:
        """Whether an action has failed, so that a row may go on."""
        return self._failures > 0

    def began(self, name: str) -> None:
        """Take the beginning of an action, which ends the row of another one."""
        if name != self._name:
            self._name, self._failures = name, 0

    def ended(self, name: str, sequel: Sequel, *, failed: bool, retries: bool = False) -> Due:
        """Take the end of an action that nobody asked for.

        Args:
            name: The action's.
            sequel: Its binding's declaration.
            failed: Whether it failed.
            retries: Whether failures are followed by a decision, even against its declaration.
        """
        self.began(name)
        if not failed:
            self._failures = 0
            return Due(sequel.pause if sequel.then == "decide" else None)
        retries = retries or sequel.then == "decide"
        if not (retries or sequel.attempts):
            return Due()
        self._failures += 1
        if sequel.attempts is not None and self._failures >= sequel.attempts:
            self._failures = 0  # once begun again it has as many anew
            return Due(gave_up=True)
        longest = max(LONGEST_PAUSE, sequel.pause)
        return Due(min(sequel.pause * 2.0 ** min(self._failures - 1, 64), longest) if retries else None)
