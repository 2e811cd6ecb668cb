"""The value of one policy: claimed, exact and simulated."""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.cli.files.document import describe_policy
from mdm.cli.progress import counting
from mdm.models.matrices import Vector
from mdm.models.units import Unit, in_words, ratio
from mdm.simulation import Evaluation, evaluate
from mdm.solvers import exact_values
from mdm.texts import counted

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from mdm.models import MDP, Durations

__all__ = ["Verdict", "between", "claimed_value", "judge"]

_ROUNDING = 1e-6
_DRAWN = 100
"""The models that are drawn of those that records leave possible."""
_LARGEST = 50_000
"""The entries of T up to which they are."""


class Verdict(msgspec.Struct, frozen=True):
    """A policy's claimed, exact and simulated values at the initial belief.

    Attributes:
        form: The kind of policy.
        size: Its number of vectors, nodes or states, in words.
        claimed: The value that the policy itself states.
        exact: The exact value, and its minimum and maximum over the states.
        simulated: The result of simulation.
        comparable: Whether the claim is for the same horizon.
        other_unit: In words what the discount of the claim is of, where that cannot be converted into the model's.
        possible: Of an estimated model, the exact values in models that its records leave possible.
    """

    form: str
    size: str
    claimed: float | None
    exact: tuple[float, float, float] | None
    simulated: Evaluation | None
    comparable: bool
    other_unit: str | None = None
    possible: Vector | None = None

    @property
    def contradicts(self) -> int:
        """1 if the claim is too high, -1 if it is too low, 0 if it is not contradicted."""
        if self.claimed is None or not self.comparable or self.other_unit is not None:
            return 0
        if self.exact is not None:
            low = high = self.exact[0]
        else:
            assert self.simulated is not None
            if not self.simulated.episodes:
                return 0
            low, high = self.simulated.interval
        if f"{self.claimed:.6g}" in {f"{low:.6g}", f"{high:.6g}"}:
            return 0  # what reads the same: solvers stop at a gap
        margin = _ROUNDING * max(1.0, abs(low), abs(high))
        return int(self.claimed > high + margin) - int(self.claimed < low - margin)

    def facts(self) -> dict[str, Any]:
        """Return the values, ready for JSON."""
        facts: dict[str, Any] = {"form": self.form, "claim": self.claimed, "exact": None, "mean": None}
        if self.exact is not None:
            facts |= dict(zip(("exact", "exact_min", "exact_max"), self.exact, strict=True))
        result = self.simulated
        if result is not None:
            facts |= {
                "mean": result.mean,
                "standard_error": result.standard_error,
                "interval": list(result.interval),
                "episodes": result.episodes,
                "steps": result.steps,
                "seed": result.seed,
                "steps_a_second": result.steps_a_second,
            }
        if self.possible is not None:
            facts["possible"] = between(self.possible)
        facts["claim_is"] = {1: "too high", -1: "too low"}.get(self.contradicts, "not contradicted")
        return facts

    def lines(self) -> Iterator[tuple[str, str]]:
        """Yield titles and texts for printing."""
        yield "policy", f"{self.form}, {self.size}"
        if self.claimed is not None:
            other = "" if self.other_unit is None else f" by a discount of {self.other_unit}: not compared"
            yield "claimed value", f"{self.claimed:.6g} at the start{other}"
        if self.exact is not None:
            yield (
                "exact value",
                f"{self.exact[0]:.6g} at the start, {self.exact[1]:.6g} to {self.exact[2]:.6g} over the states",
            )
        if self.possible is not None:
            low, high = between(self.possible)
            yield "by its records", f"{low:.6g} to {high:.6g}, in 95 % of the models that they leave possible"
        result = self.simulated
        if result is not None and not result.episodes:
            yield "simulated value", "none: no episode has ended"
        elif result is not None:
            low, high = result.interval
            yield "simulated value", f"{result.mean:.6g}, with 95 % confidence between {low:.6g} and {high:.6g}"
            each = (
                f"{counted(result.episodes, 'episode')} of at most {counted(result.steps, 'step')}, seed {result.seed}"
            )
            yield "", f"{each}, {result.steps_a_second:.3g} steps a second"
        if self.contradicts > 0:
            yield "contradiction", "the value is less than claimed, as with an upper bound (such as QMDP's)"
        elif self.contradicts < 0:
            yield "contradiction", "the value is more than claimed, as with a lower bound"


def judge(
    model: MDP,
    policy: Any,
    arguments: argparse.Namespace,
    durations: Durations | None = None,
    *,
    simulated: bool = False,
    what: str = "",
) -> Verdict:
    """Evaluate a policy.

    Args:
        model: The model, as the policy sees it.
        policy: The policy.
        arguments: The sub-command's arguments.
        durations: How long actions take; by default all take one time step.
        simulated: Simulate even if the exact value is known.
        what: The text of the progress of the simulation.
    """
    exact_in = functools.partial(exact_values, policy=policy, steps=arguments.steps, durations=durations)
    values = exact_in(model)
    exact = others = None
    if values is not None:
        exact = float(model.initial_belief @ values), float(np.min(values)), float(np.max(values))
        if (
            model.visits is not None
            and model.visits.size * len(values) <= _LARGEST
            and model.discount < 1
            and not model.pomdp
        ):
            from mdm.estimation.reestimation import possible  # noqa: PLC0415 - of an estimated model alone

            drawn = [exact_in(each) for each in possible(model, _DRAWN)]
            others = np.array([model.initial_belief @ each for each in drawn if each is not None])
    result = None
    if simulated or exact is None or arguments.episodes is not None:
        given = {name: getattr(arguments, name) for name in ("episodes", "steps", "seed")}
        with counting(arguments.interruption, what) as progress:
            result = evaluate(model, policy, durations=durations, progress=progress, **given)
    facts = describe_policy(policy)
    size = next((f"{_number(facts[what])} {what}" for what in ("vectors", "nodes", "states") if what in facts), "")
    unit: Unit = getattr(policy, "discount_of", "step")
    other = in_words(unit) if ratio(unit, model.discount_of) is None else None
    comparable = arguments.steps is None
    return Verdict(facts["form"], size, claimed_value(model, policy), exact, result, comparable, other, others)


def between(values: Vector) -> list[float]:
    """Return the least and the greatest of 95 % of some values."""
    return [float(each) for each in np.quantile(values, [0.025, 0.975])]


def claimed_value(model: MDP, policy: Any) -> float | None:
    """Return the value that a policy states for the initial belief; None if it states none."""
    start = model.initial_belief
    if policy.input != "belief":
        value: float | None = policy.value_at(start)
        return value
    return math.fsum(weight * policy.value(belief) for weight, belief in _first_beliefs(model, start))


def _first_beliefs(model: MDP, start: Vector) -> list[tuple[float, Vector]]:
    """Return the possible beliefs after observing the initial state, with their probabilities."""
    if not model.observed or (pomdp := model.pomdp) is None:
        return [(1.0, start)]
    states = np.flatnonzero(start)
    _, first = np.unique(pomdp.seen_in[states], return_index=True)
    beliefs = [pomdp.belief_at_start(int(state)) for state in states[first]]
    return [(float(start[belief > 0].sum()), belief) for belief in beliefs]


def _number(value: Any) -> str:
    return " and ".join(map(str, value)) if isinstance(value, list) else str(value)
