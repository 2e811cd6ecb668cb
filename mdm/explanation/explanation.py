"""Explanations: why an action was decided, computed from policy, model and belief.

Nothing is made up: values are the policy's own, the margin is their difference, observations are removed and the belief
computed again, and the smallest change is the solution of a linear program or of an enumeration. A policy that cannot
tell something says so in a sentence.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np

from mdm.beliefs import Drawn
from mdm.errors import ModelError
from mdm.explanation.belief_change import BeliefChange, Move, moved, nearest_belief
from mdm.explanation.case import assigned, belief_of, state_of
from mdm.explanation.changes import ObservationChange, StateChange, observation_changes, state_changes
from mdm.explanation.expectation import Chance, expected_next, likeliest
from mdm.explanation.influence import Influence, influences, margin, scores_at, second, strongest

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mdm.explanation.case import Case

_TOLD = 3
_SMALL = 1e-12
"""A change of probability that is rounding."""


class Weighed(msgspec.Struct, frozen=True):
    """An action, and its number among those compared.

    Attributes:
        action: Its index.
        name: Its name.
        value: Its value, vote or chance, of a search the lower bound; None where the policy does not weigh it.
        upper: Of a search, the upper bound; else None.
    """

    action: int
    name: str
    value: float | None
    upper: float | None = None


class Explanation(msgspec.Struct, frozen=True):
    """Why an action was decided. `str` tells it in words; msgspec encodes it as JSON.

    Attributes:
        epoch: The number of the decision in its episode.
        action: The action's index.
        action_name: Its name.
        policy: The kind of policy.
        state: The name of the state that it was decided on; None where that is not known.
        nodes: The nodes of a plan; else None.
        belief: The most probable states of the belief that it was decided on.
        by: The kind of numbers compared (see `mdm.policies.Scores`); None where nothing was.
        effort: How many leaves a search has expanded; None without one.
        values: All actions, the best one first.
        second: The name of the best other action; None where there is none.
        margin: By how much the chosen action is ahead of that; below 0 where it is behind.
        moved_by: The observation that has changed the margin most, by its removal; None where there is none.
        influences: The same of each of the last observations, the first one first.
        otherwise: The smallest changes that would have decided otherwise.
        ways: How many changes of that size there are, of which ``otherwise`` has the first.
        next_states: The most probable next states.
        next_observations: The most probable next observations.
        cannot: The parts that cannot be told, a sentence each.
        wanted: The name of the action in whose place a shield has taken this one; None where it has not.
        shield: Why, in words that follow the name; else None.
    """

    epoch: int
    action: int
    action_name: str
    policy: str
    state: str | None = None
    nodes: tuple[int, ...] | None = None
    belief: tuple[Chance, ...] = ()
    by: Literal["value", "bound", "vote", "chance"] | None = None
    effort: int | None = None
    values: tuple[Weighed, ...] = ()
    second: str | None = None
    margin: float | None = None
    moved_by: Influence | None = None
    influences: tuple[Influence, ...] = ()
    otherwise: tuple[BeliefChange | StateChange | ObservationChange, ...] = ()
    ways: int = 0
    next_states: tuple[Chance, ...] = ()
    next_observations: tuple[Chance, ...] = ()
    cannot: tuple[str, ...] = ()
    wanted: str | None = None
    shield: str | None = None

    def __str__(self) -> str:
        return in_words(self)


def explain(case: Case) -> Explanation:
    """Explain a decision.

    Args:
        case: The decision, such as `Step.case` returns.

    Example::

        step = controller.observe("hear-left")
        print(step.explain())
    """
    return _Making(case).explanation()


class _Making:
    """An explanation that is being made, part by part; a part that cannot be told leaves a sentence."""

    def __init__(self, case: Case) -> None:
        self._case = case
        self._kind = getattr(case.policy, "input", "belief")
        self._form = str(getattr(case.policy, "form", f"the policy {type(case.policy).__name__}"))
        self._belief = belief_of(case)
        self._cannot: list[str] = []

    def explanation(self) -> Explanation:
        facts: dict[str, Any] = {}
        for part in (self._where, self._shielded, self._weighed, self._moved, self._otherwise, self._next):
            try:
                facts |= part()
            except ModelError as error:
                self._cannot.append(str(error))
        action = self._case.action
        head = self._case.epoch, action, self._case.action_name(action), self._form
        return Explanation(*head, cannot=tuple(dict.fromkeys(self._cannot)), **facts)

    def _where(self) -> dict[str, Any]:
        case, belief = self._case, self._belief
        at = case.at.by if isinstance(case.at, Drawn) else case.at
        if self._kind == "state":
            state = state_of(at)
            return {"state": None if state is None else case.state_name(state)}
        facts: dict[str, Any] = {}
        if self._kind == "observation":
            facts["nodes"] = tuple(int(node) for node in at)
        if belief is not None:
            top = np.argsort(-belief, kind="stable")[:_TOLD].tolist()
            facts["belief"] = likeliest(((case.state_name(state), belief[state]) for state in top), _TOLD)
        return facts

    def _shielded(self) -> dict[str, Any]:
        """Return the action that the policy wanted where its shield took another one, and its danger."""
        case, policy = self._case, self._case.policy
        wanted = policy.wanted(case.at) if hasattr(policy, "wanted") else None
        if wanted is None:
            return {}
        shield: Any = policy
        allowed = shield.allowed(case.at)
        why = f"which may lead to {shield.avoid}"
        if allowed[wanted]:
            why = f"which keeps out of {shield.avoid}, but falls short of the greatest chance to {shield.keep}"
        elif shield.probability:
            why += f" more probably than what is left of a budget of {shield.probability:g} allows"
        elif not allowed.any():
            why += ", as each action may here, this one least probably"
        if not allowed[wanted] and self._belief is not None and case.model is not None:
            states, _ = expected_next(case._replace(action=wanted), self._belief, _TOLD)
            why += f": next {_chances(states)}"
        return {"wanted": case.action_name(wanted), "shield": why}

    def _weighed(self) -> dict[str, Any]:
        case = self._case
        scores = scores_at(case, case.at, self._belief)
        if scores is None:
            raise ModelError(self._no_values())
        numbers, upper = scores.numbers, scores.upper
        if scores.by == "bound" and int(numbers.argmax()) != case.action:
            self._cannot.append("the search was made once more, and has found another action best")
        other = second(numbers, case.action)
        return {
            "by": scores.by,
            "effort": scores.effort,
            "values": tuple(
                Weighed(
                    *(action, case.action_name(action), _finite(numbers[action])),
                    None if upper is None else _finite(upper[action]),
                )
                for action in np.argsort(-numbers, kind="stable").tolist()
            ),
            "second": None if other is None else case.action_name(other),
            "margin": margin(numbers, case.action),
        }

    def _no_values(self) -> str:
        plans = getattr(self._case.policy, "controllers", ())
        if any(each.values is not None for each in plans):
            return "the values of the plan's nodes are of a belief, which is not known here"
        return f"the policy, {self._form}, has no values to compare"

    def _moved(self) -> dict[str, Any]:
        case = self._case
        if self._kind == "state" or (not case.updates and case.before is not None):
            return {}
        found = influences(case)
        return {"influences": tuple(found), "moved_by": strongest(found)}

    def _otherwise(self) -> dict[str, Any]:
        case, change = self._case, self._other_belief
        if self._kind == "state":
            change = self._other_states
        elif self._kind == "observation":
            change = self._other_observations
        if not hasattr(case.policy, "deliberates") and int(case.policy.action(case.at)) != case.action:
            if isinstance(case.at, Drawn):
                raise ModelError("the action was drawn, by a number that is not known here")
            raise ModelError("the action was chosen elsewhere, and not by the policy, which decides otherwise here")
        return change()

    def _other_states(self) -> dict[str, Any]:
        found, ways = state_changes(self._case)
        if not found:
            self._cannot.append("it would decide the same in any other state")
        return {"otherwise": tuple(found), "ways": ways}

    def _other_observations(self) -> dict[str, Any]:
        if not self._case.updates and self._case.before is not None:
            return {}
        found, ways = observation_changes(self._case)
        if not found:
            self._cannot.append("no change of two of the last observations leads to another action")
        return {"otherwise": tuple(found), "ways": ways}

    def _other_belief(self) -> dict[str, Any]:
        case, belief = self._case, self._belief
        if belief is None:
            raise ModelError("the belief is not known")
        after = nearest_belief(case.policy, belief)
        if after is None:
            raise ModelError("it would decide the same at any other belief")
        change = after - belief
        moves = tuple(
            Move(case.state_name(state), float(belief[state]), float(after[state]))
            for state in np.argsort(-np.abs(change), kind="stable").tolist()
            if abs(change[state]) > _SMALL
        )
        action = case.action_name(int(case.policy.action(after)))
        return {"otherwise": (BeliefChange(moved(belief, after), moves, action),), "ways": 1}

    def _next(self) -> dict[str, Any]:
        if self._belief is None:
            raise ModelError("what comes next needs a belief, which is not known here")
        states, observations = expected_next(self._case, self._belief, _TOLD)
        return {"next_states": states, "next_observations": observations}


def _finite(number: float) -> float | None:
    return float(number) if np.isfinite(number) else None


# -- In words -----------------------------------------------------------------------------------------------------

_COMPARED = {
    "value": "Values",
    "bound": "Values are at least",
    "vote": "Votes",
    "chance": "Chances",
}
_TIED = 1e-7
"""A change that is smaller is one of rounding."""
_MOST_TOLD = 8
"""Actions that are told."""


def in_words(explanation: Explanation) -> str:
    """Return an explanation as sentences, a line each."""
    return "\n".join(sentence for _, sentence in sentences(explanation))


def brief(explanation: Explanation) -> dict[str, str]:
    """Return the parts of an explanation in a few words each, by a name, as for a line of a log."""
    e, told = explanation, {}
    if e.wanted is not None:
        told["wanted"] = f"{e.wanted}, {e.shield}"
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


def sentences(e: Explanation) -> Iterator[tuple[str, str]]:
    """Yield the sentences of an explanation, each with the name of its part."""
    yield "decision", f"Decision {e.epoch}: {e.action_name!r}, by {e.policy}{_nodes(e)}."
    if e.wanted is not None:
        yield "wanted", f"The policy wanted {e.wanted!r}, {e.shield}; the shield took {e.action_name!r} in its place."
    if e.state is not None:
        yield "state", f"The state was {e.state}."
    if e.belief:
        yield "belief", f"The most probable states were {_chances(e.belief)}."
    if e.values:
        searched = "" if e.effort is None else f", by a search that expanded {e.effort:,} leaves"
        yield "values", f"{_COMPARED[e.by or 'value']}: {_values(e)}{searched}."
    if e.margin is not None:
        yield "margin", _ahead(e, e.margin)
    if e.moved_by is not None:
        yield "moved_by", _influence(e, e.moved_by)
    if e.otherwise:
        more = f" ({e.ways} such changes)" if e.ways > 1 else ""
        changes = "; or ".join(_change(change) for change in e.otherwise)
        yield "otherwise", f"The smallest change that decides otherwise{more}: {changes}."
    if e.next_states:
        seen = f"; of observations {_chances(e.next_observations)}" if e.next_observations else ""
        yield "next", f"It expects next, of states {_chances(e.next_states)}{seen}."
    for sentence in e.cannot:
        yield "note", f"Note: {sentence}."


def _nodes(e: Explanation) -> str:
    if e.nodes is None:
        return ""
    return f" at node{'s' if len(e.nodes) > 1 else ''} {', '.join(map(str, e.nodes))}"


def _values(e: Explanation) -> str:
    told = [f"{each.name} {_value(each.value, each.upper)}" for each in e.values[:_MOST_TOLD]]
    more = len(e.values) - _MOST_TOLD
    return ", ".join([*told, *([f"{more} more"] if more > 0 else [])])


def _value(value: float | None, upper: float | None) -> str:
    if value is None:
        return "(no value)"
    return f"{value:.4g}" + ("" if upper is None else f" (at most {upper:.4g})")


def _chance(value: float, digits: int = 4) -> str:
    return "< 0.001" if 0 < value < 0.001 else f"{value:.{digits}g}"


def _ahead(e: Explanation, margin: float) -> str:
    if margin > 0:
        return f"It is ahead of {e.second!r} by {margin:.4g}."
    if margin == 0:
        return f"{e.second!r} counts as much; of equal ones the first action is chosen."
    return f"{e.second!r} counts {-margin:.4g} more: it was not this comparison that chose."


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
        told = " and ".join(
            f"{assigned(each.factor, each.after, ' ')} instead of {each.before}" for each in change.factors
        )
    else:
        told = " and ".join(
            f"{each.of + ': ' if each.of else ''}{each.after} instead of {each.before} before decision {each.epoch}"
            for each in change.observations
        )
    return f"{told}, then {change.action!r}"


def _chances(chances: Sequence[Chance]) -> str:
    return ", ".join(f"{each.name} ({_chance(each.probability, 3)})" for each in chances)
