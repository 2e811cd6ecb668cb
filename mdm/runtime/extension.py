"""Extensions: the optional parts of a runtime, opened before its actors and closed behind them.

The runtime names none of them. One that an option stands for, such as ``record="run.mcap"``, is made by a function that
the package `mdm` offers by name, so that the runtime loads such a package where it is asked for, and knows none.
"""

from __future__ import annotations

from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from mdm.errors import Error
from mdm.runtime.observing import Observer

if TYPE_CHECKING:
    from mdm.runtime.runtime import Runtime


class Extension(Observer):
    """Lives as long as a runtime does, and observes it: subclass it, and hand it to a `Runtime`.

    Override `open`, `close` and the methods of an `Observer`, as far as you need them.

    Attributes:
        patience: Seconds that the end of the runtime waits for `close`; what is not closed by then is told.
    """

    patience: float = 10.0

    async def open(self, runtime: Runtime) -> None:
        """Begin, before any actor, so that no sensor has told anything; none can be started here.

        An error ends the start of the runtime: those opened before are closed, and this one is not, so what it has
        taken by then it gives back itself.
        """

    async def close(self) -> None:
        """End: all actors have stopped, and their safe actions are over. An error is told, and the others still close.

        Faults may still be published, and are heard, also its own; `on_end` is called when nothing more comes.
        """


def extension_of(option: str, given: Any) -> Extension:
    """Return the extension that an option of the runtime stands for.

    Raises:
        Error: If nobody makes one, or the value is none that it is made of.
    """
    offers: dict[str, str] = resolve_name("mdm:OFFERS")  # of the package itself, which names those above the runtime
    if option not in offers:
        raise Error(f"nothing is installed that takes the option {option!r} of a runtime")
    made: Extension = resolve_name(offers[option])(given)
    return made
