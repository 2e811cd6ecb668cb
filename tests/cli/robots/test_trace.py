"""`mdm trace`: stimuli in, decisions out."""

from __future__ import annotations

import itertools
import json
import os
import pty
import subprocess
import sys

import figures
import numpy as np
import pytest
import team_file
from patience import PATIENCE
from places import DATA, EXAMPLES

from mdm import load_model, save_model, save_policy
from mdm.problems import dec_tiger

TIGER = ["--model", str(EXAMPLES / "tiger.pomdp"), "--policy", str(EXAMPLES / "tiger.vf")]


def traced(mdm, *arguments, stdin=""):
    status, output, errors = mdm("trace", *arguments, stdin=stdin)
    return status, [json.loads(line) for line in output], errors


def test_a_model_and_its_policy_need_no_options(mdm):
    stdin = '{"observation": 0}\n'
    assert traced(mdm, TIGER[1], TIGER[3], stdin=stdin) == traced(mdm, *TIGER, stdin=stdin)
    status, _, errors = traced(mdm, TIGER[1], TIGER[3], *TIGER[:2])
    assert status == 2
    assert "are given by --model and --policy or without, and not both" in errors


def test_trace_is_one_line_a_decision_the_first_included(mdm):
    stdin = '{"observation": 0}\n{"time": 1.5, "observation": "hear-left"}\n{"control": "reset"}\n'
    status, lines, _ = traced(mdm, *TIGER, stdin=stdin)
    assert status == 0
    assert [(d["epoch"], d["time"], d["cause"], d["action_name"]) for d in lines] == [
        (0, 0.0, "start", "listen"),
        (1, 0.0, "observation", "listen"),
        (2, 1.5, "observation", "open-right"),
        (0, 1.5, "reset", "listen"),
    ]
    assert "observation" not in lines[0]
    assert lines[1]["observation"] == 0
    assert lines[1]["belief"] == pytest.approx([0.85, 0.15])
    assert lines[0]["reward"] == -1
    again = mdm("trace", *TIGER, stdin=stdin)[1]
    assert again == mdm("trace", *TIGER, stdin=stdin)[1]


def test_trace_at_a_fixed_rate_ends_with_the_tick_of_the_last_stimulus(mdm):
    stdin = '{"time": 0.3, "observation": 1}\n{"time": 1.0, "observation": 0}\n{"time": 1.5}\n'
    _, lines, _ = traced(mdm, *TIGER, "--drive", "2", stdin=stdin)
    assert [d["time"] for d in lines] == [0.0, 0.5, 1.0, 1.5]
    assert [d.get("observation") for d in lines] == [None, 1, 0, None]


def test_trace_of_beliefs_horizons_and_impossible_observations(mdm):
    stdin = '{"belief": [0.99, 0.01]}\n{"observation": 0}\n{"observation": 0}\n'
    _, lines, _ = traced(mdm, *TIGER, "--horizon", "3", stdin=stdin)
    assert [(d["epoch"], d["cause"]) for d in lines] == [
        (0, "start"),
        (1, "belief"),
        (2, "observation"),
        (0, "episode"),
    ]


def test_trace_of_predicates_events_and_states(mdm, tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(
        "[predicates]\nA = {}\nB = 'not A'\n[events]\nE = {}\n[ensembles.robot]\npolicy = [0, 1]\n"
        "[ensembles.robot.states]\nb = ['B']\n[ensembles.robot.actions]\nX = 'nowhere:x'\nY = 'nowhere:y'\n"
    )
    stdin = '{"predicates": {"A": true}}\n{"time": 2, "predicates": {"A": false}, "events": ["E"]}\n{"state": 0}\n'
    status, lines, _ = traced(mdm, path, stdin=stdin)
    assert status == 0
    assert [(d["time"], d["state"], d["action_name"]) for d in lines] == [(0.0, 0, "X"), (2.0, 1, "Y"), (2.0, 0, "X")]
    status, lines, errors = traced(mdm, path, stdin='{"predicates": {"A": true}}\n{"predicates": {"C": true}}\n')
    assert status == 1
    assert len(lines) == 1
    assert "standard input:2: there is no predicate 'C'" in errors


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("{", "standard input:2: "),
        ('{"observaton": 1}', "observaton"),
        ('{"observation": 5}', "no symbol 5"),
        ('{"observation": "hear-lft"}', "did you mean 'hear-left'"),
        ('{"state": 0}', "decides on observations or beliefs"),
        ('{"time": 0.5}', "time goes back from 1 to 0.5"),
        ('{"time": -1}', "from 0 on"),
        ('{"control": "jump"}', "jump"),
        ('{"ensemble": "x"}', "no ensemble 'x'"),
    ],
)
def test_trace_names_the_wrong_line_after_the_decisions_before_it(mdm, line, words):
    status, lines, errors = traced(mdm, *TIGER, stdin=f'{{"time": 1, "observation": 0}}\n{line}\n')
    assert (status, len(lines)) == (1, 2)
    assert "standard input:2: " in errors
    assert words in errors


