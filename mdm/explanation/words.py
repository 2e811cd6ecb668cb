"""Explanations in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.explanation.belief_change import BeliefChange
from mdm.explanation.state_change import StateChange

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mdm.explanation.expectation import Chance
    from mdm.explanation.explanation import Explanation
    from mdm.explanation.influence import Influence
    from mdm.explanation.observation_change import ObservationChange

__all__ = ["brief", "in_words"]

_COMPARED = {
    "value": "Values",
    "bound": "Values are at least",
    "vote": "Votes",
    "chance": "Chances",
}
_TIED = 1e-7
"""A change that is smaller is one of rounding."""
_MOST = 8
"""Actions that are told."""


def in_words(explanation: Explanation) -> str:
    """Return an explanation as sentences, a line each."""
    return "\n".join(_lines(explanation))


def brief(explanation: Explanation) -> dict[str, str]:
    """Return the parts of an explanation in a few words each, by a name, as for a line of a log."""
    e, told = explanation, {}
    if e.values:
        told["values"] = _values(e)
    if e.margin is not None:
        told["ahead"] = f"{e.margin:.4g} of {e.second}"
    if e.moved_by is not None:
        told["moved_by"] = _named(e.moved_by)
    if e.otherwise:
        more = f" ({e.ways} such changes)" if e.ways > 1 else ""
        told["otherwise"] = _change(e.otherwise[0]) + more
    if e.next_states:
        told["expects"] = _chances(e.next_states[:1])
    return told


def _lines(e: Explanation) -> Iterator[str]:
    yield f"Decision {e.epoch}: {e.action_name!r}, by {e.policy}{_nodes(e)}."
    if e.state is not None:
        yield f"The state was {e.state}."
    if e.belief:
        yield f"The most probable states were {_chances(e.belief)}."
    if e.values:
        searched = "" if e.effort is None else f", by a search that expanded {e.effort:,} leaves"
        yield f"{_COMPARED[e.by or 'value']}: {_values(e)}{searched}."
    yield from _margin(e)
    if e.moved_by is not None:
        yield _influence(e, e.moved_by)
    if e.otherwise:
        more = f" ({e.ways} such changes)" if e.ways > 1 else ""
        changes = "; or ".join(_change(change) for change in e.otherwise)
        yield f"The smallest change that decides otherwise{more}: {changes}."
    if e.next_states:
        seen = f"; of observations {_chances(e.next_observations)}" if e.next_observations else ""
        yield f"It expects next, of states {_chances(e.next_states)}{seen}."
    for sentence in e.cannot:
        yield f"Note: {sentence}."


def _nodes(e: Explanation) -> str:
    if e.nodes is None:
        return ""
    return f" at node{'s' if len(e.nodes) > 1 else ''} {', '.join(map(str, e.nodes))}"


def _values(e: Explanation) -> str:
    told = [f"{each.name} {_value(each.value, each.upper)}" for each in e.values[:_MOST]]
    more = len(e.values) - _MOST
    return ", ".join([*told, *([f"{more} more"] if more > 0 else [])])


def _value(value: float | None, upper: float | None) -> str:
    if value is None:
        return "(no value)"
    return f"{value:.4g}" + ("" if upper is None else f" (at most {upper:.4g})")


def _chance(value: float, digits: int = 4) -> str:
    return "< 0.001" if 0 < value < 0.001 else f"{value:.{digits}g}"


def _margin(e: Explanation) -> Iterator[str]:
    if e.margin is None:
        return
    if e.margin > 0:
        yield f"It is ahead of {e.second!r} by {e.margin:.4g}."
    elif e.margin == 0:
        yield f"{e.second!r} counts as much; of equal ones the first action is chosen."
    else:
        yield f"{e.second!r} counts {-e.margin:.4g} more: it was not this comparison that chose."


def _named(influence: Influence) -> str:
    whose = f"{influence.of}: " if influence.of else ""
    return f"{whose}{influence.observation} before decision {influence.epoch}"


def _influence(e: Explanation, influence: Influence) -> str:
    count = len(e.influences)
    if count > 1:
        told = f"Of the last {count} observations, {_named(influence)} moved it most"
    else:
        told = f"The observation that moved it most was {_named(influence)}"
    if e.margin is None:
        return f"{told}: without it, the decision would have been {influence.action!r}."
    if influence.without is None:
        margin = "this action would not even be compared"
    elif influence.without >= 0:
        margin = f"it would have been ahead by {influence.without:.4g}"
    else:
        margin = f"it would have been behind by {-influence.without:.4g}"
    decision = f", and the decision {influence.action!r}" if influence.decisive else ""
    return f"{told}: without it, {margin}{decision}."


def _change(change: BeliefChange | StateChange | ObservationChange) -> str:
    if isinstance(change, BeliefChange):
        shown = ", ".join(
            f"{each.state} {_chance(each.after)} instead of {_chance(each.before)}" for each in change.moves[:4]
        )
        more = len(change.moves) - 4
        rest = f", and {more} more states" if more > 0 else ""
        if change.mass < _TIED:
            return f"next to none, for {change.action!r} counts as much"
        return f"{_chance(change.mass)} of the probability elsewhere ({shown}{rest}), then {change.action!r}"
    if isinstance(change, StateChange):
        told = " and ".join(f"{each.factor} {each.after} instead of {each.before}" for each in change.factors)
    else:
        told = " and ".join(
            f"{each.of + ': ' if each.of else ''}{each.after} instead of {each.before} before decision {each.epoch}"
            for each in change.observations
        )
    return f"{told}, then {change.action!r}"


def _chances(chances: Sequence[Chance]) -> str:
    return ", ".join(f"{each.name} ({_chance(each.probability, 3)})" for each in chances)
