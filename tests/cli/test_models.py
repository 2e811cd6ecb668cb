"""The verbs for models and policies: check, info, show and convert, on every kind of file, right and wrong."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
from places import ROOT

from mdm import load_model, load_policy, save_model, save_policy
from mdm.policies import AlphaVectors

MODELS = ROOT / "tests" / "data" / "models"
POLICIES = ROOT / "tests" / "data" / "policies"
TIGER = ROOT / "examples" / "tiger.pomdp"


@pytest.mark.parametrize("verb", ["check", "info", "show", "convert"])
@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("missing.pomdpx", None, "there is no such file"),
        ("empty.pgmx", b"", "the file is empty"),
        ("binary.dpomdp", b"\0\1\2\3", "binary"),
        ("binary.npz", b"PK\3\4\0\0", "damaged"),
        ("plain.npz", b"discount: 0.9", "damaged"),
        ("folder", "folder", "folder"),
        ("page.pgmx", b"<html><body/></html>", "ProbModelXML"),
        ("cut.pomdpx", b"<pomdpx><Discount>0.9</Disc", "not well-formed|no well-formed"),
        ("words", b"to be or not to be", "to"),
    ],
)
def test_wrong_files_give_a_sentence_and_1(mdm, tmp_path, verb, name, content, words):
    path = tmp_path / name
    if content == "folder":
        path.mkdir()
    elif content is not None:
        path.write_bytes(content)
    status, output, errors = mdm(verb, path, *([tmp_path / "out.npz"] if verb == "convert" else []))
    assert status == 1
    assert not output
    assert name in errors
    assert any(word in errors for word in words.split("|"))
    assert "Traceback" not in errors
    assert not (tmp_path / "out.npz").exists()


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
        "broken.pomdp:9:15: -0.5 is no probability",
        "broken.pomdp:18:9: 'nowhere'",
        "no 'T' statement is given for action 'wait'",
        "the start sums to 0.9",
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


SOUND = """discount: 0.9
values: reward
states: a b sink lost
actions: go stay
observations: x y never
start: a
T: go : a : b 0.9
T: go : a : sink 0.05
T: go : b : a 1
T: go : sink : sink 1
T: go : lost : a 1
T: stay
identity
O: * : * : x 0.5
O: * : * : y 0.5
"""


def test_check_normalizes_on_demand_and_notes_what_is_odd(mdm, tmp_path):
    path = tmp_path / "odd.pomdp"
    path.write_text(SOUND)
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


def test_info_tells_the_false_negative(mdm, tmp_path):
    save_model(load_model(TIGER).with_false_negatives("hear-right"), tmp_path / "tiger.npz")
    told = [json.loads(mdm("info", file, "--json")[1][0])["false_negative"] for file in (TIGER, tmp_path / "tiger.npz")]
    assert told == [None, "hear-right"]
    status, _, errors = mdm("convert", tmp_path / "tiger.npz", tmp_path / "tiger.pomdp")
    assert (status, len(errors.splitlines())) == (1, 1)
    assert ".pomdp files cannot say which observation is a false negative" in errors


@pytest.mark.parametrize("suffix", ["pomdp", "pomdp.gz", "dpomdp", "pgmx", "pomdpx", "npz"])
def test_convert_and_info_on_every_format(mdm, tmp_path, suffix):
    target = tmp_path / f"tiger.{suffix}"
    status, output, errors = mdm("convert", TIGER, target)
    assert (status, errors) == (0, "")
    assert output == [f"{target}: a model (POMDP)"]
    status, output, errors = mdm("info", target, "--json")
    facts = json.loads(output[0])
    assert (facts["kind"], facts["states"], facts["actions"], facts["observations"]) == ("POMDP", 2, 3, 2)
    assert facts["event_observations"] is False
    np.testing.assert_array_equal(load_model(target).rewards, load_model(TIGER).rewards)
    assert mdm("check", target)[0] == 0


def test_convert_tells_what_is_lost(mdm, tmp_path):
    status, _, errors = mdm("convert", MODELS / "lamp.pomdpx", tmp_path / "lamp.pomdp")
    assert status == 0
    assert "2 state factors became 1" in errors
    assert "the network of the factored model became matrices" in errors
    status, _, errors = mdm("convert", MODELS / "guard.pgmx", tmp_path / "guard.pomdp")
    assert status == 1
    assert "events" in errors
    assert not (tmp_path / "guard.pomdp").exists()
    status, _, errors = mdm("convert", MODELS / "guard.pgmx", tmp_path / "guard.npz", "--discount", "0.5")
    assert (status, errors) == (0, "")
    assert load_model(tmp_path / "guard.npz").discount == 0.5


def test_convert_normalizes_on_demand(mdm, tmp_path):
    (tmp_path / "odd.pomdp").write_text(SOUND)
    status, _, errors = mdm("convert", tmp_path / "odd.pomdp", tmp_path / "even.npz")
    assert status == 1
    assert "sums to 0.95" in errors
    status, _, errors = mdm("convert", "--normalize", tmp_path / "odd.pomdp", tmp_path / "even.npz")
    assert status == 0
    assert "1 distributions did not sum to 1 and were normalised" in errors
    assert load_model(tmp_path / "even.npz").transition("go", "a", "b") == pytest.approx(0.9 / 0.95)


def test_convert_of_policies(mdm, tmp_path):
    target = tmp_path / "tiger.npz"
    status, output, errors = mdm("convert", POLICIES / "tiger.vf", target, "--model", TIGER)
    assert (status, errors) == (0, "")
    assert output == [f"{target}: a policy (alpha vectors)"]
    np.testing.assert_array_equal(load_policy(target).vectors, load_policy(POLICIES / "tiger.vf").vectors)
    assert mdm("convert", POLICIES / "tiger.vf", "/dev/null")[0] == 0
    assert mdm("convert", POLICIES / "tiger.vf", target, "--discount", "1")[0] == 2
    assert mdm("convert", TIGER, target, "--model", TIGER)[0] == 2
    status, _, errors = mdm("convert", POLICIES / "tiger.vf", tmp_path / "tiger.pg")
    assert status == 1
    assert ".npz" in errors
    for name in ("tiger.txt", "tiger.vf"):
        status, _, errors = mdm("convert", TIGER, tmp_path / name)
        assert status == 1
        assert ".pomdpx" in errors
    status, _, errors = mdm("convert", POLICIES / "tiger.vf", tmp_path / "out.pomdp")
    assert status == 1
    assert "'out.pomdp': its files end in .npz, .policy, .policyx, .alpha, .vf" in errors
    assert [file.name for file in tmp_path.iterdir()] == ["tiger.npz"]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["T", "listen", "tiger-left"], ["T: from 'tiger-left' by 'listen' to", "  1  tiger-left"]),
        (
            ["O", "0", "1"],
            ["O: after 'listen' has led to 'tiger-right'", "  0.15  hear-left", "  0.85  hear-right"],
        ),
        (["R", "open-left"], ["R: for 'open-left' in", "  -100  tiger-left", "    10  tiger-right"]),
        (["R", "listen", "tiger-left"], ["R: for 'listen' in 'tiger-left'", "  -1"]),
        (["start"], ["the first state", "  0.5  tiger-left", "  0.5  tiger-right"]),
    ],
)
def test_show_rows_by_names(mdm, arguments, expected):
    status, output, errors = mdm("show", TIGER, *arguments)
    assert (status, errors) == (0, "")
    assert output == expected


def test_show_of_events_and_networks(mdm, tmp_path):
    guard = MODELS / "guard.pgmx"
    status, output, _ = mdm("show", guard, "T", "wait left", "wide open")
    assert (status, output) == (0, ["T: from 'wide open' by 'wait left' to", "  1  wide open"])
    status, output, _ = mdm("show", guard, "O", "wait left", "wide open", "--from", "shut", "--json")
    entries = json.loads(output[0])["entries"]
    assert entries == [{"symbol": "nothing", "value": 0.5}, {"symbol": "bang", "value": 0.5}]
    status, _, errors = mdm("show", guard, "O", "wait left", "shut")
    assert status == 2
    assert "--from" in errors
    status, output, _ = mdm("show", guard)
    assert "door' (2 values) <- guard, door" in output
    assert "reward 1 <- door', camera" in output
    status, output, _ = mdm("show", TIGER)
    assert output[0].startswith("(the model is not factored")


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["T", "listen"], 2, "T needs 2 symbols, not 1"),
        (["R"], 2, "R needs 1 to 4 symbols"),
        (["T", "listen", "tiger-lef"], 1, "'tiger-left'"),
        (["T", "7", "0"], 1, "its 3 symbols count from 0"),
        (["T", "0", "0", "--picture", "x.png"], 2, "--picture draws the network"),
        (["T", "0", "0", "--from", "0"], 2, "--from is for O"),
        (["Z"], 2, "invalid choice"),
    ],
)
def test_show_with_wrong_symbols(mdm, arguments, status, words):
    found, output, errors = mdm("show", TIGER, *arguments)
    assert (found, output) == (status, [])
    assert words in errors


def test_show_draws_a_picture(mdm, tmp_path):
    pytest.importorskip("matplotlib")
    path = tmp_path / "guard.png"
    status, output, errors = mdm("show", MODELS / "guard.pgmx", "--picture", path)
    assert (status, errors) == (0, "")
    assert output[-1] == f"{path}: drawn"
    assert path.read_bytes().startswith(b"\x89PNG")
    status, _, errors = mdm("show", MODELS / "guard.pgmx", "--picture", tmp_path / "missing" / "guard.png")
    assert status == 1
    assert "cannot be written" in errors


def test_show_without_matplotlib_says_what_to_install(mdm, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    status, _, errors = mdm("show", MODELS / "guard.pgmx", "--picture", tmp_path / "guard.png")
    assert status == 1
    assert "pip install 'markov-decision-making[plot]'" in errors


def test_policies_are_told_of_by_info_and_not_shown(mdm):
    for path in sorted(POLICIES.iterdir()):
        status, output, _ = mdm("info", path, "--json")
        if status == 0:
            assert json.loads(output[0])["kind"] == "policy"
    status, _, errors = mdm("show", POLICIES / "tiger.vf")
    assert status == 1
    assert "holds a policy" in errors


@pytest.mark.parametrize(("name", "text"), [("vectors.txt", "0 -1\n1 2\n\n1 -1\n2 1\n"), ("plan", "[3](0,1,0)\n")])
def test_policies_are_known_by_what_they_hold(mdm, tmp_path, name, text):
    (tmp_path / name).write_text(text)
    for verb in ("check", "info"):
        status, output, errors = mdm(verb, tmp_path / name)
        assert (status, errors) == (0, "")
        assert any("policy" in line for line in output)
    assert mdm("convert", tmp_path / name, tmp_path / "out.npz")[0] == 0


def test_archives_of_models_and_policies_are_told_apart(mdm, tmp_path):
    save_model(load_model(TIGER), tmp_path / "model.npz")
    save_policy(load_policy(POLICIES / "tiger.vf"), tmp_path / "policy.npz")
    assert json.loads(mdm("info", tmp_path / "model.npz", "--json")[1][0])["kind"] == "POMDP"
    assert json.loads(mdm("info", tmp_path / "policy.npz", "--json")[1][0])["kind"] == "policy"
