"""Why a decision was made, for the eye: in words, and the values of all actions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from mdm.errors import Error
from mdm.explanation import explain
from mdm.models import Factor, Space
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


def named(ensemble: Ensemble, case: Case) -> Case:
    """Return a case with the names of the wiring, where no model has names of states."""
    if case.states is not None or ensemble.state is None:
        return case
    factors = ensemble.state.factors
    states = Space(Factor(each.name, [str(wire.source) for wire in each.wires()]) for each in factors)
    return case._replace(states=states if len(states) == ensemble.controller.symbols.num_states else None)


def why(case: Case) -> Why:
    """Return why a decision was made; where nothing tells it, a sentence that says so."""
    try:
        told = explain(case)
    except Error as error:
        return Why(f"Nothing tells why: {error}.")
    return Why(str(told), tuple([(each.name, each.value) for each in told.values]), told.epoch)


def is_as_recorded(record: Record, ensemble: Ensemble) -> bool:
    """Whether an ensemble has the model, policy and options that decided in a record, as far as that tells."""
    known = record.metadata.get(f"ensemble {ensemble.path}", {}).get("configuration")
    return known is None or known == ensemble.controller.configuration


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
        return why(named(ensemble, retraced(ensemble.controller, decisions, place).case()))
    except Error as error:
        return Why(f"Nothing tells why: {error}.")
