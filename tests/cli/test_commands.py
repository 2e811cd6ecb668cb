"""The `mdm` command as a user sees it: output, exit status, wrong input, signals."""

from __future__ import annotations

import io
import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mdm.cli import main

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
TIGER = ["--model", str(EXAMPLES / "tiger.pomdp"), "--policy", str(EXAMPLES / "tiger.vf")]
VERBS = ("run", "check", "info", "trace", "simulate")


@pytest.fixture
def mdm(capsys, monkeypatch):
    """Run the command in this process; return exit status, output lines and error text."""

    def call(*arguments, stdin=""):
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin.encode())))
        monkeypatch.setattr(sys, "path", list(sys.path))
        status = main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return status, captured.out.splitlines(), captured.err

    return call


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help_with_an_example(mdm, verb):
    status, output, _ = mdm(verb, "--help")
    assert status == 0
    assert any(line.startswith("example: ") for line in output)


@pytest.mark.parametrize(
    "arguments", [[], ["fly"], ["run"], ["info", "--nope", "x"], ["run", "x.toml", "--epochs", "0"]]
)
def test_wrong_usage_is_2(mdm, arguments):
    status, output, errors = mdm(*arguments)
    assert status == 2
    assert not output
    assert "usage:" in errors


def test_version(mdm):
    assert mdm("--version")[1][0].startswith("mdm ")


@pytest.mark.parametrize("verb", ["run", "check", "info", "simulate", "trace"])
@pytest.mark.parametrize(
    ("name", "content"),
    [("missing.toml", None), ("empty.toml", b""), ("binary.toml", b"\0\1\2"), ("cut.toml", b"[ensembles.a\n")],
)
def test_broken_files_give_a_sentence_and_1(mdm, tmp_path, verb, name, content):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    status, output, errors = mdm(verb, path)
    assert status == 1
    assert not output
    assert errors.startswith(f"mdm {verb}: ")
    assert name in errors
    assert "Traceback" not in errors


@pytest.mark.parametrize("verb", ["check", "info"])
def test_broken_models_and_folders(mdm, tmp_path, verb):
    for name, content, words in (
        ("a.pomdp", b"", "empty"),
        ("b.pomdp", b"discount: 2\n", "states"),
        ("c.policy", b"[2](0", "before the brackets"),
        ("d", b"\0\0", "binary"),
        ("e", b"hello", "'hello'"),
    ):
        path = tmp_path / name
        path.write_bytes(content)
        status, _, errors = mdm(verb, path)
        assert (status, words in errors) == (1, True), errors
    assert mdm(verb, tmp_path)[0] == 1


def test_info(mdm):
    status, output, _ = mdm("info", EXAMPLES / "tiger.pomdp", "--json")
    facts = json.loads(output[0])
    assert status == 0
    assert {key: facts[key] for key in ("kind", "agents", "states", "actions", "observations", "discount")} == {
        "kind": "POMDP",
        "agents": 1,
        "states": 2,
        "actions": 3,
        "observations": 2,
        "discount": 0.95,
    }
    assert facts["actions_per_agent"] == [3]
    assert facts["observations_per_agent"] == [2]
    assert facts["state_factors"] == [{"name": "state", "size": 2}]
    assert facts["event_observations"] is False
    assert json.loads(mdm("info", EXAMPLES / "tiger.vf", "--json")[1][0])["form"] == "alpha vectors"
    assert mdm("info", EXAMPLES / "patrol" / "patrol.toml")[1][1].strip().startswith("Patrol: patrol (POMDP, 12 states")
    system = json.loads(mdm("info", EXAMPLES / "patrol" / "patrol.toml", "--json")[1][0])
    assert system["ensembles"][0]["actions"]["Patrol"]["model"]["states"] == 12
    assert any("discount" in line for line in mdm("info", EXAMPLES / "tiger.pomdp")[1])


@pytest.mark.parametrize("file", ["tiger.pomdp", "tiger.vf", "tiger.toml", "patrol/patrol.toml", "patrol/top.policy"])
def test_check_accepts_the_examples(mdm, file):
    status, output, errors = mdm("check", EXAMPLES / file)
    assert (status, errors) == (0, "")
    assert output[0].endswith("no problems found")


def test_check_tells_all_problems(mdm, tmp_path):
    text = (EXAMPLES / "tiger.toml").read_text()
    path = tmp_path / "tiger.toml"
    path.write_text(text.replace('"HearLeft"', '"HearLft"').replace("drive", "drve"))
    status, _, errors = mdm("check", path)
    assert status == 1
    assert len(errors.splitlines()) >= 1
    assert "drve" in errors


