"""Robots that patrol a building for half an hour of virtual time, against what the model of the map predicts."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from maps.floors import FURNITURE, offices

import mdm
from mdm.maps import Navigation, Places
from mdm.maps.model import arrivals, latch, model
from mdm.messages import Decision, EventUpdate, PoseUpdate
from mdm.simulation.building import Building

FLOOR = offices(furniture=FURNITURE[offices]).map()
ENDS = {"ada": ("lab", "west"), "bob": ("kitchen", "east")}
SPEED, STAGES = 0.5, 4


@functools.cache
def patrol(on, off):
    """Return the model of a patrol between two rooms, and its best policy."""
    made = model(FLOOR.graph, factors=[latch(FLOOR.graph, "halfway", on=on, off=off)], success=0.9)
    return made, mdm.solve(made, gap=1e-6).policy


@functools.cache
def patrolled(robots, seconds, seed):
    """Let robots patrol; return where each arrived and when, the collisions, and all poses and decisions."""
    building = Building(FLOOR, seed=seed)
    visited, told = {name: [] for name in robots}, []
    parts = []
    for name in robots:
        on, off = ENDS[name]
        made, policy = patrol(on, off)
        predicates = mdm.PredicateManager(f"{name}_predicates")
        places = Places(FLOOR, predicates, margin=0.2, name=f"{name}_places")
        robot = building.robot(name, at=off, places=places, speed=SPEED, noise=0.05)
        predicates.latch("HalfwayThrough", set=f"{on}.at_goal", reset=f"{off}.at_goal")
        ensemble = mdm.Ensemble(
            f"{name}_patrol",
            policy=policy,
            model=made,
            predicates=predicates,
            states=[
                mdm.StateFactor("position", [f"{room}.reached" for room in FLOOR.graph.names]),
                mdm.StateFactor("halfway", {"yes": "HalfwayThrough"}),
            ],
            actions=Navigation(FLOOR, robot, places, name=f"{name}_navigation").actions(),
        )
        parts.append((name, predicates, places, ensemble))

    async def main():
        async with mdm.Runtime(log=None) as runtime:

            def arrived(name, update):
                visited[name] += [
                    (event.removesuffix(".arrived"), update.time / 1e9)
                    for event in update.events
                    if event.endswith(".arrived")
                ]

            runtime.decisions.subscribe(told.append)
            for name, *actors in parts:
                runtime.channel(f"{name}_predicates/events", EventUpdate).subscribe(functools.partial(arrived, name))
                runtime.channel(f"building/{name}/pose", PoseUpdate).subscribe(told.append)
                for actor in actors:
                    await runtime.start(actor)
            await runtime.start(building)
            await runtime.clock.sleep(seconds)

    mdm.run(main, virtual=True)
    for one in told:
        assert isinstance(one, Decision | PoseUpdate)
    return visited, {name: building.robots[name].collisions for name in robots}, [repr(one) for one in told]


def predicted(on, off, speed):
    """Return for each room how often it is visited in a second, and the variance of that count in one."""
    made, policy = patrol(on, off)
    seconds = arrivals(FLOOR, speed=speed)
    rooms, labels = FLOOR.graph.names, FLOOR.graph.labels
    state, seen, order, times = (rooms.index(off), 0), {}, [], []
    while state not in seen:  # drives succeed: the round is a cycle
        seen[state] = len(order)
        room, half = state
        label = made.action_space.names[policy.action(2 * room + half)]
        target = FLOOR.graph.target(rooms[room], label)
        times.append(seconds[room, labels.index(label)])
        order.append(target)
        state = rooms.index(target), 1 if target == on else 0 if target == off else half
    begin = seen[state]
    cycle, times = order[begin:], np.array(times[begin:])
    mean, variance = times.sum(), (times**2 / STAGES).sum()
    return {room: cycle.count(room) / mean for room in rooms}, variance / mean**3


@pytest.mark.parametrize(
    ("robots", "seconds", "trial_seconds"),
    [
        pytest.param(("ada",), 220.0, 150.0, marks=pytest.mark.slow),
        pytest.param(("ada",), 1000.0, 400.0, marks=pytest.mark.slow),
        pytest.param(("ada", "bob"), 1000.0, 400.0, marks=pytest.mark.slow),
    ],
)
def test_rooms_are_visited_as_often_as_the_model_predicts(robots, seconds, trial_seconds):
    visited, collisions, _ = patrolled(robots, seconds, seed=3)
    assert collisions == dict.fromkeys(robots, 0)
    for name in robots:
        on, off = ENDS[name]
        # How fast a robot really is, turns and doors counted, is taken from another run.
        (trial, _, _) = patrolled(robots, trial_seconds, seed=11)
        nominal, _ = predicted(on, off, SPEED)
        times = [time for room, time in trial[name] if room == off]
        assert len(times) >= 2
        pace = (len(times) - 1) / (times[-1] - times[0]) / nominal[off]
        rates, variance = predicted(on, off, SPEED * pace)
        for room, rate in rates.items():
            count = sum(one == room for one, _ in visited[name])
            rounds = rate / rates[off]
            assert abs(count - seconds * rate) <= rounds * (3 * math.sqrt(seconds * variance) + 1), (name, room)


def test_the_same_seed_gives_the_same_poses_and_decisions():
    robots = ("ada", "bob")
    one = patrolled(robots, 40.0, seed=5)
    other = patrolled.__wrapped__(robots, 40.0, seed=5)
    assert one[2] == other[2]
    assert len(one[2]) > 800
