"""How often the intervals of `mdm.estimation` hold the truth, and how often its drift test is wrong.

Robots with a known model are simulated, and estimated from their decisions alone. Coverage is the share of intervals
of 95 % that hold the true number, over all entries of rows that leave a choice. States that are known are drawn in
batches, with actions at random; rates come from the decision loop in virtual time, in a world whose actions take
exponential times, with resets that cut stays short. Where states are hidden the model in use is not the true one: a
fifth of each row is spread evenly over what it holds possible. The code was written with tiger, forest and grid world;
it is measured on others, and on tiger besides, by the standard of its 0.85.
"""

from __future__ import annotations

import asyncio
from collections import defaultdict
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from measurement import arguments, report, table

import mdm
from mdm.estimation import DriftTest, chains_of, counted, evidence_of, fit, rates_of, sample, transition_rows
from mdm.estimation.hidden import Matrices
from mdm.estimation.reestimation import replaced
from mdm.messages import Decision
from mdm.models import MDP, Durations
from mdm.policies import StochasticPolicy
from mdm.simulation.sampler import BatchSampler
from mdm.testing import capture_decisions, run_virtual

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mdm.models import POMDP

KNOWN = {
    "river swim": mdm.problems.river_swim,
    "hallway": mdm.problems.hallway,
    "meeting, 2 x 2 cells": mdm.problems.grid_small,
}
"""Models whose states are known."""
HIDDEN = {
    "dec-tiger": mdm.problems.dec_tiger,
    "recycling robots": mdm.problems.recycling_robots,
    "relay": mdm.problems.relay,
    "broadcast channel": mdm.problems.broadcast_channel,
    "aloha": mdm.problems.aloha,
    "machine maintenance": mdm.problems.machine_maintenance,
}
"""Models whose states are hidden; in the last, of 256 states, most rows are visited a few times."""
FEW = 4
"""Runs of a model with many states, each of which takes a minute."""
SECOND = 1_000_000_000


def decisions(model: MDP, runs: int, count: int, seed: int, weights: Any = None) -> Iterator[list[Decision]]:
    """Yield what robots decide at random, for each run: on observations where the model has any."""
    random = np.random.default_rng(seed)
    hidden = model.pomdp is not None
    sampler = BatchSampler(model, observed=hidden)
    states = sampler.first(random.random(runs))
    seen = np.zeros(runs, dtype=np.intp)
    columns = []
    for _ in range(count):
        actions = random.choice(len(model.action_space), runs, p=weights)
        columns.append((states.tolist(), actions.tolist(), seen.tolist()))
        states, seen = sampler.move(states, actions, random.random((3, runs)))
    for run in range(runs):
        told = []
        for epoch, (state, action, symbol) in enumerate(columns):
            cause = "start" if epoch == 0 else "observation" if hidden else "state"
            observed = symbol[run] if hidden and epoch else None
            known = None if hidden else state[run]
            told.append(Decision(epoch * SECOND, "robot", epoch, cause, known, observed, None, action[run], "", None))
        yield told


def without_observations(model: MDP) -> MDP:
    """Return a model of which the states are known."""
    flat = model.flatten()
    matrices = [flat.transition_matrix(action) for action in range(len(flat.action_space))]
    return MDP(matrices, flat.rewards, discount=flat.discount, initial_belief=flat.initial_belief)


def share(found: list[bool]) -> dict[str, Any]:
    """Return the coverage in per cent, and of how many intervals."""
    return {"intervals": len(found), "coverage %": 100 * float(np.mean(found)) if found else float("nan")}


def known(name: str, *, quick: bool) -> list[dict[str, Any]]:
    """Return the coverage of intervals of T, by visits of the row."""
    model = without_observations(KNOWN[name]())
    bands: dict[str, list[bool]] = defaultdict(list)
    for told in decisions(model, 5 if quick else 200, 400, 1):
        for row in transition_rows(model, counted(chains_of(told, kind="steps").stays()), "steps"):
            if len(row.symbols) > 1:
                band = "1 to 4" if row.visits < 5 else "5 to 19" if row.visits < 20 else "20 or more"
                bands[band] += ((row.low <= row.model) & (row.model <= row.high)).tolist()
    every = [each for band in bands.values() for each in band]
    return [
        {"model": name, "of": "T", "visits": band, **share(bands[band])}
        for band in ("1 to 4", "5 to 19", "20 or more")
        if bands[band]
    ] + [{"model": name, "of": "T", "visits": "all", **share(every)}]


def timed(name: str, *, quick: bool) -> list[dict[str, Any]]:
    """Return the coverage of rates, with stays that resets and other actions cut short, and without these."""
    model = without_observations(KNOWN[name]())
    random = np.random.default_rng(3)
    means = random.uniform(0.5, 3.0, model.rewards.shape)
    policy = StochasticPolicy(random.dirichlet(np.ones(model.rewards.shape[1]), len(model.state_space)).T)
    found: dict[str, list[bool]] = {"rates": [], "rates, without cut stays": []}
    for seed in range(3 if quick else 60):

        async def main(runtime: mdm.Runtime, seed: int = seed) -> list[Decision]:
            names = model.action_space.names
            robot = mdm.Ensemble(
                "robot", policy=policy, model=model, actions=dict.fromkeys(names, lambda: None), seed=seed
            )
            gaps = np.random.default_rng([seed, 9]).exponential(4.0, 60)
            with capture_decisions(runtime) as told:
                await runtime.start(mdm.World(robot, seed=seed, durations=Durations(means)))
                await runtime.start(robot)
                for gap in gaps:
                    await asyncio.sleep(gap)
                    robot.reset()
            return told

        stays = list(chains_of(run_virtual(main)).stays())
        for what, kept in (
            ("rates", stays),
            ("rates, without cut stays", [stay for stay in stays if stay.ended]),
        ):
            for row in rates_of(model, kept):
                truth = np.array([model.transition(row.action, row.state, int(to)) for to in row.symbols])
                truth /= means[row.state, row.action]
                found[what] += ((row.low <= truth) & (truth <= row.high)).tolist()
    return [{"model": name, "of": what, "visits": "all", **share(each)} for what, each in found.items()]