def traced(mdm, *arguments, stdin=""):
    status, output, errors = mdm("trace", *arguments, stdin=stdin)
    return status, [json.loads(line) for line in output], errors


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
        ('{"state": 0}', "decides on beliefs"),
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


@pytest.mark.parametrize("problem", ["dectiger", "GridSmall"])
def test_trace_gives_the_original_s_decisions(mdm, corpus, problem):
    """Recorded runs of the original; from its horizon on (25 for dectiger) it publishes two actions, ours does not."""
    trace = json.loads((corpus / "traces" / f"{problem}_std.json").read_text())
    horizon = trace["params"].get("decision_horizon", len(trace["steps"]) + 1)
    steps = trace["steps"][: horizon - 1]
    status, lines, _ = traced(
        mdm,
        "--model",
        corpus / "models" / "madp" / f"{problem}.dpomdp",
        "--policy",
        corpus / "values" / f"{problem}.dpomdp_0.9.vf",
        "--on-impossible",
        "keep",
        stdin="".join(json.dumps({"observation": step["o"]}) + "\n" for step in steps),
    )
    assert status == 0
    assert lines[0]["action"] == trace["startup"]["actions"][0][0]
    for line, step in zip(lines[1:], steps, strict=True):
        assert [line["action"], line["epoch"]] == step["actions"][0]
        assert line["reward"] == pytest.approx(step["expected_rewards_f32"][0], abs=1e-6)
        np.testing.assert_allclose(line["belief"], step["beliefs"][0], atol=1e-6)


def test_simulate(mdm):
    arguments = ("simulate", *TIGER, "--episodes", "300", "--seed", "2", "--json")
    status, output, _ = mdm(*arguments)
    result = json.loads(output[0])
    assert status == 0
    assert abs(result["mean"] - 19.3713) < 4 * result["standard_error"]  # the corpus' optimum
    assert mdm(*arguments)[1] == output
    assert mdm("simulate", EXAMPLES / "patrol" / "patrol.toml", "--ensemble", "patrol", "--episodes", "5")[0] == 0
    assert "no ensemble 'x'" in mdm("simulate", EXAMPLES / "tiger.toml", "--ensemble", "x")[2]
    assert mdm("simulate", *TIGER, "--steps", "0")[0] == 1
    assert mdm("simulate")[0] == 1


def test_run_in_virtual_time(mdm):
    status, _, errors = mdm("run", EXAMPLES / "tiger.toml", "--virtual", "--epochs", "5", "--log", "json", "--debug")
    assert status == 0
    records = [json.loads(line) for line in errors.splitlines()]
    assert sum(record["event"] == "decision" for record in records) == 5
    assert records[-1]["event"] == "stopped"


ROBOT = """
import asyncio, sys
async def drive():
    print("driving", flush=True)
    try:
        await asyncio.sleep(3600)
    finally:
        await asyncio.sleep(0.01)
        print("brakes", flush=True)
def safe():
    print("safe", flush=True)
"""


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signals_end_the_action_and_run_the_safe_one(tmp_path, number, status):
    (tmp_path / "signal_robot.py").write_text(ROBOT)
    (tmp_path / "robot.toml").write_text(
        "[predicates]\nA = { initial = true }\n[ensembles.robot]\npolicy = [0, 0]\nsafe_action = 'signal_robot:safe'\n"
        "[ensembles.robot.states]\na = ['A']\n[ensembles.robot.actions]\nDrive = 'signal_robot:drive'\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-m", "mdm", "run", str(tmp_path / "robot.toml"), "--log", "json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "driving\n"
    process.send_signal(number)
    output, errors = process.communicate(timeout=30)
    assert output == "brakes\nsafe\n"
    assert process.returncode == status
    records = [json.loads(line) for line in errors.splitlines()]
    assert records[-1]["event"] == "stopped"


def test_a_failing_system_exits_with_1_after_the_safe_action(tmp_path):
    (tmp_path / "failing_robot.py").write_text(
        "async def live(system):\n    raise ValueError('sensor unplugged')\ndef stay():\n    print('safe')\n"
    )
    (tmp_path / "robot.toml").write_text(
        "tasks = ['failing_robot:live']\n[predicates]\nA = { initial = true }\n[ensembles.robot]\npolicy = [0, 0]\n"
        "safe_action = 'Stay'\n[ensembles.robot.states]\na = ['A']\n"
        "[ensembles.robot.actions]\nStay = 'failing_robot:stay'\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "mdm", "run", str(tmp_path / "robot.toml")], capture_output=True, text=True, timeout=30
    )
    assert done.returncode == 1
    assert done.stdout == "safe\nsafe\n"
    assert "sensor unplugged" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr
