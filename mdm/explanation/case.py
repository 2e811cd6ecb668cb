"""Cases: decisions to be explained, with all that they were made of, as plain data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mdm.beliefs import BeliefTracker, Drawn, Support
from mdm.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.models.space import Space
    from mdm.policies import Policy


class Update(NamedTuple):
    """An update of the information between two decisions.

    Args:
        epoch: The decision that came after it.
        action: The action before it.
        observation: The observation after that action: its index; its components, None where one is missing; the set
            of those that it may be; or None where nothing was observed.
    """

    epoch: int
    action: int
    observation: int | tuple[int | None, ...] | frozenset[int] | None


class Case(NamedTuple):
    """A decision and its inputs.

    Args:
        policy: The policy.
        model: The model, or None.
        states: The states, or None where they have no names.
        actions: The actions, or None where they have no names.
        observations: The observations, or None where there are none.
        epoch: The number of the decision in its episode.
        action: The action.
        at: The policy's information: a state, a belief (an array or a `Support`), or the nodes of a plan.
        before: The same of an earlier decision, from which ``updates`` lead to ``at``; None if it is unknown.
        updates: Those since then, the first one first.
        initial: The belief from which ``updates`` lead, where they are all of the episode; else None.
        on_impossible: The meaning of an impossible observation, as in `Controller`.
        tracked: Whether the policy's own information state takes the updates, and not a tracker of the user's.
    """

    policy: Policy
    model: MDP | None
    states: Space | None
    actions: Space | None
    observations: Space | None
    epoch: int
    action: int
    at: Any
    before: Any = None
    updates: tuple[Update, ...] = ()
    initial: Any = None
    on_impossible: str = "predict"
    tracked: bool = True

    def action_name(self, action: int) -> str:
        """Return the name of an action."""
        return str(action) if self.actions is None else self.actions.names[action]

    def state_name(self, state: int) -> str:
        """Return the name of a state."""
        return f"state {state}" if self.states is None else spelt(self.states, self.states.unravel(state))


def beliefs(case: Case) -> list[Vector]:
    """Return the belief before the first update of a case, and after each; none of states that are known.

    Raises:
        ModelError: If the updates cannot be taken again; a sentence says why.
    """
    if getattr(case.policy, "input", "belief") == "state" or not case.updates:
        return []
    rerun = Rerun(case)
    pasts = [case.updates[:count] for count in range(len(case.updates) + 1)]
    found = [belief_of(case._replace(at=rerun.at(past), updates=past)) for past in pasts]
    return [belief for belief in found if belief is not None]  # all, or none


class Rerun:
    """Takes the updates of a case once more, with some of them changed.

    Args:
        case: The case.

    Raises:
        ModelError: If they cannot be taken again: a sentence says why.
    """

    def __init__(self, case: Case) -> None:
        if not case.tracked:
            raise ModelError("a tracker of your own keeps the belief: it is not run again with other observations")
        if case.before is None:
            raise ModelError("what was observed before is not known here")
        self._case = case
        alone = getattr(case.policy, "input", "belief") == "observation" and case.initial is None
        self._information = case.policy.information(None if alone else case.model)

    def at(self, updates: Iterable[Update]) -> Any:
        """Return the information that the policy would choose by after other updates."""
        case, information = self._case, self._information
        before = case.before
        if getattr(case.policy, "input", "belief") == "observation":
            information.restore(list(before))  # type: ignore[attr-defined]
        else:
            information.reset(before.by if isinstance(before, Drawn) else before)
        for update in updates:
            taken(information, update, case.on_impossible, None)
        current = information.current
        return Drawn(current.by, case.at.number) if isinstance(current, Drawn) else current


def taken(information: Any, update: Update, on_impossible: str, initial: Any) -> None:
    """Let an information state take an update, as a controller would."""
    if information.update(update.action, update.observation) > 0:
        return
    if on_impossible == "reset":
        information.reset(initial)
    elif on_impossible != "keep":
        information.update(update.action, None)


def belief_of(case: Case) -> Vector | None:
    """Return the belief of a decision as S numbers; None where none is known.

    Of a known state it is certain. A plan has no belief; where all of its episode is known, it is tracked in its model.
    """
    at = case.at.by if isinstance(case.at, Drawn) else case.at
    state = state_of(case.at)
    size = getattr(case.policy, "num_states", None)
    if isinstance(at, Support):
        return None if size is None else at.dense(size)
    if isinstance(at, np.ndarray):
        return at
    if getattr(case.policy, "input", "belief") == "observation":
        return _tracked(case)
    if size is None or state is None:
        return None
    certain: Vector = np.zeros(size)
    certain[state] = 1
    return certain


def state_of(at: Any) -> int | None:
    """Return the state that an information state is, at some stage or with a draw; None where it is none."""
    at = at.by if isinstance(at, Drawn) else at
    state = getattr(at, "state", at)
    return int(state) if isinstance(state, int | np.integer) else None


def _tracked(case: Case) -> Vector | None:
    model = None if case.model is None else case.model.pomdp
    same = (
        model is not None and case.observations is not None and len(case.observations) == len(model.observation_space)
    )
    if model is None or not same or case.initial is None:
        return None
    tracker = BeliefTracker(model)
    tracker.reset(case.initial)
    for update in case.updates:
        taken(tracker, update, case.on_impossible, case.initial)
    return tracker.belief


def parts_of(case: Case, update: Update) -> list[tuple[str, str, tuple[int | None, ...] | None]]:
    """Return the components of an observation: whose each is, its name, and the observation without it.

    Components are those of agents or of factors. Where there is one, or a plan takes them as one, ``of`` is empty.
    """
    given, space = update.observation, case.observations
    if given is None or space is None:
        return []
    if isinstance(given, frozenset):
        return [("", " or ".join(spelt(space, space.unravel(each)) for each in sorted(given)), None)]
    components = space.unravel(given) if isinstance(given, int) else given
    if len(components) == 1 or len(getattr(case.policy, "controllers", components)) != len(components):
        return [("", spelt(space, components), None)] if components != (None,) else []
    found: list[tuple[str, str, tuple[int | None, ...] | None]] = []
    for place, (factor, symbol) in enumerate(zip(space.factors, components, strict=True)):
        if symbol is not None:
            without = tuple(None if other == place else each for other, each in enumerate(components))
            found.append((factor.name, factor.names[symbol], without))
    return found


def spelt(space: Space, components: Sequence[int | None]) -> str:
    """Return a joint symbol in words; of several factors the value of each that is known."""
    if len(components) == 1:
        return "nothing" if components[0] is None else space.factors[0].names[components[0]]
    pairs = zip(space.factors, components, strict=True)
    return ", ".join(assigned(factor.name, factor.names[place]) for factor, place in pairs if place is not None)


def assigned(factor: str, value: str, sign: str = "=") -> str:
    """Return a factor with its value, in words; the value alone where it says whose it is, as ``not Near`` does."""
    return value if value in {factor, f"not {factor}"} else f"{factor}{sign}{value}"
