"""Faults that are planted in robots, each named soon by its rule; and nothing is named of robots that do well."""

from __future__ import annotations

import asyncio
from collections import Counter

import in_process
import msgspec
import numpy as np
import pytest
from places import EXAMPLES
from team_robots import Robot, over_beliefs

import mdm
from mdm import Ensemble, problems
from mdm.cli.records.page import recorded_run
from mdm.messages import Fault
from mdm.models import MDP, POMDP, Factor, Space
from mdm.policies import AlphaVectors, DeterministicPolicy
from mdm.recording import Record
from mdm.snapshots import Event, LiveRun, RecordedRun
from mdm.snapshots.judgement import RunJudge
from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.testing import run_virtual

SOON = 30.0
"""Seconds within which a rule names a fault once there is evidence of it."""
ACTIONS = ("drive", "fetch", "drop")
STATES = Space([Factor("place", ["base", "shop"]), Factor("load", ["none", "box"])])
SECONDS = {"drive": 3.0, "fetch": 2.0, "drop": 1.0}


def errands(*, works=0.9, **never):
    """Return a model of errands: each action does what it should in nine of ten times, but those that never do."""
    transitions = np.zeros((3, 4, 4))
    for state in range(4):
        place, load = STATES.unravel(state)
        done = {"drive": (1 - place, load), "fetch": (place, 1 if place else load), "drop": (place, load * place)}
        for action, name in enumerate(ACTIONS):
            after = state if never.get(name) else 2 * done[name][0] + done[name][1]
            transitions[action, state, state] += 1 - works
            transitions[action, state, after] += works
    return MDP(transitions=transitions, rewards=np.zeros((4, 3)), discount=0.9, states=STATES, actions=ACTIONS)


class Errands:
    """A robot that fetches boxes from a shop, and the world that it does so in.

    Args:
        model: Its model; None for a policy alone.
        wiring: The predicates of its factors, where they are others than should be.
        seconds: How long actions take, for ever where that is None.
        fails: Whether an action fails, by its name and how often it was called.
        works: Whether an action that comes to its end has its effect.
        deaf: The sensors that tell nothing.
    """

    def __init__(
        self, model=None, *, wiring=None, seconds=None, fails=lambda *_: False, works=None, deaf=(), **options
    ):
        self.rng = np.random.default_rng(7)
        self.place = self.load = 0
        self.predicates = mdm.PredicateManager("predicates")
        self.sensors = {name: self.predicates.sensor(name, initial=False) for name in ("AtShop", "HasBox")}
        self.deaf, self.fails, self.calls = deaf, fails, Counter[str]()
        self.works = works or (lambda _: self.rng.random() < 0.9)
        self.seconds = SECONDS | (seconds or {})
        self.ensemble = Ensemble(
            "robot",
            model=model,
            policy=DeterministicPolicy([0, 2, 1, 0], 3),
            predicates=self.predicates,
            states=[
                mdm.StateFactor("place", {"shop": "AtShop"} if wiring is None else wiring[0]),
                mdm.StateFactor("load", {"box": "HasBox"} if wiring is None else wiring[1]),
            ],
            actions={name: mdm.Binding(self.action(name), then="decide", pause=0.2) for name in ACTIONS},
            **({"on_failed_action": "decide"} | options),
        )

    def action(self, name):
        async def act():
            self.calls[name] += 1
            number = self.calls[name]
            seconds = self.seconds[name]
            await asyncio.sleep(seconds(number) if callable(seconds) else seconds)
            if self.fails(name, number):
                raise RuntimeError(f"no {name}")
            if self.works(name):
                self.do(name)

        return act

    def do(self, name):
        """Have the effect of an action, of which two sensors tell one after another."""
        if name == "drive":
            self.place = 1 - self.place
        elif name == "fetch" and self.place:
            self.load = 1
        elif name == "drop" and not self.place:
            self.load = 0
        for sensor, value in (("AtShop", self.place), ("HasBox", self.load)):
            if sensor not in self.deaf:
                self.sensors[sensor].set(bool(value))


