"""Why a decision was made, for the eye: in words, and the values of all actions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.errors import Error
from mdm.explanation import Explanation, explain
from mdm.explanation.case import assigned, beliefs, parts_of
from mdm.explanation.explanation import sentences
from mdm.replay.retraced import found, retraced

if TYPE_CHECKING:
    from mdm.actors import Ensemble
    from mdm.explanation import Case
    from mdm.recording.reader import Record


_ACTIONS, _MOVES, _STATES = 24, 8, 5
"""The most that are drawn: actions, changes of a belief's states, and states of beliefs."""
_DRAWN = frozenset({"state", "belief", "values", "otherwise", "next"})
"""Parts of an explanation that are seen in its picture."""


class Why(msgspec.Struct, frozen=True):
    """Why a decision was made.

    Attributes:
        text: In words, a line a fact.
        epoch: The number of the decision.
        sentences: Those of the text whose facts are in no picture.
        facts: The explanation, with the best actions alone where there are many; None where there is none.
        heard: The last observations by name, each behind the action before it.
        states: The states that were likeliest in all beliefs.
        beliefs: The probabilities of these states before the first of these observations, and after each.
    """

    text: str
    epoch: int = -1
    sentences: tuple[str, ...] = ()
    facts: Explanation | None = None
    heard: tuple[tuple[str, str], ...] = ()
    states: tuple[str, ...] = ()
    beliefs: tuple[tuple[float, ...], ...] = ()


def why(case: Case) -> Why:
    """Return why a decision was made; where nothing tells it, a sentence that says so."""
    try:
        told = explain(case)
    except Error as error:
        return Why(f"Nothing tells why: {error}.")
    drawn = _DRAWN | ({"margin"} if (told.margin or 0.0) > 0 else set())
    apart = tuple([sentence for part, sentence in sentences(told) if part not in drawn])
    replace = msgspec.structs.replace
    otherwise = [
        replace(each, moves=each.moves[:_MOVES]) if hasattr(each, "moves") else each for each in told.otherwise
    ]
    facts = replace(told, values=told.values[:_ACTIONS], otherwise=tuple(otherwise))
    return Why(str(told), told.epoch, apart, facts, *_course(case))


def _course(case: Case) -> tuple[Any, ...]:
    """Return the last observations of a case, the likeliest states, and their probabilities in between."""
    try:
        found = beliefs(case)
    except Error:
        return ()
    if not found:
        return ()
    states = np.argsort(-np.sum(found, axis=0), kind="stable")[:_STATES].tolist()
    heard = [
        (
            case.action_name(each.action),
            ", ".join(assigned(of, name) if of else name for of, name, _ in parts_of(case, each)),
        )
        for each in case.updates
    ]
    chances = tuple([tuple([round(float(belief[state]), 4) for state in states]) for belief in found])
    return tuple(heard), tuple([case.state_name(state) for state in states]), chances


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
