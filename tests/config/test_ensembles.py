"""Ensembles of a file: their wiring, their order and their policies."""

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
from mdm import ConfigError, load_system, save_model
from mdm.messages import ActionLife
from mdm.models import POMDP, Factor, Space
from mdm.testing import capture_decisions, probe, run_virtual

ROOM = """
[predicates]
InA = {}
InB = {}
[events]
Hot = {}
Cold = {}
[ensembles.robot]
model = "room.pomdpx"
policy = "room.policy"
[ensembles.robot.states]
place = STATES
[ensembles.robot.observations]
heat = OBSERVATIONS
[ensembles.robot.actions]
go = "robot_code:rest"
"""


@pytest.fixture
def room(folder):
    spaces = {name: Space([Factor(name, names)]) for name, names in (("place", "ab"), ("heat", "hc"))}
    model = POMDP(
        [np.eye(2)],
        [np.eye(2)],
        np.zeros((2, 1)),
        discount=0.9,
        states=spaces["place"],
        actions=["go"],
        observation_names=spaces["heat"],
    )
    save_model(model, folder / "room.pomdpx")
    (folder / "room.policy").write_text("[2](0,0)")
    return folder


def wired(folder, states, observations='{ h = "Hot", c = "Cold" }'):
    text = ROOM.replace("STATES", states).replace("OBSERVATIONS", observations)
    return load_system(written(folder, text, "robot.toml")).ensembles["robot"]


@pytest.mark.parametrize(
    ("states", "observations", "places", "events"),
    [
        ('["InA", "InB"]', '["Hot", "Cold"]', ("InA", "InB"), ("Hot", "Cold")),
        ('{ b = "InB", a = "InA" }', '{ c = "Cold", h = "Hot" }', ("InA", "InB"), ("Hot", "Cold")),
        (
            '{ predicates = { b = "InB", a = "InA" }, on_violation = "hold" }',
            '{ events = { h = "Hot" }, idle = "c" }',
            ("InA", "InB"),
            ("Hot", None),
        ),
        ('{ a = "InA" }', '{ events = ["Hot", "Cold"], hold = true }', ("InA",), ("Hot", "Cold")),
    ],
)
def test_symbols_are_wired_by_order_or_by_name(room, states, observations, places, events):
    robot = wired(room, states, observations)
    assert robot.state.factors[0].predicates == places
    assert robot.state.factors[0].truth(0)["InA"] is (len(places) == 2 or robot.state.factors[0].positive == 0)
    assert robot.observation.factors[0].events == events


@pytest.mark.parametrize(
    ("states", "key", "words"),
    [
        ('{ a = "InA", c = "InB" }', "states.place", "has no symbol 'c'"),
        ('{ a = "InA", b = "InC" }', "states.place", "'InC', which is no declared predicate; did you mean"),
        ('{ predicate = ["InA", "InB"] }', "states.place.predicate", "did you mean 'predicates'"),
        ('{ predicates = "InA" }', "states.place.predicates", "a table or a list was expected, not 'InA'"),
        ("7", "states.place", "a list of predicates, or a table of predicates by symbol, was expected, not 7"),
        ("[7]", "states.place[0]", "a text was expected, not 7"),
        ("{}", "states.place", "required key 'predicates' is missing"),
        ('["InA"]\nplce = ["InB"]', "states.plce", "no state factor 'plce'; did you mean 'place'"),
    ],
)
def test_wrong_wiring_is_told_with_its_key(room, states, key, words):
    with pytest.raises(ConfigError) as caught:
        wired(room, states)
    assert f"ensembles.robot.{key}" in {problem.key for problem in caught.value.problems}
    assert words in str(caught.value)


def test_two_parents_and_cycles(folder):
    base = "[ensembles.{0}]\npolicy = [0]\n[ensembles.{0}.actions]\nX = {{ ensemble = '{1}' }}\n"
    with refused(ConfigError):
        load_system(
            written(folder, base.format("a", "b") + base.format("b", "c") + base.format("c", "a"), "robot.toml")
        )
    leaf = "[ensembles.c]\npolicy = [0]\n[ensembles.c.actions]\nX = 'robot_code:rest'\n"
    with refused(ConfigError):
        load_system(written(folder, base.format("a", "c") + base.format("b", "c") + leaf, "robot.toml"))


