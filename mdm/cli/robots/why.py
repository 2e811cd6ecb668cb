"""Why decisions of a run were made, for its log: they are noted within the turn, and explained on the log's thread."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.errors import ModelError
from mdm.explanation import brief, explain
from mdm.snapshots.why import named

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from mdm.actors import Ensemble
    from mdm.messages import Decision
    from mdm.runtime import Log

__all__ = ["named", "why_in"]


def why_in(log: Log, ensembles: Iterable[Ensemble]) -> Callable[[Decision], None]:
    """Return a handler that writes why with each decision of these ensembles.

    Decisions of others, as of a task's or of another agent that decides for all, have no line.
    """
    known = {ensemble.path: ensemble for ensemble in ensembles}

    def note(decision: Decision) -> None:
        ensemble = known.get(decision.ensemble)
        if ensemble is None:
            return
        try:
            case = ensemble.controller.case()
        except ModelError:
            return
        if (case.epoch, case.action) == (decision.epoch, decision.action):
            head = {"time": decision.time / 1e9, "ensemble": decision.ensemble, "epoch": decision.epoch}
            log.write("why", lambda: head | brief(explain(named(ensemble, case))))

    return note
