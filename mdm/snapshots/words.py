"""States, observations and the causes of decisions in words."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from mdm.models import Factor, Space

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from mdm.actors import Ensemble
    from mdm.snapshots.judgement import Ended

_CAUSES = {
    "start": "as it started",
    "resume": "as it went on",
    "reset": "after a reset",
    "state": "on a change of its state",
    "observation": "on an observation",
    "belief": "on a belief that was told",
    "tick": "at a tick of its rate",
    "episode": "as a new episode began",
    "release": "as it left its safe mode",
    "again": "again, for its action had ended or it was asked to",
    "team": "as its team had decided",
}
_MOST = 3
"""Factors whose changes are told."""
_LISTED = 8
"""Observations that are counted for the eye."""


class Wiring(NamedTuple):
    """The factors of an ensemble's state, and by their names the predicate, or its negation, for each value."""

    space: Space | None
    sources: dict[str, tuple[str | None, ...]]


def cause_in_words(cause: str, *, observed: str = "", changed: str = "", ended: Ended | None = None) -> str:
    """Return the cause of a decision in words.

    Args:
        cause: As in `Decision`; another word is returned as it is.
        observed: The observation, by name, where it is known.
        changed: The change of the state, as `changes` says it.
        ended: Of a decision again, the life of an action that had ended.
    """
    if cause == "observation" and observed:
        return f"on observing {observed}"
    if cause == "state" and changed:
        return f"{_CAUSES[cause]}: {changed}"
    if cause == "again" and ended is not None:
        how = "" if ended.status == "succeeded" else f" ({ended.status.replace('_', ' ')})"
        return f"again, for {ended.action} had ended{how}"
    return _CAUSES.get(cause, cause)


def wired(ensemble: Ensemble) -> Wiring:
    """Return the factors of an ensemble's state, with the predicate, or its negation, for each value of each."""
    layer = ensemble.state
    if layer is None:
        return Wiring(None, {})
    wires = {factor.name: factor.wires() for factor in layer.factors}
    space = ensemble.controller.symbols.state_space
    if space is None:  # of a policy without a model
        space = Space(Factor(name, [wire.symbol for wire in found]) for name, found in wires.items())
    return Wiring(space, {name: tuple([wire.source for wire in found]) for name, found in wires.items()})


def changes(wiring: Wiring, before: int | None, after: int | None) -> str:
    """Return which factors of a state have changed, to which values, and the predicates that these stand for.

    Args:
        wiring: The factors; nothing is told where there are none.
        before: The state of the decision before; None where there was none, or it is not known.
        after: That of the decision.
    """
    if wiring.space is None or before is None or after is None or before == after:
        return ""
    told = []
    space = wiring.space
    values = zip(space.factors, space.unravel(before), space.unravel(after), strict=True)
    for factor, was, value in values:
        if was != value:
            known = wiring.sources.get(factor.name, ())
            source = known[value] if value < len(known) else None
            told.append(f"{factor.name} {factor.names[value]}{f' ({source})' if source else ''}")
    return ", ".join(told[:_MOST]) + (f" and {len(told) - _MOST} more" if len(told) > _MOST else "")


def observed(space: Space | None, observation: int | tuple[int | None, ...] | None) -> str | None:
    """Return the name of an observation, or of its components; None where there is none, or it has no name."""
    if space is None or observation is None:
        return None
    if isinstance(observation, int):
        return space.names[observation]
    return _factors(space, observation)


def valued(space: Space, values: Iterable[int | None]) -> tuple[tuple[str, str | None], ...]:
    """Return the names of factors with those of their values."""
    pairs = zip(space.factors, values, strict=True)
    return tuple([(factor.name, None if value is None else factor.names[value]) for factor, value in pairs])


def _factors(space: Space, values: Iterable[int | None]) -> str:
    return ", ".join(f"{name} {value or '?'}" for name, value in valued(space, values))


def at_state(space: Space | None, state: int) -> str:
    """Return that something was decided in a state, by its factors where it has several."""
    if space is None or len(space.factors) < 2:
        return f"in state {state if space is None else space.names[state]}"
    return f"in state {_factors(space, space.unravel(state))}"


def on_observing(name: str | None) -> str:
    """Return that something was decided on an observation; empty where there was none."""
    return f"on observing {name}" if name else ""


def most_frequent(tally: Mapping[str, int]) -> tuple[tuple[str, int], ...]:
    """Return the most frequent observations by name with how often each came, the most frequent first."""
    return tuple(sorted(tally.items(), key=lambda pair: (-pair[1], pair[0]))[:_LISTED])