def test_a_search_with_its_fallback(tmp_path):
    system = searching(tmp_path, "{ expansions = 200, seconds = 0.5, plans = true, particles = 50 }")
    policy = system.ensembles["tiger"].controller.policy
    assert isinstance(policy, mdm.solvers.TreeSearch)
    assert isinstance(policy.fallback, mdm.policies.AlphaVectors)
    assert (policy.expansions, policy.seconds) == (200, 0.5)
    assert policy.parts()[1]["seed"] == 4
    assert policy.parts()[1]["particles"] == 50
    assert policy.value([0.5, 0.5]) > 19

    async def main(runtime):
        with capture_decisions(runtime) as decisions:
            await runtime.start(system)
            for _ in range(2):
                system.ensembles["tiger"].publish_observation(0)
        return [decision.action_name for decision in decisions]

    assert run_virtual(main) == ["listen", "listen", "open-right"]


def searching(folder, search, policy='"tiger.vf"', model='model = "tiger.pomdp"'):
    for name in ("tiger.pomdp", "tiger.vf"):
        shutil.copy(EXAMPLES / name, folder / name)
    text = f"""
        [ensembles.tiger]
        {model}
        policy = {policy}
        seed = 4
        search = {search}
        [ensembles.tiger.actions]
        listen = "gc:collect"
        open-left = "gc:collect"
        open-right = "gc:collect"
    """
    (folder / "system.toml").write_text(text)
    return mdm.load_system(folder / "system.toml")


@pytest.mark.parametrize(
    ("search", "options", "text"),
    [
        ("{ second = 1.0 }", {}, "second"),
        ("{ seconds = 0.0 }", {}, "seconds"),
        ("{ }", {}, "a tree search needs an end: give it seconds, or a number of expansions"),
        ("{ expansions = 5 }", {"model": "", "policy": "[0, 1]"}, "a search needs a model"),
        (
            "{ expansions = 5, plans = true }",
            {"policy": "[0, 1]"},
            "plans are alpha vectors, but the policy is of another",
        ),
        ("{ expansions = 5 }", {"policy": "[0, 1]"}, "the fallback chooses by state, but the search by belief"),
    ],
)
def test_what_is_wrong_with_a_search_is_told_with_its_key(tmp_path, search, options, text):
    with pytest.raises(mdm.ConfigError, match=text) as raised:
        searching(tmp_path, search, **options)
    assert "ensembles.tiger.search" in str(raised.value)


@pytest.mark.parametrize(("wires", "first"), [('{ 1 = "A", 0 = "B" }', "B"), ('{ 0 = "B", 1 = "A" }', "B")])
def test_digits_are_indices_where_there_is_no_model(folder, wires, first):
    text = f"""
        predicates = {{ A = {{}}, B = {{}} }}
        [ensembles.robot]
        policy = [0, 1]
        states = {{ place = {wires} }}
        actions = {{ 0 = "code:x", 1 = "code:y" }}
    """
    system = load_system(written(folder, text, "digits.toml"), callbacks=False)
    layer = system.ensembles["robot"].state
    assert layer is not None
    assert layer.factors[0].predicates[0] == first
    with refused(ConfigError):
        load_system(written(folder, text.replace('1 = "A"', '7 = "A"'), "seven.toml"), callbacks=False)


@pytest.mark.parametrize("callbacks", [True, False])
def test_a_safe_action_by_a_function_is_there_whether_or_not_functions_are_called(folder, callbacks):
    text = """
        [ensembles.robot]
        policy = [0]
        safe_action = "robot_code:rest"
        on_failed_action = "safe"
        actions = { 0 = "robot_code:rest" }
    """
    system = load_system(written(folder, text, "safe.toml"), callbacks=callbacks)
    safe = system.ensembles["robot"].action.safe
    assert safe is not None
    assert safe.function.__name__ == ("rest" if callbacks else "nothing")
    if not callbacks:
        load_system(written(folder, text.replace("robot_code:rest", "no_module:brake"), "n.toml"), callbacks=False)


