"""A configuration file, against the same ensembles made in Python."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from loading import written
from places import EXAMPLES
from robot_file import GOOD

import mdm
from mdm import (
    ConfigError,
    Ensemble,
    FixedRate,
    OnEvent,
    PredicateManager,
    StateFactor,
    bind,
    load_system,
    save_model,
)
from mdm.models import POMDP, Factor, Space
from mdm.policies import DeterministicPolicy
from mdm.testing import capture_decisions, run_virtual


def test_a_file_means_what_the_python_api_means(folder):
    system = load_system(written(folder, GOOD, "robot.toml"))
    top, below = system.ensembles["top"], system.ensembles["below"]
    assert system.top == (top,)
    assert isinstance(top.control.drive, OnEvent)
    assert below.control.drive == FixedRate(2.0)
    assert below.controller.horizon == 5
    work = below.action.bindings[0]
    assert (work.timeout, work.grace, work.on_repeat, work.plain) == (3.0, 0.5, "restart", False)
    assert top.action.bindings[0].resume
    assert top.action.bindings[0].ensemble is below
    assert system.predicates.knows("Up") == "event"

    async def main(runtime):
        with capture_decisions(runtime) as decisions:
            await runtime.start(system)
            await runtime.clock.sleep(1.2)
        assert system.predicates.value("Seen") is True
        return [(decision.ensemble, decision.action_name, decision.time // 10**6) for decision in decisions]

    assert run_virtual(main) == [
        ("top", "Rest", 0),  # B is true at first
        ("top", "Below", 0),  # the task has set A
        ("top/below", "Work", 0),
        ("top/below", "Work", 500),
        ("top/below", "Work", 1000),
    ]


@settings(max_examples=30)
@given(st.data())
def test_random_files_decide_as_the_python_api(tmp_path_factory, data):
    sizes = data.draw(st.lists(st.integers(2, 3), min_size=1, max_size=2))
    states = 1
    for size in sizes:
        states *= size
    policy = data.draw(st.lists(st.integers(0, 2), min_size=states, max_size=states))
    horizon = data.draw(st.none() | st.integers(1, 3))
    names = [[f"P{i}"] if size == 2 else [f"P{i}_{v}" for v in range(size)] for i, size in enumerate(sizes)]
    text = "[predicates]\n" + "".join(f"{name} = {{}}\n" for group in names for name in group)
    text += f"[ensembles.robot]\npolicy = {policy}\n" + (f"horizon = {horizon}\n" if horizon else "")
    text += "[ensembles.robot.states]\n" + "".join(f"f{i} = {group}\n" for i, group in enumerate(names)).replace(
        "'", '"'
    )
    text += "[ensembles.robot.actions]\nX = 'a:x'\nY = 'a:y'\nZ = 'a:z'\n"
    script = data.draw(
        st.lists(
            st.tuples(st.sampled_from([n for g in names for n in g]), st.sampled_from([True, False, None])), max_size=15
        )
    )

    def outcome(root, manager):
        async def main(runtime):
            with capture_decisions(runtime) as decisions:
                await runtime.start(root)
                for name, value in script:
                    manager.sense(name, value)
            return [(d.epoch, d.cause, d.state, d.action, d.action_name) for d in decisions]

        return run_virtual(main)

    system = load_system(written(tmp_path_factory.mktemp("c"), text, "robot.toml"), callbacks=False)
    manager = PredicateManager()
    for group in names:
        for name in group:
            manager.sensor(name)
    robot = Ensemble(
        "robot",
        policy=DeterministicPolicy(policy, 3),
        predicates=manager,
        states=[StateFactor(f"f{i}", group) for i, group in enumerate(names)],
        actions={name: bind(lambda: None) for name in "XYZ"},
        horizon=horizon,
    )
    assert outcome(system, system.predicates) == outcome(robot, manager)


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
        ('{ predicates = "InA" }', "states.place.predicates", "Expected"),
        ("7", "states.place", "a list of predicates, or a table of predicates by symbol, was expected, not 7"),
        ("[7]", "states.place[0]", "Expected `str`"),
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
    with pytest.raises(ConfigError, match=r"cycle: a -> b -> c -> a"):
        load_system(
            written(folder, base.format("a", "b") + base.format("b", "c") + base.format("c", "a"), "robot.toml")
        )
    leaf = "[ensembles.c]\npolicy = [0]\n[ensembles.c.actions]\nX = 'robot_code:rest'\n"
    with pytest.raises(ConfigError, match="'c' is started by both 'a' and 'b'"):
        load_system(written(folder, base.format("a", "c") + base.format("b", "c") + leaf, "robot.toml"))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: None, "no such file"),
        (lambda path: path.mkdir(), "folder"),
        (lambda path: path.write_text(""), "no ensemble"),
        (lambda path: path.write_text("[a\n"), "not valid TOML: .*line 1"),
        (lambda path: path.write_bytes(b"\xff\xfe\0"), "UTF-8"),
        (lambda path: path.write_text("ensembles = 7"), "ensembles must be a table"),
    ],
)
def test_what_is_no_configuration(tmp_path, make, words):
    path = tmp_path / "robot.toml"
    make(path)
    with pytest.raises(ConfigError, match=words):
        load_system(path)


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
    with pytest.raises(ConfigError, match=r"ensembles.robot.states.place: .*indices 0 to 1"):
        load_system(written(folder, text.replace('1 = "A"', '7 = "A"'), "seven.toml"), callbacks=False)


def test_the_options_of_safety_reach_their_ensemble(folder, monkeypatch):
    options = {
        "on_impossible": "safe_action",
        "safe_timeout": 3.0,
        "on_failed_action": "continue",
        "on_lost_input": "continue",
        "on_unknown": "continue",
        "after_safe": "keep",
        "deadline": 0.5,
        "safe_action": "Rest",
    }
    lines = "\n".join(f"{name} = {value!r}" for name, value in options.items())
    made = {}

    def record(name, **given):
        made[name] = given
        return Ensemble(name, **given)

    monkeypatch.setattr("mdm.config.builder.Ensemble", record)
    load_system(written(folder, GOOD.replace("drive = 2.0", lines), "robot.toml"))
    assert made["below"] | options == made["below"]
