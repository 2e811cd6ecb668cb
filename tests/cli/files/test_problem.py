"""`mdm problem`: every problem can be listed, explained and written."""

from __future__ import annotations

import inspect

import pytest
from same_model import assert_same_model

from mdm import load_model, problems


@pytest.mark.parametrize("arguments", [[], ["--list"]])
def test_list(mdm, arguments):
    status, output, errors = mdm("problem", *arguments)
    assert (status, errors) == (0, "")
    names = [line.partition(":")[0] for line in output if not line.startswith(" ")]
    assert names == list(problems.__all__)
    assert "    --accuracy 0.85" in output
    assert "    --layout '...+/.#.-/s...'" in output
    assert "    --positions ..." in output


@pytest.mark.parametrize("name", problems.__all__)
def test_help_explains_every_parameter(mdm, name):
    status, output, errors = mdm("problem", name, "--help")
    text = " ".join(" ".join(output).split())
    assert (status, errors) == (0, "")
    function = getattr(problems, name)
    for parameter in inspect.signature(function).parameters.values():
        assert f"--{parameter.name.replace('_', '-')} " in text
        assert parameter.default is not inspect.Parameter.empty


def test_write(mdm, tmp_path):
    path = tmp_path / "tiger.pomdp"
    status, output, _ = mdm("problem", "tiger", "--accuracy", ".75", "-o", path)
    assert status == 0
    assert output == [f"{path}: a model (POMDP) of 2 states, 3 actions, 2 observations"]
    assert_same_model(load_model(path), problems.tiger(0.75))


def test_lists_are_json_and_names_may_be_hyphenated(mdm, tmp_path):
    path = tmp_path / "rocks.pomdpx"
    numbers = ("--size", 3, "--rocks", 2, "--positions", "[[2, 0], [0, 2]]", "--start", "[1, 1]")
    status, _, errors = mdm("problem", "rock-sample", *numbers, "--half-distance", 2, "-o", path)
    assert (status, errors) == (0, "")
    expected = problems.rock_sample(3, 2, positions=[(2, 0), (0, 2)], start=(1, 1), half_distance=2)
    assert_same_model(load_model(path), expected)


def test_texts_and_negative_numbers(mdm, tmp_path):
    path = tmp_path / "grid.mdp"
    status, output, _ = mdm("problem", "grid_world", "--layout", "..+/.#-", "--step-reward", "-1", "-o", path)
    assert status == 0
    assert output == [f"{path}: a model (MDP) of 6 states, 4 actions"]
    assert load_model(path).reward("north", 0) == -1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["tigre"], "there is no problem 'tigre'; did you mean tiger?"),
        (["xyzzy"], "`mdm problem` lists them"),
        (["--list", "tiger"], "--list goes without"),
        (["aloha", "10"], "parameters are given by name, such as --levels 10: there are --levels, --arrivals"),
        (["rock_sample", "--size", "-1", "-o", "x.npz"], "mdm problem rock_sample: error: a field of -1 x -1"),
        (["tiger"], "required: -o"),
        (["tiger", "--acuracy", "0.8", "-o", "x.pomdp"], "unrecognized arguments: --acuracy"),
        (["tiger", "--accuracy", "high", "-o", "x.pomdp"], "--accuracy: a number was expected, not 'high'"),
        (["tiger", "--accuracy", "1.5", "-o", "x.pomdp"], "the accuracy is a probability, not 1.5"),
        (["tiger", "--discount", "nan", "-o", "x.pomdp"], "a discount is more than 0 and at most 1, not nan"),
        (["aloha", "--levels", "2.5", "-o", "x.pomdp"], "--levels: a whole number was expected, not '2.5'"),
        (["rock_sample", "--start", "[1, 2, 3]", "-o", "x.pomdp"], "--start: a list in JSON"),
        (["rock_sample", "--start", "middle", "-o", "x.pomdp"], "--start: a list in JSON"),
    ],
)
def test_wrong_usage_is_told_in_a_sentence(mdm, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    status, output, errors = mdm("problem", *arguments)
    assert (status, output) == (2, [])
    assert words in errors
    assert "Traceback" not in errors
    assert not list(tmp_path.iterdir())


def test_an_unknown_format(mdm, tmp_path):
    status, _, errors = mdm("problem", "tiger", "-o", tmp_path / "tiger.txt")
    assert status == 1
    assert "no suffix of a model format" in errors