DRIFTING = """
[predicates]
Wet = { initial = false }
Dry = "not Wet"
[ensembles.robot]
model = "weather.npz"
policy = [0, 0]
drive = 1.0
drift = ODDS
[ensembles.robot.states]
weather = { dry = "Dry", wet = "Wet" }
[ensembles.robot.actions]
go = "robot_code:rest"
"""


def drifting(folder, odds="1000"):
    matrix = [[0.9, 0.1], [0.3, 0.7]]
    states = Space([Factor("weather", ["dry", "wet"])])
    model = mdm.models.MDP([matrix], np.zeros((2, 1)), discount=0.9, states=states, actions=["go"])
    save_model(model, folder / "weather.npz")
    return load_system(written(folder, DRIFTING.replace("ODDS", odds), "robot.toml"), callbacks=False)


def weather(system, seconds):
    """Return the faults while the weather changes each second, which the model holds for rare."""

    async def main(runtime):
        faults = probe(runtime.faults)
        await runtime.start(system)
        for second in range(seconds):
            await runtime.clock.sleep(second + 0.5 - runtime.clock.now() / 1e9)
            system.predicates.sense("Wet", bool(second % 2))
        return [(fault.source, fault.kind, fault.detail) for fault in faults]

    return run_virtual(main)


def test_a_model_that_decisions_contradict_is_a_fault_at_the_odds_of_the_file(folder):
    (first, second) = weather(drifting(folder), 60)
    assert first[:2] == second[:2] == ("robot-drift", "drift")
    sources = {detail.partition(" by ")[0] for _, _, detail in (first, second)}
    assert sources == {"robot: from 'dry'", "robot: from 'wet'"}
    assert weather(drifting(folder, "1e30"), 60) == []


@pytest.mark.parametrize("odds", ["1", "true", '"high"'])
def test_odds_of_drift_are_more_than_1(folder, odds):
    with refused(ConfigError):
        drifting(folder, odds)


def test_drift_needs_a_model(folder):
    text = DRIFTING.replace('model = "weather.npz"\n', "").replace("ODDS", "10")
    with refused(ConfigError):
        load_system(written(folder, text, "robot.toml"), callbacks=False)


@pytest.mark.parametrize(
    ("options", "lived"),
    [
        ('group = "wheels"', ["A on", "A preempted", "B on", "A off"]),
        ("grace = 5.0", ["A on", "A off", "A preempted", "B on"]),
        ("may_succeed = true", ["A on", "A off", "A succeeded", "B on"]),
        ('group = "wheels", may_succeed = true', ["A on", "A preempted", "B on", "A off"]),
    ],
)
def test_a_group_and_a_late_success_are_of_a_file_too(folder, options, lived):
    """Of functions of one group the next begins before the last is cancelled, which is told as preempted by then."""
    (folder / "drives_code.py").write_text(DRIVES)
    sys.modules.pop("drives_code", None)
    text = f"""
        [ensembles.robot]
        policy = [0, 1]
        [ensembles.robot.actions]
        A = {{ call = "drives_code:a", {options} }}
        B = {{ call = "drives_code:b", {options} }}
    """
    system = load_system(written(folder, text, "drives.toml"))
    robot, log = system.ensembles["robot"], sys.modules["drives_code"].log

    def tell(life):
        if life.status not in {"running", "abandoned"}:
            log.append(f"{life.action} {life.status}")

    async def main(runtime):
        runtime.channel("robot/lives", ActionLife).subscribe(tell)
        await runtime.start(system)
        for state in (0, 1):
            robot.publish_state(state)
            await asyncio.sleep(2)
        return list(log)

    assert run_virtual(main) == lived


DRIVES = """
import asyncio
log = []
async def drive(name):
    log.append(f"{name} on")
    try:
        await asyncio.sleep(1000)
    except asyncio.CancelledError:
        await asyncio.sleep(1)
        log.append(f"{name} off")
async def a():
    await drive("A")
async def b():
    await drive("B")
"""
