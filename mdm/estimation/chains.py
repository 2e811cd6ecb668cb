"""Chains: the decisions of an ensemble, in parts within which each one follows from the one before.

A transition may be counted only between two decisions of which the second is the next after the first: nothing else was
decided between them, nobody began the episode again, and no tick was missed. Counted across such breaks, a few per cent
of the transitions of a record are false.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING, Literal, NamedTuple

import msgspec

from mdm.errors import ModelError
from mdm.messages import Decision

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from mdm.models.mdp import MDP

BREAKS = frozenset({"start", "reset", "resume", "episode", "release", "belief", "team"})
"""The causes of decisions that do not follow from the one before.

After ``release`` a safe action ran in between, a ``belief`` from outside replaces the one that observations led to, and
of a decision of a ``team`` neither state nor observation is known.
"""

_EPISODES = BREAKS - {"resume", "release", "belief"}
_LONG = 1.5
"""From so many periods on, ticks were missed between two decisions."""

Kind = Literal["steps", "jumps"]
"""``steps``: each decision follows a time step of the model. ``jumps``: it follows a change of the state, so that no
state follows itself, and how long a state lasts is part of the result."""


class Chain(msgspec.Struct, frozen=True):
    """Decisions of which each follows from the one before.

    Attributes:
        decisions: The decisions, in their order.
        end: The time in nanoseconds at which the last action was cut short; None where that is not known.
        succeeded: The same, where the last action was not cut short: it has succeeded, and with that the ensemble was
            stopped, as one that another ensemble had started.
        paid: The payment of a simulated world for each decision; none where it is not known.
    """

    decisions: tuple[Decision, ...]
    end: int | None = None
    succeeded: int | None = None
    paid: tuple[float, ...] = ()


class Chains(msgspec.Struct, frozen=True):
    """All chains of an ensemble.

    Attributes:
        ensemble: The path of the ensemble.
        kind: See `Kind`.
        hidden: Whether it decides on observations, so that its states are not known.
        chains: The chains, in their order.
        discarded: The number of decisions that belong to no chain: nothing is known of their state or belief.
        unused: Whatever else has decided in the records, by file.
        ends: How actions have ended: the state that they were decided in, the action, how, and how often.
    """

    ensemble: str
    kind: Kind
    hidden: bool
    chains: tuple[Chain, ...]
    discarded: int = 0
    unused: tuple[str, ...] = ()
    ends: tuple[tuple[int | None, int, str, int], ...] = ()

    @property
    def decisions(self) -> int:
        """The number of decisions in all chains."""
        return sum(len(chain.decisions) for chain in self.chains)

    def stays(self) -> Iterator[Stay]:
        """Yield each stay: the time in a state under an action, and the state that came next."""
        for chain in self.chains:
            yield from _stays(chain, jumps=self.kind == "jumps")


class Stay(NamedTuple):
    """The time in a state under one action.

    Attributes:
        state: The state; None where states are hidden.
        action: The action.
        seconds: How long it lasted.
        next_state: The state that followed; None where states are hidden, and where the stay was cut short.
        ended: Whether it came to its end; else another action, or a command, cut it short.
    """

    state: int | None
    action: int
    seconds: float
    next_state: int | None
    ended: bool


def is_next(previous: Decision, decision: Decision, period: int | None = None) -> bool:
    """Return whether a decision follows from the one before, of the same ensemble.

    Args:
        previous: The decision before.
        decision: The decision.
        period: The nanoseconds between two ticks of a fixed rate, if there are ticks.
    """
    if decision.cause in BREAKS or decision.epoch != previous.epoch + 1:
        return False
    return period is None or decision.time - previous.time <= _LONG * period


def kind_of(decision: Decision) -> Kind:
    """Return of which kind an ensemble is that has made a decision within a chain."""
    return "steps" if decision.cause == "tick" or decision.state is None else "jumps"


def chains_of(
    decisions: Iterable[Decision],
    *,
    ensemble: str | None = None,
    kind: Kind | None = None,
    stops: Iterable[int] = (),
) -> Chains:
    """Return the chains of an ensemble, from its decisions in their order.

    Args:
        decisions: Those of a record, or of `mdm.testing.capture_decisions`; those of other ensembles are left out.
        ensemble: The path of the ensemble; it has to be given where several have decided.
        kind: By default ``steps`` at a fixed rate and on observations, ``jumps`` on states. A simulated world that
            tells each time step, also one that changes nothing, makes steps.
        stops: When the ensemble was stopped, went safe, or was recorded no more, in nanoseconds. The stays that these
            times cut short count; without them they are left out, and rates come out too high if there are many.

    Raises:
        ModelError: If there are no decisions, or several ensembles and none is named.

    Example::

        with capture_decisions(runtime) as decisions:
            ...
        chains = chains_of(decisions, ensemble="patrol")
    """
    chosen = _of_one(decisions, ensemble)
    told = {decision.cause for decision in chosen}
    hidden = all(decision.state is None for decision in chosen)
    ticks = "tick" in told
    found: Kind = "steps" if ticks or hidden else "jumps"
    kind = found if kind is None else kind
    if hidden and kind == "jumps":
        raise ModelError(f"{chosen[0].ensemble!r} decides on observations: each is a step, of which no jumps are known")
    kept, discarded = [], 0
    for decision in chosen:
        if decision.state is not None or decision.cause != "team":  # a state is told, or follows from observations
            kept.append(decision)
        else:
            discarded += 1
    period = _period(kept) if ticks else None
    return Chains(chosen[0].ensemble, kind, hidden, tuple(_split(kept, kind, period, sorted(stops))), discarded)


def joined(several: Sequence[Chains]) -> Chains:
    """Return the chains of several runs of an ensemble as one; none goes from a run into the next.

    Raises:
        ModelError: If there are none, or one decides at a fixed rate or on observations and another does not.
    """
    if not several:
        raise ModelError("there are no decisions")
    first = several[0]
    for each in several[1:]:
        if (each.kind, each.hidden) != (first.kind, first.hidden):
            raise ModelError(
                f"{first.ensemble!r} has decided on {_manner(first)} in one run and on {_manner(each)} in another: "
                f"count these runs separately"
            )
    return Chains(
        first.ensemble,
        first.kind,
        first.hidden,
        tuple(chain for each in several for chain in each.chains),
        sum(each.discarded for each in several),
        ends=tuple(end for each in several for end in each.ends),
    )


def _manner(chains: Chains) -> str:
    if chains.hidden:
        return "observations"
    return "changes of the state" if chains.kind == "jumps" else "states step by step"


def _of_one(decisions: Iterable[Decision], ensemble: str | None) -> list[Decision]:
    by_name: dict[str, list[Decision]] = defaultdict(list)
    for decision in decisions:
        by_name[decision.ensemble].append(decision)
    if not by_name:
        raise ModelError("there are no decisions")
    if ensemble is None:
        if len(by_name) > 1:
            raise ModelError(f"several ensembles have decided: name one of {', '.join(sorted(by_name))}")
        return next(iter(by_name.values()))
    if ensemble not in by_name:
        raise ModelError(f"no ensemble {ensemble!r} has decided; there is {', '.join(sorted(by_name))}")
    return by_name[ensemble]


def _period(decisions: Sequence[Decision]) -> int | None:
    """Return the nanoseconds between two ticks."""
    gaps = [
        later.time - earlier.time
        for earlier, later in pairwise(decisions)
        if later.cause == "tick" and earlier.cause != "again" and later.epoch == earlier.epoch + 1
    ]
    return round(median(gaps)) if gaps else None


def _split(decisions: Sequence[Decision], kind: Kind, period: int | None, stops: list[int]) -> Iterator[Chain]:
    """Yield the chains; an action that was decided again belongs to the step before."""
    chain: list[Decision] = []
    last: Decision | None = None  # with the epoch that the next one follows
    for decision in decisions:
        if last is not None and not is_next(last, decision, period):
            yield Chain(tuple(chain), _end(last, decision, stops))
            chain = []
        elif last is not None and decision.cause == "again":
            last = msgspec.structs.replace(last, epoch=decision.epoch)
            if kind == "steps":
                chain[-1] = msgspec.structs.replace(chain[-1], action=decision.action, action_name=decision.action_name)
            elif decision.action != chain[-1].action:
                chain.append(decision)
            continue
        chain.append(decision)
        last = decision
    if last is not None:
        yield Chain(tuple(chain), _end(last, None, stops))


def _end(last: Decision, following: Decision | None, stops: list[int]) -> int | None:
    """Return when the last action of a chain was cut short; None where that is not known."""
    at = bisect_left(stops, last.time)
    if at < len(stops) and (following is None or stops[at] <= following.time):
        return stops[at]
    return following.time if following is not None and following.cause == "reset" else None


def _stays(chain: Chain, *, jumps: bool) -> Iterator[Stay]:
    first = chain.decisions[0]
    for decision in chain.decisions[1:]:
        changed = not jumps or decision.state != first.state
        if not changed and decision.action == first.action:
            continue  # the same stay goes on
        seconds = (decision.time - first.time) / 1e9
        yield Stay(first.state, first.action, seconds, decision.state if changed else None, changed)
        first = decision
    if chain.end is not None and jumps:
        yield Stay(first.state, first.action, (chain.end - first.time) / 1e9, None, ended=False)


def returns_of(model: MDP, chains: Iterable[Chain], *, in_time: bool = False, paid: bool = False) -> tuple[float, ...]:
    """Return the discounted return of each episode, in their order.

    An episode goes on across ticks that were missed, safe modes and beliefs from outside; a start, a reset or the
    stimulus after a horizon begins another one. Rewards are those of the decisions; decisions without one earn R(s, a),
    or its expectation under the belief. So a return is that of the model in use, and not the world's.

    Args:
        model: The model; its discount is that of a decision.
        chains: The chains.
        in_time: Whether the model's discount is that of a second.
        paid: Whether rewards are those that a simulated world has paid, of chains that tell these, and not the model's.
    """
    rewards = model.rewards
    returns: list[float] = []
    began, count = 0, 0
    for chain in chains:
        for place, decision in enumerate(chain.decisions):
            if not returns or (place == 0 and (decision.cause in _EPISODES or decision.epoch == 0)):
                returns.append(0.0)
                began, count = decision.time, 0
            earned = decision.reward if not paid else chain.paid[place] if place < len(chain.paid) else 0.0
            if earned is None and decision.state is not None:
                earned = float(rewards[decision.state, decision.action])
            elif earned is None and decision.belief is not None:
                earned = float(decision.belief @ rewards[:, decision.action])
            passed = (decision.time - began) / 1e9 if in_time else count
            returns[-1] += model.discount**passed * (earned or 0.0)
            count += 1
    return tuple(returns)
