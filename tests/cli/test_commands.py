"""The `mdm` command as a user sees it: output, exit status, wrong input."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from places import DATA, EXAMPLES

TIGER = ["--model", str(EXAMPLES / "tiger.pomdp"), "--policy", str(EXAMPLES / "tiger.vf")]
VERBS = ("run", "check", "info", "show", "convert", "trace", "simulate", "solve", "evaluate", "compare", "plot")


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


def test_check_notes_what_an_ensemble_waits_for(mdm, tmp_path):
    (tmp_path / "robot.toml").write_text(
        "[ensembles.robot]\npolicy = [0, 1]\n[ensembles.robot.actions]\nX = 'builtins:print'\nY = 'builtins:print'\n"
    )
    status, lines, _ = mdm("check", tmp_path / "robot.toml")
    assert status == 0
    assert "note: ensemble 'robot' has no states: it waits for code that publishes what it decides on" in lines[0]
    assert mdm("check", EXAMPLES / "patrol" / "patrol.toml")[1][0].endswith("no problems found")


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


@pytest.mark.parametrize("way", ["itself", "a path", "a link", "a hard link"])
@pytest.mark.parametrize(
    ("arguments", "read"),
    [
        (["solve", "tiger.pomdp", "-o", "OUT"], "tiger.pomdp"),
        (["solve", "tiger.pomdp", "--history", "OUT"], "tiger.pomdp"),
        (["convert", "tiger.pomdp", "OUT"], "tiger.pomdp"),
        (["convert", "tiger.vf", "OUT"], "tiger.vf"),
        (["convert", "tiger.vf", "OUT", "--model", "tiger.pomdp"], "tiger.pomdp"),
        (["plot", "policy", "tiger.pomdp", "tiger.vf", "-o", "OUT"], "tiger.pomdp"),
        (["plot", "belief", "tiger.pomdp", "tiger.vf", "-o", "OUT"], "tiger.vf"),
        (["plot", "bounds", "tiger.vf", "tiger.pomdp", "-o", "OUT"], "tiger.pomdp"),
        (["show", "tiger.pomdp", "network", "--picture", "OUT"], "tiger.pomdp"),
    ],
)
def test_output_never_destroys_input(mdm, tmp_path, monkeypatch, arguments, read, way):
    monkeypatch.chdir(tmp_path)
    for name in ("tiger.pomdp", "tiger.vf"):
        shutil.copy(EXAMPLES / name, tmp_path)
    suffixes = {"solve": ".npz", "convert": ".npz", "plot": ".png", "show": ".png"}
    suffix = ".json" if "--history" in arguments else suffixes[arguments[0]]
    out = {"itself": read, "a path": f"../{tmp_path.name}/{read}"}.get(way, f"out{suffix}")
    if way == "a link":
        Path(out).symlink_to(read)
    elif way == "a hard link":
        Path(out).hardlink_to(read)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    status, output, errors = mdm(*[out if word == "OUT" else word for word in arguments])
    assert (status, output) == (1, [])
    assert errors == f"mdm {arguments[0]}: {out}: this file is read from, and would be lost: write to another\n"
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert Path(out).is_symlink() == (way == "a link")


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


def test_info_prints_the_wiring(mdm):
    status, lines, _ = mdm("info", EXAMPLES / "patrol" / "patrol.toml")
    told = [line.strip() for line in lines]
    assert status == 0
    assert told[told.index("state fire") + 1 :][:2] == ["no  <- not FireIsConfirmed", "yes <- FireIsConfirmed"]
    camera = ["Clear    <- SeesClear", "Smoke    <- SeesSmoke", "Reported <- Report.succeeded"]
    assert told[told.index("observation camera") + 1 :][:3] == camera
    assert "Patrol      -> ensemble patrol" in told
    assert "GoLab    -> building:go_lab" in told
    assert "FireIsConfirmed     <- set by Report.succeeded, reset by Emergency.succeeded" in told
    facts = json.loads(mdm("info", EXAMPLES / "patrol" / "patrol.toml", "--json")[1][0])
    wiring = facts["ensembles"][0]["wiring"]
    assert wiring["states"]["person"]["no"] == {"from": "not PersonIsWaiting", "idle": False}
    assert wiring["actions"]["Assistance"] == "building:assist"
    assert facts["definitions"]["SeesSmoke"] == "raised by code"


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


def test_simulate(mdm):
    arguments = ("simulate", *TIGER, "--episodes", "300", "--seed", "2", "--json")
    status, output, _ = mdm(*arguments)
    result = json.loads(output[0])
    assert status == 0
    assert abs(result["mean"] - 19.3713) < 4 * result["standard_error"]  # the corpus' optimum
    assert mdm(*arguments)[1] == output
    assert mdm("simulate", EXAMPLES / "patrol" / "patrol.toml", "--ensemble", "patrol", "--episodes", "5")[0] == 0
    assert "no ensemble 'x'" in mdm("simulate", EXAMPLES / "tiger.toml", "--ensemble", "x")[2]
    assert mdm("simulate", *TIGER, "--steps", "0")[0] == 2
    assert mdm("simulate")[0] == 1


@pytest.mark.parametrize("unbuffered", [{}, {"PYTHONUNBUFFERED": "1"}])
@pytest.mark.parametrize(
    ("arguments", "status"),
    [(["--help"], 0), (["info", str(EXAMPLES / "tiger.pomdp")], 1), (["trace", *TIGER], 1)],
)
def test_a_reader_that_has_gone_is_no_reason_to_complain(arguments, status, unbuffered):
    """The pipe's other end is closed before anything is written, and there is more to write than one buffer holds."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"} | unbuffered
    ours, theirs = os.pipe()
    os.close(ours)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "mdm", *arguments],
            stdout=theirs,
            stderr=subprocess.PIPE,
            input='{"observation": 0}\n' * 500,
            text=True,
            env=environment,
            timeout=30,
        )
    finally:
        os.close(theirs)
    assert (done.returncode, done.stderr) == (status, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device that is always full is Linux's")
@pytest.mark.parametrize("arguments", [["check", str(EXAMPLES / "tiger.toml")], ["trace", *TIGER]])
def test_output_that_cannot_be_written_is_told(arguments):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "mdm", *arguments],
            stdout=full,
            stderr=subprocess.PIPE,
            input="",
            text=True,
            timeout=30,
        )
    assert (done.returncode, done.stderr) == (1, f"mdm {arguments[0]}: No space left on device\n")


def test_simulate_of_events_with_false_negatives(mdm):
    """Ends are told; a false negative leads to no decision, and to no end of the loop."""
    data = DATA
    arguments = ["--model", data / "models" / "guard.pgmx", "--policy", data / "policies" / "guard.vf"]
    status, output, _ = mdm("simulate", *arguments, "--episodes", "3", "--discount", "0.5", "--seed", "1", "--json")
    assert status == 0
    assert json.loads(output[0])["steps"] == 14
    missing = ["--false-negative", "nothing", "--discount", "0.5", "--seed", "1", "--json"]
    status, output, _ = mdm("simulate", *arguments, "--episodes", "3", *missing)
    assert status == 0
    assert json.loads(output[0])["mean"] < 0
    status, _, errors = mdm("simulate", EXAMPLES / "tiger.toml", "--discount", "0.5")
    assert status == 1
    assert "a TOML file says these itself" in errors
