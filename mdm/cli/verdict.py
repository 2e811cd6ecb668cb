"""What is found out about one policy: its claim, its exact value, its simulated worth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.cli.document import describe_policy
from mdm.cli.value import claim
from mdm.simulation import Evaluation, evaluate
from mdm.solvers import exact_values

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from mdm.models import MDP

__all__ = ["Verdict", "judge"]

_ROUNDING = 1e-6


class Verdict(msgspec.Struct, frozen=True):
    """What a policy is worth.

    Attributes:
        form: What kind of policy it is.
        size: Its vectors, nodes or states, in words.
        claimed: What it says of itself.
        exact: The exact value of the start, and the least and the greatest over the states.
        simulated: The simulation.
        comparable: Whether the claim is about the same: no other end.
    """

    form: str
    size: str
    claimed: float | None
    exact: tuple[float, float, float] | None
    simulated: Evaluation | None
    comparable: bool

    @property
    def contradicts(self) -> int:
        """1 where the claim is more than what was found, -1 where it is less, 0 where neither can be said."""
        if self.claimed is None or not self.comparable:
            return 0
        if self.exact is not None:
            low = high = self.exact[0]
        else:
            assert self.simulated is not None
            low, high = self.simulated.interval
        margin = _ROUNDING * max(1.0, abs(low), abs(high))
        return int(self.claimed > high + margin) - int(self.claimed < low - margin)

    def facts(self) -> dict[str, Any]:
        """Return what there is to know, ready for JSON."""
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
        facts["claim_is"] = {1: "too high", -1: "too low"}.get(self.contradicts, "not contradicted")
        return facts

    def lines(self) -> Iterator[tuple[str, str]]:
        """Yield what there is to know, line by line."""
        yield "policy", f"{self.form}, {self.size}"
        if self.claimed is not None:
            yield "claims", f"{self.claimed:.6g} at the start"
        if self.exact is not None:
            yield (
                "is worth",
                f"{self.exact[0]:.6g} at the start, {self.exact[1]:.6g} to {self.exact[2]:.6g} over the states",
            )
        result = self.simulated
        if result is not None:
            low, high = result.interval
            yield "simulated", f"{result.mean:.6g}, by 95 % between {low:.6g} and {high:.6g}"
            each = f"{result.episodes} episodes of at most {result.steps} steps, seed {result.seed}"
            yield "", f"{each}, {result.steps_a_second:.3g} steps a second"
        if self.contradicts > 0:
            yield "contradiction", "it is worth less than it claims, as where a claim is an upper bound (QMDP's are)"
        elif self.contradicts < 0:
            yield "contradiction", "it is worth more than it claims, as where a claim is a lower bound"


def judge(model: MDP, policy: Any, arguments: argparse.Namespace, *, simulated: bool = False) -> Verdict:
    """Find out what a policy is worth.

    Args:
        model: The model, as the policy is to see it.
        policy: The policy.
        arguments: What the sub-command was given.
        simulated: Simulate it even where the exact value is known.
    """
    values = exact_values(model, policy, steps=arguments.steps)
    exact = None
    if values is not None:
        exact = float(model.initial_belief @ values), float(np.min(values)), float(np.max(values))
    result = None
    if simulated or exact is None or arguments.episodes is not None:
        result = evaluate(model, policy, episodes=arguments.episodes, steps=arguments.steps, seed=arguments.seed)
    facts = describe_policy(policy)
    size = next((f"{_number(facts[what])} {what}" for what in ("vectors", "nodes", "states") if what in facts), "")
    comparable = arguments.steps is None
    return Verdict(facts["form"], size, claim(model, policy), exact, result, comparable)


def _number(value: Any) -> str:
    return " and ".join(map(str, value)) if isinstance(value, list) else str(value)