def test_a_wrong_belief_or_a_derived_name_is_refused_with_its_line(mdm, tmp_path):
    for belief, words in (("[1]", "needs 2 numbers"), ("[0.5,0.6]", "sums to 1.1"), ("[2,-1]", "not a probability")):
        status, lines, errors = traced(mdm, *TIGER, stdin=f'{{"belief": {belief}}}')
        assert (status, len(lines)) == (1, 1)
        assert "standard input:1: the belief" in errors
        assert words in errors
    path = tmp_path / "robot.toml"
    path.write_text(
        "[predicates]\nA = {}\nB = 'not A'\nC = 'robot2/X'\nL = { set = 'Y.failed', reset = 'E' }\n"
        "[events]\nE = {}\nF = 'A'\n[ensembles.robot]\npolicy = [0, 1]\n"
        "[ensembles.robot.states]\nb = ['L']\n[ensembles.robot.actions]\nX = 'nowhere:x'\nY = 'nowhere:y'\n"
    )
    for line, words in (
        ('{"belief": [1, 0]}', "decides on states"),
        ('{"predicates": {"B": true}}', "predicate 'B' is derived"),
        ('{"predicates": {"E": true}}', "no predicate 'E'"),
        ('{"predicates": {"robot2/Y": true}}', "no predicate 'robot2/Y'"),
        ('{"events": ["F"]}', "event 'F' is derived"),
        ('{"events": ["A"]}', "no event 'A'"),
        ('{"events": ["Y.succeeded"]}', "no event 'Y.succeeded'"),
    ):
        status, _, errors = traced(mdm, path, stdin=line)
        assert status == 1
        assert f"standard input:1: {words}" in errors.replace("there is ", "").replace("the policy ", "")
    stdin = '{"predicates": {"robot2/X": true}}\n{"events": ["E"]}\n{"time": 1, "events": ["Y.failed"]}\n'
    status, lines, _ = traced(mdm, path, stdin=stdin)
    assert status == 0
    assert [(d["time"], d["action_name"]) for d in lines] == [(0.0, "X"), (1.0, "Y")]


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        TIGER[:2],
        [str(EXAMPLES / "tiger.toml"), *TIGER[:2]],
        [str(EXAMPLES / "tiger.toml"), "--horizon", "3"],
        [*TIGER, "--horizon", "0"],
        [*TIGER, "--drive", "often"],
    ],
)
def test_arguments_that_do_not_go_together_are_wrong_usage(mdm, arguments):
    status, output, errors = mdm("trace", *arguments)
    assert (status, output) == (2, [])
    assert errors.startswith("usage: mdm trace ")
    assert errors.splitlines()[-1].startswith("mdm trace: error: ")


SHUTTLE = """
[predicates]
At = { set = "Go.succeeded", reset = "Back.succeeded" }
Away = "not At"

[ensembles.robot]
policy = [0, 1]
states.at = ["Away", "At"]
actions = { Go = "shuttle:go", Back = "shuttle:back" }
"""


def shuttle(tmp_path, code):
    (tmp_path / "robot.toml").write_text(SHUTTLE)
    if code is not None:
        (tmp_path / "shuttle.py").write_text(code)
    return tmp_path / "robot.toml"


def test_a_team_has_no_trace(mdm, tmp_path):
    file = team_file.write(tmp_path)
    status, output, errors = mdm("trace", file)
    assert (status, output) == (2, [])
    assert f"mdm trace: error: {file} describes the team " in errors
    assert "--model and --policy" in errors


def test_trace_of_actions_that_take_time_ends_them_by_stimuli(mdm, tmp_path):
    """Each seemed to succeed at once, which led to the other one: a turn without end."""
    path = shuttle(tmp_path, "1 / 0\nasync def go(): ...\nasync def back(): ...\n")
    stimuli = [
        {"time": 1},
        {"time": 2, "events": ["Go.succeeded"]},
        {"time": 3, "events": ["Back.failed"]},
        {"time": 4, "events": ["Back.succeeded"]},
    ]
    status, decisions, told = traced(mdm, path, stdin="\n".join(map(json.dumps, stimuli)))
    assert status == 0
    assert [(d["time"], d["action_name"]) for d in decisions] == [(0.0, "Go"), (2.0, "Back"), (4.0, "Go")]
    assert "action 'Back' failed" in told


