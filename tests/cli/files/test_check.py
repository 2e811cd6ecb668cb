"""`mdm check`: all problems at once, and what is odd."""

from __future__ import annotations

import json
import re

import pytest
from places import EXAMPLES, MODELS, POLICIES, TIGER

from mdm import load_model, save_model, save_policy
from mdm.policies import AlphaVectors


def test_check_notes_what_an_ensemble_waits_for(mdm, tmp_path):
    (tmp_path / "robot.toml").write_text(
        "[ensembles.robot]\npolicy = [0, 1]\n[ensembles.robot.actions]\nX = 'builtins:print'\nY = 'builtins:print'\n"
    )
    status, lines, _ = mdm("check", tmp_path / "robot.toml")
    assert status == 0
    assert "note: ensemble 'robot' has no states: it waits for code that publishes what it decides on" in lines[0]
    _, lines, _ = mdm("check", EXAMPLES / "patrol" / "patrol.toml")
    assert not any("waits for code" in line for line in lines)


GOING = """
[predicates]
At = { set = "Go.succeeded", reset = "Back.succeeded" }
On = {}
Off = {}

[events]
Stuck = "Back.failed or Back.timed_out"

[ensembles.robot]
policy = [0, 1, 2]
states.at = ["At", "Off", "On"]
actions = { Go = "going:go", Back = { call = "going:back" }, Stop = "going:stop" }
"""
CODE = "1 / 0\nasync def go(): ...\nasync def back(): ...\ndef stop(): ...\n"


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({}, ["Go or Back has failed"]),
        ({'set = "Go.succeeded"': 'set = "Go.failed"'}, ["Back has failed", "Go has succeeded"]),
        (
            {'"Go.succeeded", reset = "Back.succeeded"': '"Stuck", reset = "false"'},
            ["Go has ended", "Back has succeeded"],
        ),
        ({'"going:back"': '"going:back", then = "decide"'}, ["Go has failed"]),
        ({'"going:back"': '"going:back", then = "wait"'}, ["Go has failed"]),
        ({"policy =": 'on_failed_action = "decide"\npolicy ='}, []),
        ({"policy =": "drive = 2.0\npolicy ="}, []),
        ({'"going:go"': '"going:stop"'}, ["Back has failed"]),
    ],
)
def test_check_notes_what_can_end_with_nothing_that_decides_afterwards(mdm, tmp_path, changed, told):
    text = GOING
    for old, new in changed.items():
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "robot.toml").write_text(text)
    (tmp_path / "going.py").write_text(CODE)
    status, lines, errors = mdm("check", tmp_path / "robot.toml")
    assert (status, errors) == (0, "")
    notes = [line.partition("when ")[2].partition(", nothing")[0] for line in lines if "nothing decides" in line]
    assert sorted(notes) == sorted(told)


@pytest.mark.parametrize("file", ["tiger.pomdp", "tiger.vf", "tiger.toml", "patrol/patrol.toml", "patrol/top.policy"])
def test_check_accepts_the_examples(mdm, file):
    status, output, errors = mdm("check", EXAMPLES / file)
    assert (status, errors) == (0, "")
    assert output[-1].endswith("no problems found")


def test_check_tells_all_problems(mdm, tmp_path):
    text = (EXAMPLES / "tiger.toml").read_text()
    path = tmp_path / "tiger.toml"
    path.write_text(text.replace('"HearLeft"', '"HearLft"').replace("drive", "drve"))
    status, _, errors = mdm("check", path)
    assert status == 1
    assert len(errors.splitlines()) >= 1
    assert "drve" in errors


BROKEN = """discount: 0.9
values: reward
states: a b c lost
actions: go stay wait
observations: x y never
start: 0.5 0.4 0 0
T: go : a : b 0.9
T: go : b : a 1
T: go : c : c -0.5
T: go : lost : lost 1
T: stay
identity
O: *
0.5 0.5 0
0.5 0.5 0
0.5 0.6 0
0.5 0.5 0
R: go : nowhere : * : * 5
"""


