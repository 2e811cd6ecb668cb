"""What agents of a team return for how many messages, by communication policy.

Each agent decides on what it knows: its own observations, and those that others share. All communication policies see
the same episodes, by the same random numbers, and decide by the same policy of the team, computed by SARSOP for shared
observations. The threshold of `ValueOfCommunication` is chosen on episodes of their own, by one rule for all problems:
the greatest of some fractions of the gap between `Always` and `Never` that keeps 97 % of that gap, or else 0.

"% of the gap" is (return - Never) / (Always - Never), which is the same whatever the zero of rewards; "% of Always" is
1 - (Always - return) / |Always|, which for positive returns is their ratio. Intervals are of 95 %, by bootstrap over
the episodes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from measurement import arguments, report, table

import mdm
from mdm.simulation import evaluate_communication
from mdm.team import Always, Budget, Never, OnChange, ValueOfCommunication

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.models import POMDP
    from mdm.simulation import CommunicationEvaluation

PROBLEMS: dict[str, tuple[Callable[[], POMDP], float]] = {
    "dec-tiger": (lambda: mdm.problems.dec_tiger(discount=0.9), 0.01),
    "recycling robots": (lambda: mdm.problems.recycling_robots(discount=0.9), 0.01),
    "fire fighting, 3 agents": (lambda: mdm.problems.fire_fighting_graph(3, discount=0.9), 0.15),
    "meeting, 2 x 2 cells": (lambda: mdm.problems.grid_small(discount=0.9), 0.01),
    "box pushing": (lambda: mdm.problems.box_pushing(discount=0.9), 0.1),
    "relay": (lambda: mdm.problems.relay(discount=0.9), 0.1),
}
"""Models, and the gap of bounds that their policies are computed to."""
STEPS = 40
FRACTIONS = (0.2, 0.1, 0.05, 0.02, 0.01)
KEPT = 0.97
TUNING, MEASURED = 1, 2
"""Seeds."""


def measure(name: str, *, quick: bool) -> list[dict[str, Any]]:
    """Return a row for each communication policy on a problem."""
    make, gap = PROBLEMS[name]
    model = make()
    policy = mdm.solve(model, gap=gap, time=1.0 if quick else 60.0).policy
    few, many = (5, 5) if quick else (300, 1_000)

    def run(communication: Any, seed: int, *, in_turn: bool = False) -> CommunicationEvaluation:
        episodes = few if seed == TUNING else many
        return evaluate_communication(
            model, policy, communication, episodes=episodes, steps=STEPS, seed=seed, in_turn=in_turn
        )

    threshold = chosen(run)
    ways = {
        "Always": run(Always(), MEASURED),
        "Never": run(Never(), MEASURED),
        "OnChange": run(OnChange(), MEASURED),
        "Budget, every 4th step": run(Budget(0.25), MEASURED),
        f"ValueOfCommunication({threshold:.3g})": run(ValueOfCommunication(threshold), MEASURED),
        f"ValueOfCommunication({threshold:.3g}), in turn": run(ValueOfCommunication(threshold), MEASURED, in_turn=True),
    }
    always, never = ways["Always"], ways["Never"]
    return [{"problem": name, "policy": way, **row(found, always, never)} for way, found in ways.items()]


def chosen(run: Callable[..., CommunicationEvaluation]) -> float:
    """Return the threshold by the rule."""
    always, never = run(Always(), TUNING).mean, run(Never(), TUNING).mean
    for fraction in FRACTIONS:
        threshold = fraction * max(always - never, 0.0)
        if run(ValueOfCommunication(threshold), TUNING).mean >= always - (1 - KEPT) * (always - never):
            return threshold
    return 0.0


def row(
    found: CommunicationEvaluation, always: CommunicationEvaluation, never: CommunicationEvaluation
) -> dict[str, Any]:
    """Return the figures of one way."""
    low, high = found.interval
    random = np.random.default_rng(0)
    picks = random.integers(found.episodes, size=(2_000, found.episodes))
    means = [each.returns[picks].mean(axis=1) for each in (found, always, never)]
    gaps = means[1] - means[2]
    of_gap = 100 * (means[0] - means[2]) / np.where(gaps > 0, gaps, np.nan)
    of_always = 100 * (1 - (means[1] - means[0]) / np.abs(means[1]))
    width = always.mean - never.mean
    return {
        "return": found.mean,
        "± return": (high - low) / 2,
        "% of the gap": 100 * (found.mean - never.mean) / width if width > 0 else None,
        "gap interval": interval(of_gap),
        "% of Always": 100 * (1 - (always.mean - found.mean) / abs(always.mean)),
        "Always interval": interval(of_always),
        "messages a step": found.messages_per_step,
        "% of messages": 100 * found.messages_per_step / always.messages_per_step,
    }


def interval(values: np.ndarray) -> str:
    """Return the 95 % interval of bootstrapped values as text."""
    if np.isnan(values).any():
        return ""
    low, high = np.quantile(values, [0.025, 0.975])
    return f"{low:.1f} to {high:.1f}"


def main() -> None:
    """Measure, show and write."""
    given = arguments(str(__doc__).splitlines()[0])
    rows = []
    for name in list(PROBLEMS)[: 2 if given.quick else None]:
        found = measure(name, quick=given.quick)
        table(name, [{key: value for key, value in each.items() if key != "problem"} for each in found])
        rows += found
    report("communication", {"communication": rows}, given.output)


if __name__ == "__main__":
    main()