def test_trace_of_a_turn_without_end_ends_with_a_sentence(mdm, tmp_path):
    status, _, told = traced(mdm, shuttle(tmp_path, "def go(): ...\ndef back(): ...\n"), stdin='{"time": 1}')
    assert status == 1
    (line,) = told.splitlines()
    assert line.startswith("mdm trace: ")
    assert "must not bring that about at once" in line


def test_trace_releases_a_robot_that_is_safe(mdm, tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(
        f"""
        [predicates]
        Left = {{ max_age = 1.0 }}
        [events]
        L = "Left"
        R = "not Left"
        [ensembles.robot]
        model = "{EXAMPLES / "tiger.pomdp"}"
        policy = "{EXAMPLES / "tiger.vf"}"
        observations.hear = ["L", "R"]
        safe_action = "listen"
        [ensembles.robot.actions]
        listen = "robots:listen"
        open-left = "robots:open"
        open-right = "robots:open"
        """
    )
    lines = ['{"predicates": {"Left": true}}', '{"time": 2}', '{"time": 3, "control": "release"}']
    status, decisions, told = traced(mdm, path, stdin="\n".join(lines))
    assert status == 0
    assert [(d["time"], d["cause"]) for d in decisions] == [(0.0, "start"), (0.0, "observation"), (3.0, "release")]
    assert "mdm trace: input is too old: Left" in told


def test_trace_of_an_ensemble_below_names_each(mdm):
    stdin = '{"time": 1}\n{"time": 2, "ensemble": "patrol", "control": "reset"}\n'
    _, lines, _ = traced(mdm, EXAMPLES / "patrol" / "patrol.toml", stdin=stdin)
    assert lines
    assert all("ensemble" in line for line in lines)


@pytest.fixture(params=["dec_tiger", "grid_small", "patrol"])
def original(request, tmp_path):
    """A run of the original, and the files of its model and its policy."""
    model, policy = tmp_path / "model.npz", tmp_path / "policy.vf"
    save_model(figures.model(request.param), model)
    save_policy(figures.vectors(request.param, 0.9), policy)
    return figures.recorded(request.param), ["--model", model, "--policy", policy]


def test_trace_gives_the_original_s_decisions(mdm, original):
    """Recorded runs of the original, all steps, its episodes of 25 decisions included.

    At a horizon the original publishes two actions for one observation: the episode's last, and at once the next
    episode's first. Ours starts the next episode with the next stimulus, whose observation counts for nothing; so one
    more is given there, and its decision is the second of those two.
    """
    (start, steps, horizon), files = original
    observations, expected = [], []
    for seen, published in steps:
        assert len(published) == (2 if published[0][1] == (horizon or 0) - 1 else 1)
        observations += [seen] * len(published)
        expected += published
    status, lines, _ = traced(
        mdm,
        *files,
        "--on-impossible",
        "keep",
        *(["--horizon", horizon] if horizon else []),
        stdin="".join(json.dumps({"observation": observation}) + "\n" for observation in observations),
    )
    assert status == 0
    assert (lines[0]["action"], lines[0]["epoch"]) == start[:2]
    assert lines[0]["reward"] == pytest.approx(start[2], abs=1e-6)
    for line, (action, epoch, reward, belief) in zip(lines[1:], expected, strict=True):
        assert (line["action"], line["epoch"]) == (action, epoch)
        assert line["cause"] == ("observation" if epoch else "episode")
        assert line["reward"] == pytest.approx(reward, abs=1e-6)
        np.testing.assert_allclose(line["belief"], belief, atol=5e-5)  # probabilities of six digits


def test_trace_takes_false_negatives_into_account(mdm):
    """Any number of false negatives may come before the event that is detected."""
    guard = DATA / "models" / "guard.pgmx"
    status, lines, errors = traced(
        mdm,
        "--model",
        guard,
        "--policy",
        DATA / "policies" / "guard.vf",
        "--false-negative",
        "nothing",
        stdin='{"observation": "bang"}\n',
    )
    assert (status, errors) == (0, "")
    model = load_model(guard)
    belief = model.initial_belief
    for before, line in itertools.pairwise(lines):
        missed, detected = (model.joint_matrix(before["action"], o) for o in ("nothing", "bang"))
        after = np.zeros(2)
        for _ in range(1000):  # none, one, two, ... false negatives
            after += belief @ detected
            belief = belief @ missed
        belief = after / after.sum()
        np.testing.assert_allclose(line["belief"], belief, atol=1e-12)
    status, _, errors = traced(
        mdm, "--model", guard, "--policy", DATA / "policies" / "guard.vf", "--false-negative", "boom", stdin=""
    )
    assert status == 1
    assert "'boom'" in errors


PLAN = """
Policy for agent 0 (index 0):
Oempty,  --> listen
hear-left,  --> open-right
hear-right,  --> open-left
Policy for agent 1 (index 0):
Oempty,  --> listen
hear-left,  --> listen
hear-right,  --> open-left
"""


@pytest.fixture
def plan(tmp_path):
    """A joint policy of the dec-tiger, its model's path, and a file of two robots that run it each by itself."""
    model = tmp_path / "dectiger.dpomdp"
    save_model(dec_tiger(), model)
    (tmp_path / "plan.jpol").write_text(PLAN)
    tables = [
        f"""
[ensembles.robot{agent}]
model = '{model}'
policy = 'plan.jpol'
agent = {agent}
local = true
[ensembles.robot{agent}.actions]
listen = "robot:act"
open-left = "robot:act"
open-right = "robot:act"
"""
        for agent in range(2)
    ]
    (tmp_path / "team.toml").write_text("".join(tables))
    return model, tmp_path


def test_trace_of_a_joint_policy_goes_by_joint_observations(mdm, plan):
    model, folder = plan
    stdin = '{"observation": ["hear-left", "hear-right"]}\n{"observation": 0}\n{"observation": [null, 1]}\n'
    status, lines, _ = traced(mdm, "--model", model, "--policy", folder / "plan.jpol", stdin=stdin)
    assert status == 0
    actions = load_model(model).action_space.names
    expected = [(0, 0), (2, 1), (0, 0), (0, 1)]
    assert [line["action"] for line in lines] == [3 * a + b for a, b in expected]
    assert [line["epoch"] for line in lines] == [0, 1, 0, 1]
    assert [line["action_name"] for line in lines] == [actions[3 * a + b] for a, b in expected]
    assert not any(key in line for line in lines for key in ("belief", "reward", "state"))


def test_trace_of_robots_that_run_their_own_parts(mdm, plan):
    _, folder = plan
    stdin = '{"ensemble": "robot0", "observation": "hear-left"}\n{"ensemble": "robot1", "observation": "hear-left"}\n'
    status, lines, _ = traced(mdm, folder / "team.toml", stdin=stdin)
    assert status == 0
    assert [(line["ensemble"], line["action_name"]) for line in lines] == [
        ("robot0", "listen"),
        ("robot1", "listen"),
        ("robot0", "open-right"),
        ("robot1", "listen"),
    ]
    assert "runs one agent's part of a policy" in mdm("simulate", folder / "team.toml")[2]


def test_simulate_of_a_joint_policy_ends_with_its_plan(mdm, plan):
    model, folder = plan
    status, (line,), _ = mdm(
        "simulate", "--model", model, "--policy", folder / "plan.jpol", "--episodes", "20", "--seed", "1", "--json"
    )
    assert status == 0
    assert json.loads(line)["steps"] == 2


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('{"state": 0}', "decides on observations or beliefs: give one of these, not a state"),
        ('{"belief": [0.5, 0.5]}', "whose nodes have no values: give no belief"),
        ('{"observation": 4}', "no symbol 4"),
    ],
)
def test_what_controllers_do_not_go_by_is_refused(mdm, plan, line, words):
    model, folder = plan
    status, _, errors = traced(mdm, "--model", model, "--policy", folder / "plan.jpol", stdin=line)
    assert status == 1
    assert words in errors


def test_trace_of_a_controller_needs_no_model(mdm, tmp_path):
    (tmp_path / "round.pg").write_text("0 1  0 1\n1 0  1 0\n")
    status, lines, _ = traced(mdm, "--policy", tmp_path / "round.pg", stdin='{"observation": 1}\n{"observation": 0}\n')
    assert status == 0
    assert [(line["action"], line.get("observation")) for line in lines] == [(1, None), (0, 1), (0, 0)]


def test_a_terminal_is_told_what_is_read():
    master, terminal = pty.openpty()
    try:
        command = [sys.executable, "-m", "mdm", "trace", *TIGER]
        with subprocess.Popen(command, stdin=terminal, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            os.write(master, b'{"observation": 0}\n\x04')
            output, errors = process.communicate(timeout=PATIENCE)
    finally:
        os.close(master)
        os.close(terminal)
    assert process.returncode == 0
    assert len(output.splitlines()) == 2
    assert b"mdm trace: reads stimuli, a line each" in errors
