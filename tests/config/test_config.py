from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from mdm import (
    ActorFailure,
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

CALLBACKS = """
calls = []
async def sense(system):
    system.predicates.sense("A", True)
async def work():
    calls.append("work")
def rest():
    calls.append("rest")
def not_async(system):
    pass
async def no_argument():
    pass
number = 7
"""
GOOD = """
tasks = ["robot_code:sense"]
[predicates]
A = { initial = false, max_age = 60.0 }
B = "not A"
Long = { formula = "A", held_for = 2.0 }
Seen = { set = "Work.succeeded", reset = "Ping" }
[events]
Ping = {}
Up = "A"
[ensembles.top]
policy = [0, 1]
safe_action = "Rest"
[ensembles.top.states]
b = ["B"]
[ensembles.top.actions]
Below = { ensemble = "below", resume = true }
Rest = "robot_code:rest"
[ensembles.below]
policy = "below.policy"
drive = 2.0
horizon = 5
supervision = { restart = 2 }
[ensembles.below.states]
a = { predicates = ["A"], on_violation = "hold" }
[ensembles.below.actions]
Work = { call = "robot_code:work", timeout = 3.0, grace = 0.5, on_repeat = "restart" }
Rest = "robot_code:rest"
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "robot_code.py").write_text(CALLBACKS)
    (tmp_path / "broken_code.py").write_text("1 / 0\n")
    (tmp_path / "leaving_code.py").write_text("raise SystemExit(3)\n")
    (tmp_path / "below.policy").write_text("[2](1,0)")
    (tmp_path / "cut.policy").write_text("[2](0,")
    (tmp_path / "three.policy").write_text("[3](0,1,1)")
    return tmp_path


@pytest.fixture(autouse=True)
def forget_modules(monkeypatch):
    import sys

    monkeypatch.setattr(sys, "path", list(sys.path))
    yield
    for name in ("robot_code", "broken_code", "leaving_code"):
        sys.modules.pop(name, None)


def write(folder, text):
    path = folder / "robot.toml"
    path.write_text(text)
    return path


def test_a_file_means_what_the_python_api_means(folder):
    system = load_system(write(folder, GOOD))
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

    system = load_system(write(tmp_path_factory.mktemp("c"), text), callbacks=False)
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


WRONG = [
    ("[predicates]", "[predicats]", "predicats", "there is no key 'predicats'"),
    ('B = "not A"', 'B = "not AA"', "predicates", "'B' uses 'AA', which is not declared; did you mean 'A'"),
    ('B = "not A"', 'B = "not"', "predicates.B", "(column 4)"),
    ('B = "not A"', 'B = "C"\nC = "B"', "predicates", "circle"),
    ("max_age = 60.0", "max_age = -1.0", "predicates.A", "max_age"),
    ("max_age = 60.0", "max_age = inf", "predicates.A.max_age", "1000000000"),
    ("max_age = 60.0", "max_age = nan", "predicates.A.max_age", "> 0.0"),
    ("initial = false", "sensor = false", "predicates.A", "needs a 'formula'"),
    ('formula = "A", ', 'formula = "A", initial = true, ', "predicates.Long", "'initial' means nothing for a formula"),
    ("held_for = 2.0", "held_for = inf", "predicates.Long.held_for", "1000000000"),
    ('Up = "A"', 'Up = "A or"', "events.Up", "(column 5)"),
    ('Up = "A"', 'Up = "Aa"', "events.Up", "'Up' uses 'Aa', which is not declared; did you mean 'A'"),
    ("max_age = 60.0", "maxage = 60.0", "predicates.A.maxage", "did you mean 'max_age'"),
    ("max_age = 60.0", 'max_age = "x"', "predicates.A.max_age", "float"),
    ('formula = "A", ', "", "predicates.Long", "give the formula"),
    (', reset = "Ping"', "", "predicates.Seen", "both 'set' and 'reset'"),
    ('"Work.succeeded"', '"Wrok.succeeded"', "predicates", "no ensemble has; did you mean 'Work'"),
    ('set = "Work', 'formula = "A", set = "Work', "predicates.Seen", "not both"),
    ("policy = [0, 1]", "policy = [0, 2]", "ensembles.top.policy", "is 2"),
    ("policy = [0, 1]", "policy = [0, 1, 1]", "ensembles.top.states", "make 2 states, but the policy is for 3"),
    ("policy = [0, 1]\n", "", "ensembles.top", "no key 'policy'"),
    ('policy = "below.policy"', 'policy = "belw.policy"', "ensembles.below.policy", "no such file"),
    ('policy = "below.policy"', 'policy = "cut.policy"', "ensembles.below.policy", "before the brackets"),
    ('policy = "below.policy"', 'policy = "three.policy"', "ensembles.below.states", "the policy is for 3"),
    ('policy = "below.policy"', 'model = "no.mdp"\npolicy = "below.policy"', "ensembles.below.model", "no such file"),
    ("drive = 2.0", "drive = -2.0", "ensembles.below.drive", "rate"),
    ("drive = 2.0", "drive = 1e-9", "ensembles.below.drive", "a rate is at least 0.000001"),
    ("drive = 2.0", "drive = nan", "ensembles.below.drive", "a rate is at least 0.000001"),
    ("drive = 2.0", "drive = inf", "ensembles.below.drive", "rate"),
    ("drive = 2.0", "deadline = 0.0", "ensembles.below.deadline", "> 0.0"),
    ("drive = 2.0", "deadline = inf", "ensembles.below.deadline", "1000000000"),
    ("drive = 2.0", "seed = -1", "ensembles.below.seed", ">= 0"),
    ("drive = 2.0", 'rewards = "no.rewards"', "ensembles.below.rewards", "no such file"),
    ("drive = 2.0", 'rewards = ""', "ensembles.below.rewards", "path of a file"),
    ('"below.policy"', '"below\\u0000.policy"', "ensembles.below.policy", "path of a file"),
    ("{ restart = 2 }", "{ restart = -2 }", "ensembles.below.supervision.restart", ">= 0"),
    ("{ restart = 2 }", "{ restrt = 2 }", "ensembles.below.supervision.restrt", "did you mean 'restart'"),
    ("{ restart = 2 }", '"pray"', "ensembles.below.supervision", "'pray' is none of 'stop', 'escalate'"),
    ("[ensembles.below]", "[ensembles.predicates]", "ensembles.predicates", "give it another name"),
    ("[ensembles.below]", '[ensembles.""]', "ensembles.", "give it another name"),
    ("drive = 2.0", 'drive = "often"', "ensembles.below.drive", "often"),
    ("horizon = 5", "horizn = 5", "ensembles.below.horizn", "did you mean 'horizon'"),
    ("horizon = 5", "horizon = 0", "ensembles.below.horizon", "at least 1"),
    ('"hold"', '"keep"', "ensembles.below.states.a.on_violation", "'keep' is none of 'first', 'hold', 'error'"),
    ('predicates = ["A"]', 'predicates = ["Aa"]', "ensembles.below.states.a", "'Aa'"),
    ('b = ["B"]', 'b = ["Ping"]', "ensembles.top.states.b", "no declared predicate"),
    ('safe_action = "Rest"', 'safe_action = "Reset"', "ensembles.top.safe_action", "'Reset' is none of"),
    ('Rest = "robot_code:rest"\n[ensembles.below]', "[ensembles.below]", "ensembles.top", "0 to 0"),
    ("robot_code:work", "robot_code:wrk", "ensembles.below.actions.Work", "no 'wrk'; did you mean 'work'"),
    ("robot_code:work", "robot_cod:work", "ensembles.below.actions.Work", "no module 'robot_cod'"),
    ("robot_code:work", "broken_code:work", "ensembles.below.actions.Work", "ZeroDivisionError"),
    ("robot_code:work", "leaving_code:work", "ensembles.below.actions.Work", "SystemExit"),
    ("robot_code:work", "robot_code:number", "ensembles.below.actions.Work", "is a int, not a function"),
    ("robot_code:work", "work", "ensembles.below.actions.Work", "'module:name'"),
    ("timeout = 3.0", "timeout = -3.0", "ensembles.below.actions.Work.timeout", "> 0.0"),
    ("timeout = 3.0", "timeut = 3.0", "ensembles.below.actions.Work.timeut", "did you mean 'timeout'"),
    ('ensemble = "below"', 'ensemble = "bellow"', "ensembles.top.actions.Below", "did you mean 'below'"),
    ('ensemble = "below"', 'ensemble = "top"', "ensembles.top.actions.Below", "circle: top -> top"),
    (
        'ensemble = "below"',
        'call = "robot_code:rest", ensemble = "below"',
        "ensembles.top.actions.Below",
        "one of them",
    ),
    ('Rest = "robot_code:rest"\n[ensembles.below]', 'Rest = { ensemble = "below" }\n[ensembles.below]', "", ""),
    ('tasks = ["robot_code:sense"]', 'tasks = ["robot_code:not_async"]', "tasks", "not an async function"),
    ('tasks = ["robot_code:sense"]', 'tasks = ["robot_code:no_argument"]', "tasks", "one argument, the System"),
    ('tasks = ["robot_code:sense"]', 'tasks = "robot_code:sense"', "tasks", "a list of functions"),
]


@pytest.mark.parametrize(("old", "new", "key", "words"), WRONG)
def test_every_mistake_is_told_with_its_key(folder, old, new, key, words):
    assert GOOD.count(old) >= 1
    text = GOOD.replace(old, new, 1)
    if not words:
        assert load_system(write(folder, text)).top  # two actions of one parent may start the same ensemble
        return
    with pytest.raises(ConfigError) as caught:
        load_system(write(folder, text))
    assert any(str(problem).startswith(f"{folder / 'robot.toml'}: {key}") for problem in caught.value.problems)
    assert words in str(caught.value)


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
    return load_system(write(folder, text)).ensembles["robot"]


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
        ("{}", "states.place", "no key 'predicates'"),
        ('["InA"]\nplce = ["InB"]', "states.plce", "no state factor 'plce'; did you mean 'place'"),
    ],
)
def test_wrong_wiring_is_told_with_its_key(room, states, key, words):
    with pytest.raises(ConfigError) as caught:
        wired(room, states)
    assert f"ensembles.robot.{key}" in {problem.key for problem in caught.value.problems}
    assert words in str(caught.value)


def test_all_mistakes_are_told_at_once(folder):
    text = GOOD.replace("robot_code:work", "robot_code:wrk").replace("max_age", "maxage").replace("horizon", "horizn")
    text = text.replace('"not A"', '"no A"').replace('"Ping"', '"Pong"').replace('"hold"', '"hld"')
    with pytest.raises(ConfigError) as caught:
        load_system(write(folder, text))
    assert [problem.key for problem in caught.value.problems] == [
        "predicates.A.maxage",
        "predicates.B",
        "ensembles.below.horizn",
        "ensembles.below.actions.Work",
        "ensembles.below.states.a.on_violation",
        "predicates.Seen",
    ]
    assert len(str(caught.value).splitlines()) == 6


def test_a_module_of_the_same_name_from_another_folder_is_not_taken_for_this_one(folder, tmp_path_factory):
    load_system(write(folder, GOOD))
    other = tmp_path_factory.mktemp("other")
    (other / "robot_code.py").write_text(CALLBACKS)
    (other / "below.policy").write_text("[2](1,0)")
    with pytest.raises(ConfigError, match="another module 'robot_code' is already loaded, from .*: rename"):
        load_system(write(other, GOOD))


def test_a_task_that_fails_is_named(folder):
    async def main(runtime):
        await runtime.start(load_system(write(folder, GOOD)))
        await runtime.wait()

    (folder / "robot_code.py").write_text(CALLBACKS.replace('system.predicates.sense("A", True)', "1 / 0"))
    with pytest.raises(ActorFailure, match=r"task 'sense' failed: ZeroDivisionError: division by zero \(at .*:4\)"):
        run_virtual(main)


def test_two_parents_and_circles(folder):
    base = "[ensembles.{0}]\npolicy = [0]\n[ensembles.{0}.actions]\nX = {{ ensemble = '{1}' }}\n"
    with pytest.raises(ConfigError, match=r"circle: a -> b -> c -> a"):
        load_system(write(folder, base.format("a", "b") + base.format("b", "c") + base.format("c", "a")))
    leaf = "[ensembles.c]\npolicy = [0]\n[ensembles.c.actions]\nX = 'robot_code:rest'\n"
    with pytest.raises(ConfigError, match="'c' is started by both 'a' and 'b'"):
        load_system(write(folder, base.format("a", "c") + base.format("b", "c") + leaf))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: None, "no such file"),
        (lambda path: path.mkdir(), "folder"),
        (lambda path: path.write_text(""), "no ensemble"),
        (lambda path: path.write_text("[a\n"), "no TOML: .*line 1"),
        (lambda path: path.write_bytes(b"\xff\xfe\0"), "UTF-8"),
        (lambda path: path.write_text("ensembles = 7"), "ensembles is a table"),
    ],
)
def test_what_is_no_configuration(tmp_path, make, words):
    path = tmp_path / "robot.toml"
    make(path)
    with pytest.raises(ConfigError, match=words):
        load_system(path)


def chain(levels):
    text = ""
    for level in range(levels):
        below = f"{{ ensemble = 'e{level + 1}' }}" if level < levels - 1 else "'robot_code:rest'"
        text += f"[ensembles.e{level}]\npolicy = [0]\n[ensembles.e{level}.actions]\ngo = {below}\n"
    return text


def test_a_hierarchy_of_a_hundred_levels_runs_and_deeper_ones_are_refused(folder):
    system = load_system(write(folder, chain(100)))

    async def main(runtime):
        await runtime.start(system)
        for ensemble in system.ensembles.values():
            ensemble.publish_state(0)
        assert system.ensembles["e99"].action.ended == {"succeeded": 1}

    run_virtual(main)
    for levels in (101, 121, 1200):
        with pytest.raises(ConfigError, match="start each other on more than 100 levels"):
            load_system(write(folder, chain(levels)))
