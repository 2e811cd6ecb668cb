"""The numbers of files: what follows from each at several values, by times and counts that are written out here."""

from __future__ import annotations

import asyncio
import shutil
import sys

import numpy as np
import pytest
from loading import written
from places import EXAMPLES
from sentences import refused

import mdm
from mdm import ConfigError, load_system
from mdm.messages import ActionLife, PredicateUpdate, State
from mdm.runtime import Restart
from mdm.testing import capture_decisions, probe, run_virtual

CODE = """
import asyncio
cancelled = []
async def stubborn():
    while True:
        try:
            await asyncio.sleep(1000)
        except asyncio.CancelledError:
            cancelled.append(asyncio.get_running_loop().time())
async def fail():
    raise OSError
async def stay():
    await asyncio.sleep(1000)
async def done():
    pass
"""

ROBOT = """
[predicates]
Low = { initial = false }
PREDICATES
[ensembles.robot]
policy = POLICY
OPTIONS
states = { low = ["Low"] }
[ensembles.robot.actions]
Go = ACTION
Rest = "amounts_code:stay"
"""


def robot(folder, action='"amounts_code:stay"', options="", predicates="", policy="[0, 1]"):
    """Return the system of a file with an action `Go` and options of its ensemble."""
    (folder / "amounts_code.py").write_text(CODE)
    text = ROBOT.replace("ACTION", action).replace("OPTIONS", options).replace("POLICY", policy)
    return load_system(written(folder, text.replace("PREDICATES", predicates), "robot.toml"))


def lived(system, seconds=100.0, say=lambda system: None):
    """Return the times of what actions did and of faults, in seconds from the start."""

    async def main(runtime):
        faults, lives = probe(runtime.faults), probe(runtime.channel("robot/lives", ActionLife))
        await runtime.start(system)
        say(system)
        await asyncio.sleep(seconds)
        return (
            [(life.time / 1e9, life.action, life.status) for life in lives],
            [(fault.time / 1e9, fault.kind) for fault in faults],
        )

    return run_virtual(main)


# -- Actions -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("timeout", "grace"), [(3.0, 0.5), (0.25, 4.0)])
def test_an_action_is_cancelled_at_its_timeout_and_abandoned_after_its_grace(tmp_path, timeout, grace):
    binding = f'{{ call = "amounts_code:stubborn", timeout = {timeout}, grace = {grace} }}'
    lives, _ = lived(robot(tmp_path, binding), seconds=9.0)
    assert sys.modules["amounts_code"].cancelled[0] == timeout
    assert lives == [(0.0, "Go", "running"), (timeout + grace, "Go", "abandoned")]


@pytest.mark.parametrize(("pause", "attempts", "times"), [(2.0, 3, [0, 2, 6]), (0.5, 5, [0, 0.5, 1.5, 3.5, 7.5])])
def test_an_action_that_fails_is_decided_again_after_its_pause_so_many_times(tmp_path, pause, attempts, times):
    action = f'{{ call = "amounts_code:fail", then = "decide", pause = {pause}, attempts = {attempts} }}'
    lives, _ = lived(robot(tmp_path, action))
    assert [time for time, action, status in lives if status == "running"] == times


# -- Predicates --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("held_for", "max_age"), [(2.0, 7.0), (0.25, 1.5)])
def test_a_predicate_holds_after_what_it_is_held_for_and_is_unknown_beyond_its_age(tmp_path, held_for, max_age):
    declared = f'Old = {{ max_age = {max_age} }}\nLong = {{ formula = "Old", held_for = {held_for} }}'
    system = robot(tmp_path, predicates=declared)

    async def main(runtime):
        await runtime.start(system)
        updates = probe(runtime.channel(f"{system.predicates.path}/updates", PredicateUpdate))
        await asyncio.sleep(1.0)
        system.predicates.sense("Old", True)
        await asyncio.sleep(20.0)
        return {name: each.time / 1e9 for each in updates for name in each.rising}, {
            name: each.time / 1e9 for each in updates for name in each.unknown
        }

    risen, unknown = run_virtual(main)
    assert risen == {"Old": 1.0, "Long": 1.0 + held_for}
    assert unknown == {"Old": 1.0 + max_age, "Long": 1.0 + max_age}


# -- Ensembles ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("idle_after", [2.5, 30.0])
def test_an_ensemble_is_idle_after_its_seconds(tmp_path, idle_after):
    _, faults = lived(robot(tmp_path, '"amounts_code:done"', f"idle_after = {idle_after}"))
    assert faults == [(idle_after, "idle")]


@pytest.mark.parametrize("safe_timeout", [3.0, 0.5])
def test_a_safe_action_has_its_seconds(tmp_path, safe_timeout):
    options = f'safe_action = "Rest"\nsafe_timeout = {safe_timeout}\non_unknown = "safe"'
    system = robot(tmp_path, options=options)
    lives, _ = lived(system, say=lambda system: system.predicates.sense("Low", None))
    assert (0.0, "safe action", "running") in lives
    assert (safe_timeout, "safe action", "timed_out") in lives


