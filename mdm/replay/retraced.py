"""Decisions of a record, retraced: a controller alone takes in the recorded input, and decides the same.

No run is repeated: the input of an ensemble is in its decisions, from the first of the episode on. Where
beliefs are recorded, they are compared; one that does not follow from those before it is taken as the record has it,
and earlier influences are then not known. Cost: an update of the information for each decision of the episode.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import Error
from mdm.messages import Decision

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mdm.controller import Controller, Step
    from mdm.recording import Record

_CLOSE = 1e-9
_UPDATING = {"observation", "tick", "state"}
"""Causes of decisions before which information was updated."""


def decisions_of(record: Record) -> list[Decision]:
    """Return all decisions of a record, in their order.

    Raises:
        Error: If it has none.
    """
    topics = [topic for topic in ("decisions",) if topic in record.topics]
    found = [each.message for each in record.messages(topics)] if topics else []
    decisions = [message for message in found if isinstance(message, Decision)]
    if not decisions:
        raise Error(f"{record.path}: there are no decisions in this record")
    return decisions


def found(
    record: Record,
    ensemble: str | None = None,
    at: int | float | None = None,  # noqa: PYI041 - which it is tells what is meant
) -> tuple[int, list[Decision]]:
    """Return which decision of an ensemble is meant, and all decisions of that ensemble.

    Args:
        record: The record.
        ensemble: Its path; by default that of the decision that is meant.
        at: A whole number is an epoch, another one a time in seconds of the record, of which the last decision before
            it is meant; by default the last one.

    Raises:
        Error: If there is none, or are several; the sentence names them.
    """
    decisions = decisions_of(record)
    if ensemble is not None:
        known = sorted({each.ensemble for each in decisions})
        if ensemble not in known:
            raise Error(f"{record.path}: {ensemble!r} decided nothing; there is {', '.join(known)}")
        decisions = [each for each in decisions if each.ensemble == ensemble]
    start = 0 if record.span is None else record.span[0]
    if isinstance(at, int):
        meant = [each for each in decisions if each.epoch == at]
        if not meant:
            last = max(each.epoch for each in decisions)
            raise Error(f"{record.path}: there is no decision {at}; the last of an episode is {last}")
        if len(meant) > 1:
            raise Error(f"{record.path}: there are {len(meant)} decisions {at}: {_listed(meant, start)}: give a time")
    elif at is not None:
        meant = [each for each in decisions if each.time - start <= round(at * 1e9)]
        if not meant:
            first = (decisions[0].time - start) / 1e9
            raise Error(f"{record.path}: nothing was decided by {at:g} s; the first decision was at {first:.6g} s")
    else:
        meant = decisions
    own = [each for each in decisions if each.ensemble == meant[-1].ensemble]
    return next(place for place, each in enumerate(own) if each is meant[-1]), own


def _listed(decisions: list[Decision], start: int) -> str:
    told = [f"{each.ensemble} at {(each.time - start) / 1e9:.6g} s" for each in decisions[:5]]
    return ", ".join(told) + (", ..." if len(decisions) > 5 else "")


def retraced(controller: Controller, decisions: list[Decision], place: int, *, otherwise: bool = False) -> Step:
    """Return a decision of a record as a step, which explains itself.

    Args:
        controller: One of the same model, policy and options, which is not in use.
        decisions: Those of its ensemble.
        place: Which one.
        otherwise: Whether the controller is another one, and chooses by itself.

    Raises:
        ModelError: If a decision is none of this controller's.
    """
    first = next((at for at in range(place, -1, -1) if decisions[at].epoch <= 0), 0)
    step: Step | None = None
    for number, decision in enumerate(_followed(controller, decisions[first : place + 1]), first):
        step = controller.decide(None if otherwise and number == place else decision.action)
        if hasattr(controller.policy, "note") and not otherwise:  # a shield's, of what a search has wanted
            controller.policy.note(step.at, decision.wanted)
    if step is None:
        raise Error("the decision was not made by this ensemble's policy")
    return step


def redecided(controller: Controller, decisions: list[Decision]) -> Iterator[tuple[Decision, Step]]:
    """Yield each decision with another controller's, in the same state or on the same belief.

    Each is decided by itself: the run goes on as it did, not as the controller decides.

    Args:
        controller: Another one of as many states, actions and observations, which is not in use.
        decisions: Those of its ensemble.

    Raises:
        ModelError: If the controller does not know a state or an observation.
    """
    for decision in _followed(controller, decisions):
        step = controller.decide()
        controller.last_action = decision.action
        yield decision, step


def _followed(controller: Controller, decisions: Iterable[Decision]) -> Iterator[Decision]:
    """Yield the decisions of a controller, which has taken in the input of each by then."""
    controller.reset()
    for decision in decisions:
        if decision.epoch < 0:
            continue
        if decision.epoch == 0:
            controller.reset()
        if controller.takes == "state":
            controller.advance(decision.state)
        elif decision.cause in _UPDATING and controller.last_action is not None:
            controller.advance(decision.observation)
        if controller.epoch != decision.epoch:
            controller.continue_at(decision.epoch)
        if decision.belief is not None and not _alike(controller.belief, decision.belief):
            controller.believe(decision.belief)
        yield decision


def _alike(one: np.ndarray | None, other: np.ndarray) -> bool:
    return one is not None and len(one) == len(other) and bool(np.abs(one - other).max() <= _CLOSE)
