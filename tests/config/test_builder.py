"""A configuration file, against the same ensembles made in Python."""

from __future__ import annotations

import pytest
from hypothesis import given, settings, strategies as st
from loading import written
from places import EXAMPLES
from robot_file import GOOD
from sentences import refused

from mdm import (
    ConfigError,
    Ensemble,
    FixedRate,
    OnEvent,
    PredicateManager,
    StateFactor,
    bind,
    load_system,
)
from mdm.config import look_over
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
    assert system.predicates.declared.knows("Up") == "event"

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


def test_what_an_end_is_followed_by_reaches_its_binding(folder):
    text = GOOD.replace("timeout = 3.0,", 'then = "decide", pause = 2.0, attempts = 4,')
    system = load_system(written(folder, text, "robot.toml"))
    sequel = system.ensembles["below"].action.bindings[0].sequel
    assert (sequel.then, sequel.pause, sequel.attempts) == ("decide", 2.0, 4)


@pytest.mark.parametrize(
    "wrong", ['then = "again"', "pause = 0.0", "attempts = 0", "attempts = 1.5", 'pause = "long"', "then = true"]
)
def test_what_an_end_cannot_be_followed_by(folder, wrong):
    text = GOOD.replace("timeout = 3.0", wrong)
    with pytest.raises(ConfigError) as caught:
        load_system(written(folder, text, "robot.toml"))
    assert caught.value.problems[0].key.startswith("ensembles.below.actions.Work")


def test_a_misspelt_end_of_an_action_is_told_with_the_near_one(folder):
    text = GOOD.replace("[predicates]", '[predicates]\nTired = { set = "Work.succeded", reset = "A" }', 1)
    with refused(ConfigError):
        load_system(written(folder, text, "robot.toml"))


def test_what_was_expected_is_nothing_that_toml_has_not(folder):
    with pytest.raises(ConfigError) as caught:
        load_system(written(folder, GOOD.replace("timeout = 3.0", 'timeout = "3"'), "robot.toml"))
    assert "null" not in str(caught.value)
    assert "a number of seconds above 0 and at most 1,000,000,000 was expected, not '3'" in str(caught.value)


def test_the_options_of_safety_reach_their_ensemble(folder, monkeypatch):
    options = {
        "on_impossible": "safe_action",
        "safe_timeout": 3.0,
        "on_failed_action": "decide",
        "idle_after": 2.5,
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

    monkeypatch.setattr("mdm.config.ensembles.Ensemble", record)
    load_system(written(folder, GOOD.replace("drive = 2.0", lines), "robot.toml"))
    assert made["below"] | options == made["below"]


@pytest.mark.parametrize(("file", "held"), [("tiger.pomdp", "a model"), ("tiger.vf", "a policy")])
def test_a_model_or_policy_is_no_file_of_ensembles(file, held):
    with refused(ConfigError):
        load_system(EXAMPLES / file)


ODD = """
raise SystemExit
async def world(system): ...
def plain(system): ...
async def alone(): ...
def two(a, b): ...
def each():
    yield
async def cut(): ...
"""


def test_functions_of_another_kind_are_told_all_at_once_without_running_a_module(tmp_path):
    (tmp_path / "odd_code.py").write_text(ODD)
    file = tmp_path / "odd.toml"
    file.write_text(
        "tasks = ['odd_code:world', 'odd_code:plain', 'odd_code:alone']\nemergency = 'odd_code:cut'\n"
        "[predicates]\nA = {}\n"
        "[ensembles.robot]\npolicy = [0, 1]\nsafe_action = 'odd_code:each'\n[ensembles.robot.states]\na = ['A']\n"
        "[ensembles.robot.actions]\nX = 'odd_code:two'\nY = 'odd_code:cut'\n"
    )
    with pytest.raises(ConfigError) as looked:
        look_over(file)
    keys = [problem.key for problem in looked.value.problems]
    assert keys == ["ensembles.robot.actions.X", "ensembles.robot.safe_action", "tasks", "tasks", "emergency"]
    (tmp_path / "odd_code.py").write_text(ODD.replace("raise SystemExit", ""))
    with pytest.raises(ConfigError) as loaded:
        load_system(file)
    assert str(loaded.value) == str(looked.value)


@pytest.mark.parametrize("name", ["control", "action", "state"])
def test_an_ensemble_that_is_called_as_a_layer_of_the_one_above_is_refused_by_its_key(folder, name):
    text = GOOD.replace("ensembles.below", f"ensembles.{name}").replace('"below"', f'"{name}"')
    assert text != GOOD
    with pytest.raises(ConfigError) as caught:
        load_system(written(folder, text, "robot.toml"))
    (problem,) = caught.value.problems
    assert (problem.key, problem.message[:40]) == (
        f"ensembles.{name}",
        f"an ensemble cannot be called {name!r}, as"[:40],
    )


def test_a_file_may_begin_with_a_byte_order_mark(folder):
    path = written(folder, "", "robot.toml")
    path.write_bytes(b"\xef\xbb\xbf" + GOOD.encode())
    assert load_system(path).ensembles