def judged(actors, seconds, path, script=None, *, ensembles=(), look=0.1):
    """Run and record actors; return what was named last live and of the record, with all judgements of the latter."""
    live = []

    async def main(runtime):
        run = LiveRun(runtime)
        run.open()
        for actor in actors:
            await runtime.start(actor)
        task = None if script is None else asyncio.get_running_loop().create_task(script(runtime))
        for _ in range(round(seconds / look)):
            live[:] = run.frame(()).judgements
            await asyncio.sleep(look)
        if task is not None:
            task.cancel()
        live[:] = run.frame(()).judgements

    run_virtual(main, record=path)
    run = RecordedRun(Record(path), ensembles={each.path: each for each in ensembles})
    names = [[(each.rule, each.of, each.subject) for each in found] for found in (live, run.judgements)]
    assert sorted(names[0]) == sorted(names[1])
    return run


def named(run, rule, evidence, words):
    """Check that a rule named something in these words soon after a second."""
    found = [each for each in run.judgements if each.rule == rule]
    assert found, run.judgements
    begins = min(
        event.time
        for event in (msgspec.json.decode(each, type=Event) for each in run.after(0, 10**9)[0])
        if event.kind == "judgement" and event.name == rule and event.status == "begins"
    )
    assert evidence - 1e-6 <= begins <= evidence + SOON
    assert words in str(found[0])
    assert found[0].remedy
    assert run.frame(evidence - 0.01).headline == ""
    return found[0]


