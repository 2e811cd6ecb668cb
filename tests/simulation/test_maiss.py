"""The hierarchy that the original was built for: a team's top level whose Patrol is an event-driven POMDP itself."""

from __future__ import annotations

import warnings
from functools import cache

import figures
import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

from mdm import BeliefTracker, Ensemble, Runtime, VirtualClock, World, load_model, run, simulate
from mdm.errors import ModelWarning
from mdm.messages import ActionLife
from mdm.policies import AlphaVectors
from mdm.testing import capture_decisions, probe, run_virtual

ROBOT = ("Patrol", "Assist Person", "Uncommon Incident Response", "Emergency Response")


@cache
def load(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        model = load_model(path).with_discount(0.9)
        return model, model.flatten()


def q_mdp(model):
    """Return the values of acting as if the state were seen from the next step on: a vector for each action."""
    actions = range(len(model.action_space))
    values = np.zeros(len(model.state_space))
    for _ in range(200):
        q = np.stack([model.rewards[:, a] + 0.9 * (model.transition_matrix(a) @ values) for a in actions])
        values = q.max(axis=0)
    return AlphaVectors(q, list(actions), len(model.action_space))


@pytest.fixture
def models(corpus):
    top, flat = load(corpus / "models" / "madp" / "MAISS_TopLevel.pgmx")
    return top, q_mdp(flat), figures.model("patrol"), figures.vectors("patrol", 0.9)


def episode(models, seed, *, seconds=300.0):
    """Run the hierarchy in worlds of its models; return decisions, the lives of top actions, and calls."""
    top_model, top_policy, patrol_model, patrol_policy = models
    calls = []
    patrol = Ensemble(
        "patrol",
        policy=patrol_policy,
        model=patrol_model,
        actions={name: lambda name=name: calls.append(name) for name in patrol_model.action_space.names},
    )
    top = Ensemble(
        "top",
        policy=top_policy,
        model=top_model,
        actions={name: patrol if name == "Patrol" else lambda name=name: calls.append(name) for name in ROBOT},
        agent="Robot 1 Action",
        false_negative="False Negative",
    )

    async def main():
        async with Runtime(clock=VirtualClock(), log=None) as runtime:
            lives = probe(runtime.channel("top/lives", ActionLife))
            with capture_decisions(runtime) as decisions:
                await runtime.start(World(top, seed=seed, period=5.0, name="site"))
                await runtime.start(World(patrol, seed=seed + 1, period=1.0, name="rooms"))
                await runtime.start(top)
                await runtime.clock.sleep(seconds)
            return list(decisions), list(lives)

    return *run(main, virtual=True), calls


@pytest.mark.foreign("MAISS_TopLevel.pgmx of MADPToolbox/MADP")
def test_patrol_decides_while_the_team_says_so(models):
    decisions, lives, calls = episode(models, 1)
    top = [decision for decision in decisions if decision.ensemble == "top"]
    patrol = [decision for decision in decisions if decision.ensemble != "top"]
    names = models[0].action_space.factors[0].names
    assert len(top) > 20
    assert len(patrol) > 20
    assert {names[models[0].action_space.unravel(d.action)[0]] for d in top} >= {"Patrol", "Assist Person"}
    running = [(life.time, life.status) for life in lives if life.action == "Patrol"]
    assert {"running", "preempted"} <= {status for _, status in running}
    for decision in patrol:
        before = [status for time, status in running if time <= decision.time]
        assert before
        assert before[-1] == "running" or decision.time == max(time for time, _ in running if time <= decision.time)
    assert any(call in ROBOT for call in calls)
    assert any(call.startswith("Move") for call in calls)
    again = episode(models, 1)[0]
    assert [(d.time, d.ensemble, d.action, d.observation) for d in decisions] == [
        (d.time, d.ensemble, d.action, d.observation) for d in again
    ]


@pytest.mark.foreign("MAISS_TopLevel.pgmx of MADPToolbox/MADP")
def test_beliefs_are_what_the_observations_lead_to(models):
    """Each belief of the top level, told again by a tracker with matrices of its own kind."""
    decisions, _, _ = episode(models, 7, seconds=120.0)
    top_model, _, _, _ = models
    identity = sparse.eye_array(len(top_model.state_space), format="csc")
    symbols = range(1, len(top_model.observation_space))
    belief, action = top_model.initial_belief, None
    for decision in (decision for decision in decisions if decision.ensemble == "top"):
        if decision.observation is not None and action is not None:
            detected = sum(top_model.joint_matrix(action, o) for o in symbols)
            unnoticed = spsolve((identity - top_model.transition_matrix(action) + detected).T.tocsc(), belief)
            belief = unnoticed @ top_model.joint_matrix(action, decision.observation)
            belief /= belief.sum()
        np.testing.assert_allclose(decision.belief, belief, atol=1e-9)
        action = decision.action


def test_patrol_takes_false_negatives_into_account():
    """Some of the geese that are there are not seen; what is seen later tells of them."""
    model, policy = figures.model("patrol"), figures.vectors("patrol", 0.9)
    aware, unaware = BeliefTracker(model.with_false_negatives("False Negative")), BeliefTracker(model)
    action, seen = model.action_space.index("Move Right"), model.observation_space.index("Corridor-South Clear")
    for tracker in (aware, unaware):
        tracker.update(action, seen)
    assert abs(aware.belief - unaware.belief).max() > 1e-3
    robot = Ensemble(
        "patrol",
        policy=policy,
        model=model,
        actions=dict.fromkeys(model.action_space.names, lambda: None),
        false_negative="False Negative",
    )

    async def main(runtime):
        with capture_decisions(runtime) as decisions:
            await runtime.start(World(robot, seed=4, period=1.0))
            await runtime.start(robot)
            await runtime.clock.sleep(100.0)
        return list(decisions)

    decisions = run_virtual(main)
    assert len(decisions) > 20
    assert all(decision.observation != 0 for decision in decisions)
    for decision in decisions:
        assert decision.belief.sum() == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("episodes", [150, pytest.param(400, marks=pytest.mark.slow)])
def test_the_patrol_s_policy_is_worth_what_madp_says(episodes):
    model, policy = figures.model("patrol"), figures.vectors("patrol", 0.9)
    worth = figures.of("patrol")["values"]["0.9"]["perseus"]
    assert policy.value(model.initial_belief) == pytest.approx(worth)
    result = simulate(model, policy, episodes=episodes, seed=1)
    assert abs(result.mean - worth) < 4 * result.standard_error
    # What is missed costs steps in which nothing is decided.
    assert (
        simulate(model.with_false_negatives(0), policy, episodes=episodes, seed=1).mean
        < worth + 4 * result.standard_error
    )
