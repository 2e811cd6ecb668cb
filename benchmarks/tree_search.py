"""Online tree search: expansions a second, bounds reached, and how late 100 Hz ticks come beside a search."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from measurement import arguments, quantiles, report, table

import mdm
import mdm.messages

if TYPE_CHECKING:
    from mdm.messages import Tick

HERE = Path(__file__).resolve().parent
CORPUS = HERE.parents[1] / "shared" / "corpus" / "models" / "sarsop"
RATE = 100.0


def act() -> None:
    """Stand in for a robot."""


def searches(quick: bool) -> list[dict[str, Any]]:
    """Search from the initial belief of some models, for several times."""
    paths = [HERE.parent / "examples" / "tiger.pomdp"]
    if not quick:
        paths += [CORPUS / name for name in ("Hallway.pomdp", "Hallway2.pomdp", "TagAvoid.pomdp")]
    rows = []
    for path in paths:
        if not path.exists():
            continue
        model = mdm.load_model(path)
        for seconds in [0.01] if quick else [0.01, 0.1, 1.0]:
            policy = mdm.solvers.TreeSearch(model, seconds=seconds)
            policy.prepare()
            began = time.process_time()
            result = policy.search(model.initial_belief)
            used = time.process_time() - began
            rows.append(
                {
                    "model": path.stem,
                    "states": len(model.state_space),
                    "seconds": seconds,
                    "expansions": result.expansions,
                    "us an expansion (CPU)": used / max(1, result.expansions) * 1e6,
                    "lower": max(result.lower),
                    "upper": max(result.upper),
                }
            )
    return rows


async def ticks(policy: Any, model: mdm.models.MDP, count: int) -> list[float]:
    """Return how late ticks come beside an ensemble that is asked for a decision again and again."""
    late: list[float] = []
    done = asyncio.Event()
    async with mdm.Runtime(log=None) as runtime:
        actor = mdm.Actor("ticks")
        await runtime.start(actor)
        if policy is not None:
            ensemble = mdm.Ensemble("tiger", model=model, policy=policy, actions=dict.fromkeys(range(3), act))
            await runtime.start(ensemble)
            await ensemble.ready()
            channel = runtime.channel("tiger/action", mdm.messages.Action)
            actor.subscribe(channel, lambda _: actor.call_later(0.005, lambda: ensemble.publish_observation(0)))
            ensemble.publish_observation(0)

        def tick(tick: Tick) -> None:
            late.append((runtime.clock.now() - tick.time) / 1e9)
            if len(late) >= count:
                done.set()

        actor.every(RATE, tick)
        await done.wait()
    return late[:count]


class InTheLoop(mdm.policies.BeliefPolicy):
    """A search that a control layer calls as any other policy, within its turn."""

    def __init__(self, search: mdm.solvers.TreeSearch) -> None:
        search.prepare()
        self.num_states, self.num_actions = search.num_states, search.num_actions
        self.action, self.value = search.action, search.value


def beside(quick: bool) -> list[dict[str, Any]]:
    """Measure the loop alone, beside a search of 50 ms in a process of its own, and with it in the loop."""
    model = mdm.load_model(HERE.parent / "examples" / "tiger.pomdp")
    ways: dict[str, Any] = {
        "no search": None,
        "in a process of its own": mdm.solvers.TreeSearch(model, seconds=0.05),
        "in the loop": InTheLoop(mdm.solvers.TreeSearch(model, seconds=0.05)),
    }
    rows = []
    for name, policy in ways.items():
        late = asyncio.run(ticks(policy, model, 20 if quick else 500))
        rows.append({"search": name, **quantiles(late), "mean_us": float(np.mean(late)) * 1e6})
    base = rows[0]["median_us"]
    return [{**row, "times no search": row["median_us"] / base if base else 0.0} for row in rows]


def main() -> None:
    """Measure, print and write."""
    given = arguments(__doc__ or "")
    found, late = searches(given.quick), beside(given.quick)
    table("Searches from the initial belief", found)
    table("Lateness of 100 Hz ticks", late)
    report("tree_search", {"searches": found, "ticks": late}, given.output)


if __name__ == "__main__":
    main()
