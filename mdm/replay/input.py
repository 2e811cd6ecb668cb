"""Input that is given to a running system from outside: by a replay, and by `mdm trace`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.actors import Ensemble
from mdm.messages import Control
from mdm.runtime.actor import descendants

if TYPE_CHECKING:
    from mdm.runtime import Runtime


def give(runtime: Runtime, channel: str, message: Any) -> None:
    """Publish a message on a channel of input, as the beginning of a turn, or within the running one.

    A command is given to its ensemble, which keeps it where it has not started.

    Args:
        runtime: The runtime.
        channel: The channel's name; on one that there is not, nobody would hear it.
        message: The message, with the time of its turn.
    """
    if isinstance(message, Control) and _command(runtime, channel.rpartition("/")[0], message.command):
        return
    for each in runtime.channels:
        if each.name == channel:
            each.publish(message)
            return


def _command(runtime: Runtime, path: str, command: str) -> bool:
    """Give an ensemble a command; return whether there is one of that path."""
    ensembles = (actor for actor in descendants(runtime.root) if isinstance(actor, Ensemble))
    ensemble: Any = next((one for one in ensembles if one.path == path), None)
    if ensemble is None:
        return False
    if command == "resume":
        ensemble.start(resume=True)
    else:
        getattr(ensemble, command)()
    return True