def test_check_tells_all_problems_of_a_model_at_once(mdm, tmp_path):
    path = tmp_path / "broken.pomdp"
    path.write_text(BROKEN)
    status, output, errors = mdm("check", path)
    assert status == 1
    assert not output
    for words in (
        "broken.pomdp:9:15: -0.5 is not a probability",
        "broken.pomdp:18:9: 'nowhere'",
        "no 'T' statement is given for action 'wait'",
        "the initial belief sums to 0.9",
        "T of action 'go': the row of 'a' sums to 0.9, not to 1",
        "T of action 'go': the row of 'c' sums to 0, not to 1",
        "O of action 'go': the row of 'c' sums to 1.1, not to 1",
    ):
        assert words in errors
    assert "broken.pomdp: 7 problems found" in errors
    status, output, _ = mdm("check", path, "--json")
    report = json.loads(output[0])
    assert status == 1
    assert len(report["problems"]) >= 7
    assert all(str(path) in problem for problem in report["problems"])


def test_check_normalizes_on_demand_and_notes_what_is_odd(mdm):
    path = MODELS / "odd.pomdp"
    status, _, errors = mdm("check", path)
    assert status == 1
    assert errors.count("\n") == 1
    assert "T of action 'go': the row of 'a' sums to 0.95, not to 1" in errors
    status, output, errors = mdm("check", "--normalize", path)
    assert (status, errors) == (0, "")
    text = "\n".join(output)
    for words in (
        "sums to 0.95, not to 1; normalised",
        "1 of 4 states ('lost') cannot be reached",
        "1 of 4 states ('sink') are never left",
        "1 of 2 actions ('stay') never change",
        "1 of 3 observations ('never') can never occur",
    ):
        assert words in text
    assert output[-1].endswith("a model (POMDP), no problems found")


def test_check_of_policies(mdm, tmp_path):
    status, output, _ = mdm("check", POLICIES / "tiger.alpha")
    assert status == 0
    assert "a policy (alpha vectors)" in output[-1]
    save_policy(AlphaVectors([[1.0, 2.0, 3.0]], [1], 3), tmp_path / "other.vf")
    status, output, _ = mdm("check", tmp_path / "other.vf")
    assert any("actions 0 are never chosen" in line for line in output)
    status, _, errors = mdm("check", "--model", TIGER, tmp_path / "other.vf")
    assert status == 1
    assert "3 states" in errors
    status, _, errors = mdm("check", "--model", TIGER, TIGER)
    assert status == 2
    assert "holds a model itself" in errors


def test_check_tells_mistakes_of_all_kinds_at_once_and_runs_no_module(mdm, tmp_path):
    (tmp_path / "checked_robot.py").write_text("raise SystemExit('this was run')\n\ndef listen(): ...\n")
    for name in ("tiger.pomdp", "tiger.vf"):
        (tmp_path / name).write_text((EXAMPLES / name).read_text())
    path = tmp_path / "robot.toml"
    path.write_text(
        """[events]
HearLeft = {}
[ensembles.robot]
model = "tiger.pomdp"
policy = "tiger.vf"
observations = { growl = ["HearLeft", "HearRight"] }
[ensembles.robot.actions]
listen = "checked_robot:lisen"
open-left = "checked_robot:listen"
"""
    )
    status, _, errors = mdm("check", path)
    assert status == 1
    assert "module 'checked_robot' has no 'lisen'; did you mean 'listen'" in errors  # a function
    assert "'open-right'" in errors  # an action
    assert "HearRight" in errors  # an event
    assert "this was run" not in errors
    assert "this was run" in mdm("check", "--import", path)[2]


def test_options_that_mean_nothing_are_refused(mdm):
    for arguments in (
        (EXAMPLES / "tiger.toml", "--model", TIGER),
        (EXAMPLES / "tiger.toml", "--normalize"),
        (TIGER, "--import"),
        (POLICIES / "tiger.alpha", "--normalize"),
    ):
        status, output, errors = mdm("check", *arguments)
        assert (status, output) == (2, [])
        assert arguments[1] in errors.splitlines()[-1]