def doubtful(model: POMDP) -> POMDP:
    """Return a model in use that is not the true one."""
    flat = model.flatten()
    matrices = Matrices.of(flat)
    spread = [0.8 * each + 0.2 * (each > 0) / (each > 0).sum(axis=-1, keepdims=True) for each in matrices]
    other = replaced(flat, list(spread[0]), list(spread[1]))
    assert other.pomdp is not None
    return other.pomdp


def hidden(name: str, *, quick: bool) -> list[dict[str, Any]]:
    """Return the coverage of Gibbs intervals of T and O."""
    model = HIDDEN[name]().flatten()
    truth, use = Matrices.of(model), doubtful(model)
    found: dict[str, list[bool]] = {"T, hidden": [], "O, hidden": []}
    runs = 1 if quick else 40 if len(model.state_space) < 100 else FEW
    for told in decisions(model, runs, 60 if quick else 400, 4):
        evidence = evidence_of(use, chains_of(told).chains)
        fitted = fit(use, evidence)
        intervals = sample(use, evidence, fitted)
        for what, ends, true, counts in (
            ("T, hidden", intervals.transitions, truth.transitions, fitted.transition_counts),
            ("O, hidden", intervals.observations, truth.observations, fitted.observation_counts),
        ):
            free = (true > 0) & (true < 1) & (counts.sum(axis=-1, keepdims=True) >= 1)
            found[what] += ((ends[0] <= true) & (true <= ends[1]))[free].tolist()
    return [{"model": name, "of": what, "visits": "all", **share(each)} for what, each in found.items()]


def tiger(*, quick: bool) -> list[dict[str, Any]]:
    """Return what is estimated of the 0.85 by which the tiger is heard right, from 2,000 decisions."""
    model = mdm.problems.tiger()
    use = doubtful(model)
    estimates, covered = [], []
    for told in decisions(model, 1 if quick else 40, 2_000, 5, [0.8, 0.1, 0.1]):
        evidence = evidence_of(use, chains_of(told).chains)
        fitted = fit(use, evidence)
        intervals = sample(use, evidence, fitted, sweeps=2 if quick else 30)
        for door in (0, 1):
            estimates.append(float(fitted.observations[0, door, door]))
            low, high = intervals.observations[:, 0, door, door]
            covered.append(bool(low <= 0.85 <= high))
    return [
        {
            "of": "0.85",
            "model in use": float(use.observation(0, 0, 0)),
            "mean": float(np.mean(estimates)),
            "least": min(estimates),
            "most": max(estimates),
            **share(covered),
        }
    ]


def drift(name: str, *, quick: bool) -> list[dict[str, Any]]:
    """Return in how many of runs with a model that is right drift is told."""
    problems = KNOWN | HIDDEN
    model = problems[name]()
    if name in KNOWN:
        model = without_observations(model)
    runs, count = (5, 100) if quick else (1_000, 1_000 if name in KNOWN else 300)
    alarms = dict.fromkeys((20, 100, 1000), 0)
    for told in decisions(model, runs, count, 6):
        for odds in alarms:
            test = DriftTest(model, odds=odds, kind="steps")
            alarms[odds] += any(test.take(each) is not None for each in with_beliefs(model, told))
    return [
        {"model": name, "odds": odds, "runs": runs, "decisions": count, "alarms": times, "at most": runs / odds}
        for odds, times in alarms.items()
    ]


def with_beliefs(model: MDP, told: list[Decision]) -> list[Decision]:
    """Return decisions on observations with the belief of a tracker."""
    if told[0].state is not None:
        return told
    tracker = mdm.BeliefTracker(model)
    result = []
    for place, each in enumerate(told):
        if place:
            tracker.update(told[place - 1].action, each.observation)
        result.append(msgspec.structs.replace(each, belief=np.array(tracker.belief)))
    return result


def main() -> None:
    """Measure, print and write."""
    options = arguments(__doc__.splitlines()[0])
    coverage = [row for name in KNOWN for each in (known, timed) for row in each(name, quick=options.quick)]
    table("Coverage of intervals of 95 %, states known", coverage)
    drifts = [row for name in (*KNOWN, "dec-tiger") for row in drift(name, quick=options.quick)]
    table("Runs of a model that is right in which drift is told", drifts)
    behind = [row for name in HIDDEN for row in hidden(name, quick=options.quick)]
    table("Coverage of intervals of 95 %, states hidden", behind)
    heard = tiger(quick=options.quick)
    table("The tiger is heard right with 0.85, estimated from 2,000 decisions", heard)
    report("intervals", {"coverage": coverage, "hidden": behind, "tiger": heard, "drift": drifts}, options.output)


if __name__ == "__main__":
    main()
