"""What is measured, and its stimuli: what they set and raise, and that nothing of a file runs."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from places import EXAMPLES

import mdm
from mdm.config.functions import nothing
from mdm.latency.subject import Subject

MODEL, POLICY = EXAMPLES / "tiger.pomdp", EXAMPLES / "tiger.vf"
MEETING = EXAMPLES / "team" / "meeting.toml"


def made(given, **options):
    return Subject(given, **{"agent": None, "with_actions": False, "seed": 1} | options)


def decided(subject, stimuli):
    """Return the decisions of each ensemble after so many stimuli, and the values of predicates."""

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            await subject.start(runtime)
            before = {name: each.status().decisions for name, each in subject.ensembles.items()}
            values = []
            for _ in range(stimuli):
                subject.pick()()
                await asyncio.sleep(0)
                values.append([each.predicates.values() for each in subject.ensembles.values() if each.predicates])
            return {name: each.status().decisions - before[name] for name, each in subject.ensembles.items()}, values

    return mdm.run(main, virtual=True)


def chain(states):
    """A model of so many states that follow each other."""
    return mdm.MDP(np.eye(states)[[[*range(1, states), 0]] * 2], np.zeros((states, 2)), discount=0.9)


@pytest.mark.parametrize("states", [2, 7])
def test_each_stimulus_of_an_mdp_is_another_state_and_one_decision(states):
    subject = made((chain(states), [index % 2 for index in range(states)]))
    assert decided(subject, 20)[0] == {"model": 20}


def test_observations_of_a_model_are_published():
    assert decided(made((MODEL, POLICY)), 20)[0] == {"model": 20}
    assert decided(made((mdm.load_model(MODEL), mdm.load_policy(POLICY, mdm.load_model(MODEL)))), 5)[0] == {"model": 5}


def test_exclusive_predicates_are_set_together_and_events_raised():
    manager = mdm.PredicateManager()
    rooms = ["Hall", "Office", "Dock"]
    for name in rooms:
        manager.sensor(name)
    for name in ("left", "right"):
        manager.event(name)
    robot = mdm.Ensemble(
        *("robot",),
        policy=[0, 1, 0],
        predicates=manager,
        states=[mdm.StateFactor("room", rooms)],
        actions=dict.fromkeys(range(2), nothing),
    )
    model = mdm.load_model(MODEL)
    listener = mdm.Ensemble(
        *("listener",),
        policy=mdm.load_policy(POLICY, model),
        model=model,
        predicates=manager,
        observations=[mdm.ObservationFactor("heard", ["left", "right"])],
        actions=dict.fromkeys(range(3), nothing),
    )
    counts, values = decided(made(mdm.System(manager, {"robot": robot, "listener": listener}, [])), 40)
    assert counts["robot"] > 0 < counts["listener"]
    assert sum(counts.values()) == 40
    assert all([each[name] for name in rooms].count(True) == 1 for each, _ in values)
    changes = [one != other for (one, _), (other, _) in pairwise([values[0], *values])]
    assert sum(changes) in {counts["robot"], counts["robot"] - 1}  # the first is not seen


def test_nothing_of_a_file_runs(tmp_path):
    (tmp_path / "code.py").write_text("raise SystemExit('imported')\n")
    (tmp_path / "robot.toml").write_text(
        """tasks = ["code:sense"]
emergency = "code:emergency"
[predicates]
Low = {}
High = "not Low"
[ensembles.robot]
policy = [0, 1]
states = { battery = ["High"] }
actions = { 0 = "code:work", 1 = "code:charge" }
"""
    )
    assert decided(made(tmp_path / "robot.toml"), 10)[0] == {"robot": 10}  # by what its factor is derived from


def test_tasks_links_and_the_last_resort_of_a_system_do_not_run():
    ran = []

    class Link(mdm.Extension):
        async def open(self, runtime):
            ran.append("link")

    async def task(system):
        ran.append("task")

    manager = mdm.PredicateManager()
    manager.sensor("A")
    robot = mdm.Ensemble(
        *("robot",),
        policy=[0, 1],
        predicates=manager,
        states=[mdm.StateFactor("a", ["A"])],
        actions={0: print, 1: print},
    )
    system = mdm.System(
        manager, {"robot": robot}, [task], emergency=lambda: ran.append("emergency"), extensions=[Link()]
    )
    assert decided(made(system), 3)[0] == {"robot": 3}
    assert not ran


def test_an_ensemble_and_those_below_it_are_measured():
    manager = mdm.PredicateManager()
    manager.sensor("A")
    options = {"predicates": manager, "states": [mdm.StateFactor("a", ["A"])]}
    below = mdm.Ensemble("below", policy=[0, 1], actions={0: print, 1: print}, **options)
    top = mdm.Ensemble("top", policy=[0], actions={0: below})
    assert list(made(top).ensembles) == ["top", "below"]


def test_what_cannot_be_measured_is_said(tmp_path):
    (tmp_path / "none.toml").write_text("[predicates]\nA = {}\n")
    with pytest.raises(mdm.Error, match="no ensemble|nothing to measure"):
        made(tmp_path / "none.toml")
    with pytest.raises(mdm.Error, match="say which agent's part: ada, bob"):
        made(MEETING)
    with pytest.raises(mdm.Error, match="decide with its team: give a model and its policy instead"):
        made(MEETING, agent=mdm.config.load_team(MEETING).names[0])
    with pytest.raises(mdm.Error, match="nobody"):
        made(MEETING, agent="nobody")
    with pytest.raises(mdm.Error, match="no table \\[team\\]"):
        made(EXAMPLES / "patrol" / "patrol.toml", agent="x")
    with pytest.raises(mdm.Error):
        made((Path("absent.pomdp"), POLICY))