def test_check_tells_of_many_mistakes_of_one_kind_by_their_number(mdm, tmp_path):
    path = tmp_path / "m.mdp"
    lines = [f"R: go : nowhere{index} : * 1" for index in range(400)]
    text = "discount: .9\nvalues: reward\nstates: a b\nactions: go\nT: go\nidentity\n"
    path.write_text(text + "\n".join(lines) + "\nR: go : a : * much\n")
    status, _, errors = mdm("check", path)
    assert status == 1
    told = errors.splitlines()
    assert [":7:9: 'nowhere0'" in told[0], ":8:9: 'nowhere1'" in told[1], ":9:9: 'nowhere2'" in told[2]] == [True] * 3
    assert told[3] == "mdm check: and 397 more like the last, at lines 10, 11, 12, 13, 14, …"
    assert "a number was expected" in told[4]
    assert told[5].endswith("401 problems found")
    status, lines, _ = mdm("check", path, "--json")
    assert len(json.loads(lines[0])["problems"]) == 401


BLIND = """
[predicates]
Dirty = {}
Low = {}
[ensembles.robot]
policy = [0, 0]
safe_action = "0"
states.floor = ["Dirty"]
actions = { 0 = "builtins:print" }
"""


@pytest.mark.parametrize(
    ("changed", "noted"),
    [
        ({}, True),
        ({"Dirty = {}": "Dirty = { max_age = 2.0 }"}, False),
        ({"Low = {}": "Low = { max_age = 2.0 }"}, True),
        ({"Dirty = {}": "Seen = { max_age = 2.0 }\nDirty = 'Seen or Low'"}, False),
        ({'safe_action = "0"': ""}, False),
    ],
)
def test_check_notes_a_safe_action_that_no_silence_brings_about(mdm, tmp_path, changed, noted):
    text = BLIND
    for old, new in changed.items():
        text = text.replace(old, new)
    (tmp_path / "robot.toml").write_text(text)
    status, lines, errors = mdm("check", tmp_path / "robot.toml")
    assert (status, errors) == (0, "")
    assert (
        any("nothing tells that Dirty is no longer sensed: give sensors a max_age" in line for line in lines) == noted
    )


MODEL = "discount: 0.9\nvalues: reward\nstates: a b\nactions: x y\n{start}\nT: *\nuniform\n{rewards}\n"


@pytest.mark.parametrize(
    ("rewards", "lost"),
    [
        ("R: x : a : * : * 5\nR: * : * : * : * -1", "'x' in state 'a'"),
        ("R: x : a : b : * 5\nR: y : b : b : * 2\nR: y : b : * : * 3", "'y' in state 'b'"),
        ("R: * : * : * : * -1\nR: x : a : * : * 5", None),
        ("R: x : a : b : * 5\nR: x : b : * : * 3", None),
        ("R: x : a : * : * 5\nR: y : * : * : * 3", None),
        ("R: x : a : * : * 5\nR: x : a : b : * 3", None),
    ],
)
def test_check_notes_a_reward_that_a_later_statement_for_more_takes_the_place_of(mdm, tmp_path, rewards, lost):
    (tmp_path / "m.mdp").write_text(MODEL.format(start="start: a", rewards=rewards))
    status, lines, errors = mdm("check", tmp_path / "m.mdp")
    assert (status, errors) == (0, "")
    told = [line for line in lines if "is given, and then again" in line]
    assert len(told) == (lost is not None)
    assert all(f"the reward of action {lost}" in line for line in told)


@pytest.mark.parametrize(("start", "noted"), [("", True), ("start: uniform", False), ("start: a", False)])
def test_check_notes_that_no_start_is_given(mdm, tmp_path, start, noted):
    (tmp_path / "m.mdp").write_text(MODEL.format(start=start, rewards=""))
    status, lines, errors = mdm("check", tmp_path / "m.mdp")
    assert (status, errors) == (0, "")
    assert any("note: no start is given: every state is as likely" in line for line in lines) == noted