MODEL = errands()
BROKEN = {
    # Wiring
    "swapped predicates": ({"wiring": ({"base": "AtShop"}, {"box": "HasBox"})}, 60, "stuck", 4.4, "load stays none"),
    "a negated predicate": ({"wiring": ({"shop": "AtShop"}, {"none": "HasBox"})}, 60, "stuck", 4.8, "load stays box"),
    "a sensor that is stuck": ({"deaf": ("AtShop",)}, 60, "stuck", 12.8, "place stays base"),
    # Models
    "an effect that the model excludes": ({"model": errands(fetch=True)}, 90, "impossible", 30.0, "are impossible by"),
    "a goal that is never reached": ({"works": lambda name: name != "drop"}, 60, "stuck", 9.8, "load stays box"),
    # Actions
    "an action that never succeeds": ({"fails": lambda name, _: name == "fetch"}, 30, "fails", 9.6, "fetch has failed"),
    "an action that fails from then on": (
        {"fails": lambda name, number: name == "fetch" and number > 3},
        *(90, "fails", 50.0, "fetch has failed"),
    ),
    "an action that hangs": (
        {"seconds": {"fetch": lambda number: 1e9 if number > 3 else 2.0}},
        *(90, "hangs", 40.0, "fetch has lasted for more than 10 s"),
    ),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_a_fault_of_an_errand_robot_is_named_soon(fault, tmp_path):
    options, seconds, rule, evidence, words = BROKEN[fault]
    robot = Errands(**({"model": MODEL} | options))
    actors = [robot.predicates, robot.ensemble]
    run = judged(actors, seconds, tmp_path / "run.mcap", ensembles=[robot.ensemble])
    named(run, rule, evidence, words)
    assert run.frame(run.last).headline == str(run.judgements[0])


def test_an_action_that_is_pre_empted_every_few_seconds_is_named_soon(tmp_path):
    robot = Errands(MODEL, seconds={"fetch": lambda number: 1e9 if number > 2 else 2.0})

    async def script(_):
        for _ in range(30):
            await asyncio.sleep(2.5)
            if robot.place and robot.calls["fetch"] >= 3:  # it hangs, and a sensor twitches
                robot.sensors["AtShop"].set(False)
                await asyncio.sleep(0.05)
                robot.sensors["AtShop"].set(True)

    run = judged([robot.predicates, robot.ensemble], 60, tmp_path / "run.mcap", script, ensembles=[robot.ensemble])
    named(run, "pre-empted", 30.0, "fetch is pre-empted again and again")


def test_a_predicate_that_flickers_is_named_soon(tmp_path):
    robot = Errands(MODEL)

    async def script(_):
        await asyncio.sleep(10.0)
        for step in range(200):
            robot.sensors["HasBox"].set(step % 2 == 0)
            await asyncio.sleep(0.2)

    run = judged([robot.predicates], 40, tmp_path / "run.mcap", script)
    found = named(run, "flickers", 10.0, "HasBox: flickers")
    assert (found.of, found.evidence) == ("HasBox", "5 changes a second")


def test_an_input_that_nobody_tells_is_named_soon(tmp_path):
    predicates = mdm.PredicateManager("predicates")
    predicates.sensor("AtShop")
    place, actions = [mdm.StateFactor("place", ["AtShop"])], {"go": lambda: None}
    waits = Ensemble("robot", policy=[0, 0], predicates=predicates, states=place, actions=actions)
    run = judged([predicates, waits], 15, tmp_path / "run.mcap")
    assert "AtShop" in named(run, "waits", 11.0, "robot: cannot decide").evidence


def test_an_action_behind_which_nothing_is_decided_is_named_soon(tmp_path):
    async def go():
        await asyncio.sleep(1.0)

    async def script(_):
        robot.publish_state(0)

    robot = Ensemble("robot", policy=DeterministicPolicy([0]), actions={"go": go})
    run = judged([robot], 60, tmp_path / "run.mcap", script)
    assert named(run, "idle", 31.0, "robot: has nothing to do").evidence == (
        "go has ended, in state 0 as before; nothing decides again"
    )


def heard(draws, model=None):
    """Return a robot that listens for a tiger, and a script of what it hears, twice a second."""
    listens, actions = (
        AlphaVectors([[0.0, 0.0], [-9.0, -9.0], [-9.0, -9.0]], [0, 1, 2]),
        dict.fromkeys(range(3), lambda: None),
    )
    robot = Ensemble("robot", policy=listens, model=model or problems.tiger(), actions=actions)

    async def script(_):
        for left in draws:
            await asyncio.sleep(0.5)
            robot.publish_observation("hear-left" if left else "hear-right")

    return robot, script


def test_observations_that_the_model_does_not_expect_are_named_soon(tmp_path):
    rng = np.random.default_rng(1)
    robot, script = heard(rng.random(200) < 0.5)  # where the model says that it hears right in 85 % of all times
    run = judged([robot], 90, tmp_path / "run.mcap", script, ensembles=[robot])
    named(run, "contradicts", 10.0, "robot: observations contradict its belief")


def test_an_ear_that_hears_the_same_for_ever_is_named_soon(tmp_path):
    robot, script = heard([True] * 200)
    run = judged([robot], 90, tmp_path / "run.mcap", script, ensembles=[robot])
    named(run, "stuck", 47.0, "robot: observes hear-left alone")


def test_a_model_that_does_not_tell_states_apart_is_named_soon(tmp_path):
    same = POMDP(
        transitions=[np.eye(2)] * 3,
        observations=[np.array([[0.85, 0.15]] * 2)] * 3,
        rewards=np.zeros((2, 3)),
        discount=0.95,
        states=["tiger-left", "tiger-right"],
        actions=["listen", "open-left", "open-right"],
        observation_names=["hear-left", "hear-right"],
    )
    robot, script = heard(np.random.default_rng(2).random(100) < 0.85, same)
    run = judged([robot], 40, tmp_path / "run.mcap", script, ensembles=[robot])
    named(run, "unmoved", 10.0, "robot: the belief does not move")


TEAMS = {
    "an agent that was never there": (60.0, "apart", 1.0, "right: was never met: the team is apart"),
    "an agent that falls silent": (12.0, "apart", 8.0, "right: is lost: the team is apart"),
    "an agent of another configuration": (12.0, "disagrees", 0.0, "of the kind refused"),
    "an agent that is there twice": (12.0, "disagrees", 8.0, "of the kind duplicate"),
    "an agent whose clock is ahead": (12.0, "late", 0.0, "of the kind clock"),
}


@pytest.mark.slow
@pytest.mark.parametrize("fault", TEAMS)
def test_a_fault_of_a_team_is_named_soon(fault, tmp_path):
    seconds, rule, evidence, words = TEAMS[fault]

    async def script(runtime):
        network = Network(runtime.clock, team="tigers", lease=0.5)

        async def start(name, **options):
            team = Team("tigers", ["left", "right"], period=1.0, deadline=0.1, **options)
            return await Robot(team, name, network, over_beliefs(problems.dec_tiger())).start(runtime)

        left = await start("left")
        if "never there" in fault:
            return
        right = await start("right", **({"mode": "centralised"} if "configuration" in fault else {}))
        own = right.member.clocks.time
        if "clock" in fault:
            right.member.clocks.time = lambda: own() + 150_000_000
        await asyncio.sleep(8.0)
        if "silent" in fault:
            network.crash("right")
        elif "twice" in fault:
            left.member.link.tell_double("right", "tcp/10.0.0.7:7447")

    named(judged([], seconds, tmp_path / "run.mcap", script, look=0.5), rule, evidence, words)


def test_a_team_that_meets_again_is_not_apart():
    told = []
    judge = RunJudge(told.append)
    judge.gap = 0
    lost = "agent 'right' of team 'tigers' is lost; there are left"
    judge.fault(Fault(10, "left", "lost_teammate", lost))
    judge.seen(20, "right", {"left": 1, "right": 1})  # which sees itself alone
    judge.seen(30, "left", {"left": 1, "right": 2})
    judge.finish(40)
    assert [(each.time, each.status, each.rule, each.of) for each in told] == [
        (10, "begins", "apart", "right"),
        (30, "over", "apart", "right"),
    ]


def world(model, policy=None, **options):
    """Return a robot with a simulated world of its model, which it does not hear of otherwise."""
    policy = mdm.solve(model, gap=0.1).policy if policy is None else policy
    actions = dict.fromkeys(model.action_space.names, lambda: None)
    robot = Ensemble("robot", policy=policy, model=model, actions=actions, **options)
    return [mdm.World(robot, seed=5, period=1.5), robot]


def errand(*arguments, **options):
    robot = Errands(*arguments, **options)
    return [robot.predicates, robot.ensemble]


SOUND = {
    "a tiger heard well": lambda: world(problems.tiger()),
    "a tiger heard badly": lambda: world(problems.tiger(0.65)),
    "a tiger at a fixed rate": lambda: world(problems.tiger(), drive=0.5),
    "a forest": lambda: world(problems.forest()),
    "a swimmer": lambda: world(problems.river_swim()),
    "a grid": lambda: world(problems.grid_world()),
    "errands": lambda: errand(MODEL),
    "errands without a model": errand,
    "errands that fail at times": lambda: errand(MODEL, fails=lambda _, number: number % 5 == 0),
    "errands over ways short and long": lambda: errand(
        MODEL, seconds={"drive": lambda number: 2.0 + 5.0 * (number % 4)}
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("which", SOUND)
def test_nothing_is_named_of_a_robot_that_does_well_for_an_hour(which, tmp_path):
    actors = SOUND[which]()

    async def main(runtime):
        for actor in actors:
            await runtime.start(actor)
        await asyncio.sleep(3600)

    run_virtual(main, record=tmp_path / "run.mcap")
    run = RecordedRun(Record(tmp_path / "run.mcap"), ensembles={"robot": actors[1]})
    assert sum(each.decisions for each in run.frame(run.last).ensembles) > 500
    assert run.judgements == ()


@pytest.mark.parametrize(
    ("file", "seconds"),
    [
        ("patrol/patrol.toml", 150),
        ("tiger.toml", 120),
        pytest.param("tiger.toml", 3600, marks=pytest.mark.slow),
        pytest.param("patrol/patrol.toml", 300, marks=pytest.mark.slow),
    ],
)
def test_nothing_is_named_of_an_example(file, seconds, tmp_path):
    if file.startswith("patrol"):
        pytest.importorskip("navground")
    record = tmp_path / "run.mcap"
    done = in_process.mdm("run", EXAMPLES / file, "--virtual", "--seconds", seconds, "--record", record)
    assert done.status == 0, done.errors
    run = RecordedRun(Record(record))
    assert sum(each.decisions for each in run.frame(run.last).ensembles) > 3
    assert recorded_run(record, replay=False).judgements == run.judgements == ()
