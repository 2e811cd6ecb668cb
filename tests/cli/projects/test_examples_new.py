"""``mdm new``: each kind of project runs, is checked, and passes its own test."""

from __future__ import annotations

import itertools
import runpy
import subprocess
import sys

import in_process
import pytest
from places import EXAMPLES

import mdm
from mdm.cli import main

KINDS = {"mdp": [], "pomdp": ["--pomdp"], "team": ["--team"], "map": ["--map"]}
PROJECTS = EXAMPLES / "projects"


@pytest.fixture(params=KINDS)
def project(request, tmp_path, capsys):
    """A new project, and what was said of it."""
    folder = tmp_path / "guard"
    assert main(["new", str(folder), *KINDS[request.param]]) == 0
    return request.param, folder, capsys.readouterr().out


def test_it_passes_its_own_test_and_nothing_is_found(project):
    kind, folder, _ = project
    if kind == "team":
        pytest.importorskip("zenoh", reason="pip install eclipse-zenoh")
    assert len(in_process.suite(folder)) == 1
    check = ["team", "check", "team.toml"] if kind == "team" else ["check", "robot.toml"]
    done = in_process.mdm(*check, folder=folder)
    assert done.output.endswith("no problems found\n")
    assert done.output.count("\n") == 1


@pytest.mark.slow
def test_it_passes_its_own_test_by_pytest(project):
    kind, folder, _ = project
    if kind == "team":
        pytest.importorskip("zenoh", reason="pip install eclipse-zenoh")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:asyncio", "-W", "error"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=100)
    assert "1 passed" in done.stdout, done.stdout


def test_it_runs(project):
    kind, folder, told = project
    assert told.splitlines()[0] == f"{folder}: a project; README.md says what its files are"
    if kind == "team":  # its test runs it
        return
    done = in_process.mdm("run", "robot.toml", "--virtual", "--seconds", "60", folder=folder)
    assert done.status == 0, done.errors
    assert "fault" not in done.output + done.errors
    lines = {"mdp": "has worked", "pomdp": "passes the door", "map": "is at 10.0, 3.0"}
    assert lines[kind] in done.output


def test_its_name_is_in_it_and_its_page_names_its_files(project):
    kind, folder, _ = project
    texts = {path.name: path.read_text(errors="replace") for path in folder.iterdir()}
    assert not any("@NAME@" in text for text in texts.values())
    assert texts["README.md"].startswith("# guard\n")
    assert ("[ensembles.guard]" in texts.get("robot.toml", "")) is (kind != "team")
    assert [name for name in texts if f"`{name}`" not in texts["README.md"]] == ["README.md"]


@pytest.mark.parametrize(
    ("kind", "model", "policy", "gap"),
    [
        ("mdp", "robot.mdp", "robot.npz", 1e-3),
        ("map", "robot.mdp", "robot.policy", 1e-3),
        ("pomdp", "robot.pomdp", "robot.npz", 0.01),
        ("team", "team.dpomdp", "team.vf", 1.0),
    ],
)
def test_its_policy_is_the_best_for_its_model(kind, model, policy, gap):
    made = mdm.load_model(PROJECTS / kind / model)
    kept = mdm.load_policy(PROJECTS / kind / policy, made)
    found = mdm.solve(made, gap=gap)
    if isinstance(kept, mdm.policies.AlphaVectors):
        assert found.lower - gap <= kept.value(made.initial_belief) <= found.upper + gap
    else:
        assert [kept.action(state) for state in range(len(made.state_space))] == [
            found.policy.action(state) for state in range(len(made.state_space))
        ]


@pytest.mark.parametrize(
    ("kind", "model", "seen", "of"),
    [
        ("pomdp", "robot.pomdp", [("see-open",), ("see-shut",)], "open"),
        ("team", "team.dpomdp", list(itertools.product(["hear-left", "hear-right"], repeat=2)), "tiger-left"),
    ],
)
def test_its_sensors_are_right_as_often_as_its_model_says(kind, model, seen, of):
    made = mdm.load_model(PROJECTS / kind / model)
    told = runpy.run_path(str(PROJECTS / kind / "robot.py"))["RIGHT"]
    state, true = made.state_space.index(of), seen[0][0]
    share = sum(
        made.observation(0, state, made.observation_space.index(" ".join(both)), state=state)
        for both in seen
        if both[0] == true
    )
    assert share == pytest.approx(told)


@pytest.mark.parametrize(
    ("arguments", "status", "told"),
    [
        (["full"], 1, "mdm new: full: this folder is not empty; name another one"),
        (["file"], 1, "mdm new: file: this is a file; name a folder"),
        (["nowhere/guard"], 1, "mdm new: nowhere/guard: there is no folder"),
        (["two words"], 2, "'two words' cannot be the name of an ensemble"),
        (["guard", "--map", "--team"], 2, "not allowed with argument"),
    ],
)
def test_wrong_input_leaves_nothing(tmp_path, monkeypatch, capsys, arguments, status, told):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    (tmp_path / "file").touch()
    assert main(["new", *arguments]) == status
    assert told in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "full", "mine"]