@pytest.mark.parametrize("horizon", [2, 5])
def test_an_episode_has_so_many_decisions(tmp_path, horizon):
    system = robot(tmp_path, options=f"horizon = {horizon}\ndrive = 1.0")

    async def main(runtime):
        with capture_decisions(runtime) as decisions:
            await runtime.start(system)
            await asyncio.sleep(6.5)
        return [decision.epoch for decision in decisions]

    assert run_virtual(main) == [number % horizon for number in range(7)]


@pytest.mark.parametrize(("deadline", "late"), [(0.5, True), (0.75, False)])
def test_a_decision_is_late_beyond_its_deadline(tmp_path, deadline, late):
    system = robot(tmp_path, options=f"deadline = {deadline}")

    async def main(runtime):
        faults = probe(runtime.faults)
        await runtime.start(system)
        await asyncio.sleep(1.0)
        system.ensembles["robot"].channel("state", State, retain=True).publish(State(400_000_000, 1, (1,)))
        return [fault.kind for fault in faults]

    assert run_virtual(main) == (["deadline"] if late else [])


@pytest.mark.parametrize(
    "restart", [Restart(limit=1, within=20.0, backoff=0.25), Restart(limit=4, within=5.0, backoff=2.0)]
)
def test_an_ensemble_is_restarted_as_its_table_says(tmp_path, restart):
    table = f"{{ restart = {restart.limit}, within = {restart.within}, backoff = {restart.backoff} }}"
    assert robot(tmp_path, options=f"supervision = {table}").ensembles["robot"].supervision == restart


PATIENT = """
[ensembles.tiger]
model = "tiger.pomdp"
policy = "tiger.vf"
OPTIONS
[ensembles.tiger.actions]
listen = "gc:collect"
open-left = "gc:collect"
open-right = "gc:collect"
"""


def tiger(folder, options):
    """Return the system of a file with the model of the tiger."""
    for name in ("tiger.pomdp", "tiger.vf"):
        shutil.copy(EXAMPLES / name, folder / name)
    text = PATIENT.replace("OPTIONS", options)
    return load_system(written(folder, text, "tiger.toml"))


@pytest.mark.parametrize("discount", [0.5, 0.8])
def test_a_discount_takes_the_place_of_the_models(tmp_path, discount):
    assert tiger(tmp_path, f"discount = {discount}").ensembles["tiger"].controller.model.discount == discount


@pytest.mark.parametrize("missed", [0, 1])
def test_what_is_seen_where_nothing_is_may_be_said_by_index(tmp_path, missed):
    system = tiger(tmp_path, f"drive = 'event'\nfalse_negative = {missed}")
    assert system.ensembles["tiger"].controller.model.false_negative == missed


@pytest.mark.parametrize(("megabytes", "enough"), [(0.0001, False), (500, True)])
def test_a_model_takes_the_memory_that_it_may(tmp_path, megabytes, enough):
    if enough:
        assert tiger(tmp_path, f"memory = {megabytes}").ensembles["tiger"].controller.model.is_sparing
    else:
        with refused(ConfigError):
            tiger(tmp_path, f"memory = {megabytes}")


@pytest.mark.parametrize("seed", [3, 8])
def test_a_policy_draws_by_its_seed(tmp_path, seed):
    policy = mdm.policies.StochasticPolicy([[0.4, 0.7], [0.6, 0.3]], seed=seed)
    mdm.save_policy(policy, tmp_path / "drawing.npz")
    system = robot(tmp_path, options=f"seed = {seed}\ndrive = 1.0", policy='"drawing.npz"')

    async def main(runtime):
        with capture_decisions(runtime) as decisions:
            await runtime.start(system)
            await asyncio.sleep(20.5)
        return [decision.action for decision in decisions]

    assert run_virtual(main) == [policy.action(0) for _ in range(21)]


@pytest.mark.parametrize(("agent", "names"), [(0, ("left", "right")), (1, ("up", "down"))])
def test_an_agent_may_be_said_by_index(tmp_path, agent, names):
    spaces = [mdm.models.Factor("a", ["left", "right"]), mdm.models.Factor("b", ["up", "down"])]
    model = mdm.models.MDP([np.eye(2)] * 4, np.zeros((2, 4)), discount=0.9, actions=mdm.models.Space(spaces))
    mdm.save_model(model, tmp_path / "two.npz")
    actions = "".join(f'{name} = "gc:collect"\n' for name in names)
    text = f'[ensembles.robot]\nmodel = "two.npz"\npolicy = [0, 3]\nagent = {agent}\n'
    system = load_system(written(tmp_path, f"{text}[ensembles.robot.actions]\n{actions}", "two.toml"))

    async def main(runtime):
        lives = probe(runtime.channel("robot/lives", ActionLife))
        await runtime.start(system)
        for state in (0, 1):
            system.ensembles["robot"].publish_state(state)
        return [life.action for life in lives if life.status == "succeeded"]

    assert run_virtual(main) == [*names]


@pytest.mark.parametrize(("expansions", "particles", "seconds"), [(200, 50, 0.5), (70, 9, 2.0)])
def test_a_search_has_its_limits(tmp_path, expansions, particles, seconds):
    search = f"{{ expansions = {expansions}, particles = {particles}, seconds = {seconds} }}"
    policy = tiger(tmp_path, f"search = {search}").ensembles["tiger"].controller.policy
    assert (policy.expansions, policy.seconds, policy.parts()[1]["particles"]) == (expansions, seconds, particles)
