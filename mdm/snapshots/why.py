"""Why a decision was made, for the eye: in words, and the values of all actions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from mdm.errors import Error
from mdm.explanation import explain
from mdm.replay.retraced import found, retraced

if TYPE_CHECKING:
    from mdm.actors import Ensemble
    from mdm.explanation import Case
    from mdm.recording.reader import Record


class Why(msgspec.Struct, frozen=True):
    """Why a decision was made.

    Attributes:
        text: In words, a line a fact.
        values: The value of each action, the best one first; None where the policy does not weigh it.
        epoch: The number of the decision.
    """

    text: str
    values: tuple[tuple[str, float | None], ...] = ()
    epoch: int = -1


def why(case: Case) -> Why:
    """Return why a decision was made; where nothing tells it, a sentence that says so."""
    try:
        told = explain(case)
    except Error as error:
        return Why(f"Nothing tells why: {error}.")
    return Why(str(told), tuple([(each.name, each.value) for each in told.values]), told.epoch)


def is_as_recorded(record: Record, ensemble: Ensemble) -> bool:
    """Whether an ensemble has the model, policy and options that decided in a record, as far as that tells."""
    known, controller = record.metadata.get(f"ensemble {ensemble.path}", {}), ensemble.controller
    if hasattr(controller.policy, "absent"):  # one that is code, which the record names
        now = controller.digests()
        return all(known.get(part, now[part]) == now[part] for part in ("model", "options"))
    return known.get("configuration", controller.configuration) == controller.configuration


def why_recorded(record: Record, ensemble: Ensemble, seconds: float) -> Why:
    """Return why an ensemble decided last by a second of a record.

    Args:
        record: The record.
        ensemble: The ensemble of its configuration, which does not run.
        seconds: Since the record's first message.
    """
    try:
        place, decisions = found(record, ensemble.path, seconds)
        if not is_as_recorded(record, ensemble):
            raise Error("model, policy or options that can be loaded are not those that decided")
        return why(ensemble.named(retraced(ensemble.controller, decisions, place).case()))
    except Error as error:
        return Why(f"Nothing tells why: {error}.")