ROWS = """discount: .9
values: reward
states: a b
actions: look go
observations: x y
T: look : a : a .7
T: look : b : b 1
T: go
.5 .4
.1 1
O: *
.5 .5
.5 .4
R: go : * : * : * 1
R: go : a : * : * 2
R: * : b : * : * 1
"""


def problems(mdm, path):
    return [line.partition(f"{path}:")[2] for line in mdm("check", path)[2].splitlines()[:-1]]


def test_check_tells_the_line_of_each_row_that_does_not_sum_to_1(mdm, tmp_path):
    path = tmp_path / "rows.pomdp"
    path.write_text(ROWS)
    told = [
        "6:1: T of action 'look': the row of 'a' sums to 0.7, not to 1",
        "9:1: T of action 'go': the row of 'a' sums to 0.9, not to 1",
        "10:1: T of action 'go': the row of 'b' sums to 1.1, not to 1",
        "13:1: O of action 'look': the row of 'b' sums to 0.9, not to 1",
    ]
    assert problems(mdm, path) == told
    assert f"{path}:13:1: note: {told[-1][6:]}; normalised" in mdm("check", path, "--normalize")[1]
    head = "agents: 1\ndiscount: .9\nvalues: reward\nstates: a b\nactions:\nlook go\nobservations:\nx y\n"
    body = ROWS.partition("observations: x y\n")[2].replace("*\n", "* :\n").replace("T: go\n", "T: go :\n")
    path = tmp_path / "rows.dpomdp"
    path.write_text(head + re.sub(r" ([.\d]+)$", r" : \1", re.sub(r"R.*\n", "", body), count=2, flags=re.MULTILINE))
    lines = [each.partition(":")[0] for each in problems(mdm, path)]
    assert lines == ["9", "12", "13", "16"]


def test_check_tells_one_broken_row_of_a_factored_model_once_with_its_line(mdm, tmp_path):
    save_model(load_model(TIGER), tmp_path / "tiger.pomdpx")
    text = (tmp_path / "tiger.pomdpx").read_text()
    (tmp_path / "tiger.pomdpx").write_text(text.replace("0.85", "0.75", 1))
    (problem,) = mdm("check", tmp_path / "tiger.pomdpx")[2].splitlines()
    line = text[: text.index("0.85")].rpartition("<CondProb>")[0].count("\n") + 1
    assert f"tiger.pomdpx:{line}:1: the probabilities of 'agent_2' given agent=listen" in problem


def test_check_notes_names_with_commas_and_rewards_that_are_given_twice(mdm, tmp_path):
    path = tmp_path / "rows.pomdp"
    path.write_text(re.sub(r"(?s)T: look : a.*R: go : \* ", "T: * identity\nO: * uniform\nR: go : * ", ROWS))
    assert not [line for line in mdm("check", path)[1] if "twice" in line]  # for one action what another is for all
    for again, where in (
        ("R: go : a : * : * 2", "'go' in state 'a'"),
        ("R: go : * : * : * 3", "'go' in all states"),
        ("R: * : b : * : * 1", "'look' in state 'b'"),
    ):
        path.write_text(path.read_text() + again + "\n")
        note = f"the reward of action {where} is given twice by one entry: the last counts"
        assert f"{path}: note: {note}" in mdm("check", path)[1]
        path.write_text(path.read_text().removesuffix(again + "\n"))
    path.write_text(path.read_text().replace("actions: look go", "actions: look, go"))
    status, output, _ = mdm("check", path)
    assert status == 0
    assert (
        output[0] == f"{path}:4:10: note: 'look,' among the actions: blanks separate names, and a comma is part of one"
    )
    path.write_text(path.read_text() + "R: look : a : * : * 1\n")
    assert "'look' in this 'R' statement is no action; did you mean 'look,'?" in mdm("check", path)[2]
