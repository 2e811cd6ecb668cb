"""`mdm statistics`: what records tell of a model, and what of it is written."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from estimated import nothing, ran
from places import TIGER
from records import Writing, decision, tiger, written

import mdm as library
from mdm.formats import load_durations
from mdm.models import MDP

USED = [[0.9, 0.1], [0.3, 0.7]]
TRUE = [[0.5, 0.5], [0.3, 0.7]]


def mdp(matrix, **options):
    options = {"states": ["dry", "wet"], "actions": ["go"]} | options
    return MDP([matrix], [[1.0], [0.0]], discount=0.9, **options)


def saved(path, model):
    library.save_model(model, path)
    return path


@pytest.fixture
def model(tmp_path):
    return saved(tmp_path / "model.npz", mdp(USED))


@pytest.fixture
def slippery(tmp_path):
    """Record a robot whose model is right in one row, in a world in which the other is different."""
    path = tmp_path / "run.mcap"

    async def main():
        async with library.Runtime(record=path, log=False) as runtime:
            robot = library.Ensemble("robot", policy=[0, 0], model=mdp(USED), actions={"go": nothing}, drive=1.0)
            await runtime.start(library.World(robot, mdp(TRUE), seed=1))
            await runtime.start(robot)
            await runtime.clock.sleep(1_000)

    library.run(main, virtual=True)
    return path


def test_a_wrong_row_is_told_and_the_model_estimated_anew_is_nearer(mdm, tmp_path, model, slippery):
    new = tmp_path / "new.npz"
    status, output, errors = mdm("statistics", slippery, "--model", model, "-o", new)
    assert (status, errors) == (0, "")
    assert re.match(r"robot: 10\d\d decisions in 1 chain, steps, known states", output[0])
    assert [line.partition(":")[0] for line in output if line.startswith("T ")] == ["T go dry"]
    assert output[-1] == f"{new}: the re-estimated model"
    assert library.load_model(new).visits.sum() == int(output[0].split()[1]) - 1
    assert library.load_model(new).transition_matrix(0) == pytest.approx(np.array(TRUE), abs=0.05)
    solved, printed, _ = mdm("solve", new, "-o", tmp_path / "new.policy")
    assert (solved, printed[0].split()[:4]) == (0, ["value", "at", "the", "start"])


def test_it_is_one_json_object_with_all_rows(facts, model, slippery):
    told = facts("statistics", slippery, "--model", model)
    assert told["files"] == [str(slippery)]
    assert (told["torn"], told["lost"], told["new_model"], told["durations"]) == ([], 0, None, None)
    first, second = told["rows"]
    assert (first["state"], first["says"], second["state"], second["says"]) == ("dry", "differs", "wet", "agrees")
    low, high = first["entries"][0]["low"], first["entries"][0]["high"]
    assert low < 0.5 < high
    wide = facts("statistics", slippery, "--model", model, "--level", 0.999)["rows"][0]["entries"][0]
    assert (wide["low"] < low, wide["high"] > high) == (True, True)


def test_how_long_states_last_is_written_for_the_solver(mdm, facts, tmp_path, model):
    ran(tmp_path / "run.mcap", mdp(USED), seconds=60)
    times = tmp_path / "times.npz"
    told = ("statistics", tmp_path / "run.mcap", "--model", model, "--durations", times)
    status, output, errors = mdm(*told)
    assert status == 1
    assert "the model's discount is of a step, the durations count seconds" in errors
    assert not times.exists()
    status, output, errors = mdm(*told, "--discount-of", "second")
    assert (status, errors) == (0, "")
    assert output[-1].startswith(f"{times}: how long actions take")
    means = load_durations(times).means
    assert means[0, 0] == pytest.approx(0.1 * 3.0)  # which the model leaves once in ten steps
    assert means[1, 0] == pytest.approx(0.3 * 33 / 10, rel=0.2)  # the last of ten stays was cut short
    told = facts("solve", model, "--durations", times, "--discount-of", "second", "-o", tmp_path / "new.npz")
    assert told["gap"] < 0.01


def test_a_step_in_seconds_makes_rates_probabilities(mdm, tmp_path, model):
    """Out of each state once in three seconds: P(stays) = (1 + exp(-2 * 0.1 / 3)) / 2 after a tenth of a second."""
    ran(tmp_path / "run.mcap", mdp(USED), seconds=3_000)
    new = tmp_path / "new.npz"
    assert mdm("statistics", tmp_path / "run.mcap", "--model", model, "--step", 0.1, "-o", new)[0] == 0
    stays = (1 + np.exp(-2 * 0.1 / 3)) / 2
    assert library.load_model(new).transition_matrix(0)[0, 0] == pytest.approx(stays, abs=1e-3)


def test_hidden_states_are_estimated(mdm, facts, tmp_path):
    path = tiger(tmp_path / "run.mcap")
    told = facts("statistics", path, "--model", TIGER)
    assert told["hidden"]
    assert told["fit"]["after"] >= told["fit"]["before"]
    assert sum(count for each in told["frequencies"] for _, count, _ in each["observations"]) > 10
    again = facts("statistics", path, "--model", TIGER, "--seed", 0)
    assert again["rows"] == told["rows"]
    new = tmp_path / "new.pomdp"
    assert mdm("statistics", path, "--model", TIGER, "-o", new)[0] == 0
    assert library.load_model(new).observation_space.names == ("hear-left", "hear-right")


def test_several_runs_and_a_torn_one_are_counted_together(mdm, facts, tmp_path, model):
    paths = [tmp_path / name for name in ("a.mcap", "b.mcap")]
    for path in paths:
        ran(path, mdp(USED), seconds=600)
    whole = facts("statistics", *paths, "--model", model)["decisions"]
    paths[1].write_bytes(paths[1].read_bytes()[:-1_500])
    status, output, errors = mdm("statistics", *paths, "--model", model)
    assert (status, errors) == (0, "")
    assert [line for line in output if line.endswith(": what follows is not there")]
    assert 0 < int(output[0].split()[1]) <= whole


def test_lost_messages_are_told(mdm, tmp_path, model):
    record = Writing(tmp_path / "run.mcap", bound=3_000)
    for number in range(100):  # more than it takes before it is flushed
        record.write("decisions", decision(number, state=number % 2, action=0))
    status, output, _ = mdm("statistics", record.close(), "--model", model)
    assert status == 0
    assert re.search(r"run.mcap: \d+ messages are lost$", output[-2])
    assert output[-1].endswith("run.mcap: nothing is counted across a lost decision")


def refusal(mdm, *arguments, status=1):
    found, output, errors = mdm("statistics", *arguments)
    assert (found, output) == (status, [])
    assert "Traceback" not in errors
    return errors.splitlines()[-1]


def test_what_cannot_be_counted_is_refused_in_a_sentence(mdm, tmp_path, model):
    run, other = tmp_path / "run.mcap", tmp_path / "other.npz"
    ran(run, mdp(USED), seconds=12)
    saved(other, mdp(USED, states=["dry", "damp"]))
    assert refusal(mdm, run, "--model", other) == (
        f"mdm statistics: {other}: the model differs from that of 'robot' in {run}: state 1 is 'wet' in the record, "
        f"and 'damp' in the model"
    )
    assert refusal(mdm, model, "--model", model).endswith("the file is not an MCAP file, so it cannot be a record")
    assert refusal(mdm, tmp_path / "no.mcap", "--model", model).endswith("no.mcap: there is no such file")
    assert "no.npz" in refusal(mdm, run, "--model", tmp_path / "no.npz")
    empty = written(tmp_path / "empty.mcap", [])
    assert refusal(mdm, empty, "--model", model) == f"mdm statistics: there are no decisions in {empty}"
    alone = written(tmp_path / "alone.mcap", [("decisions", decision(0, action=0))])
    assert "there is nothing to count" in refusal(mdm, alone, "--model", model)
    assert refusal(mdm, run, "--model", model, "--ensemble", "top").endswith("has decided; there is robot")
    assert "would be overwritten" in refusal(mdm, run, "--model", model, "-o", model)
    over = tmp_path / "over.npz"
    over.write_bytes(run.read_bytes())
    assert "would be overwritten" in refusal(mdm, over, "--model", model, "--durations", over)
    assert "cannot be written" in refusal(mdm, run, "--model", model, "-o", tmp_path / "none" / "new.npz")
    assert "new.xyz" in refusal(mdm, run, "--model", model, "-o", tmp_path / "new.xyz")
    assert "on changes of the state" in refusal(mdm, run, written(tmp_path / "ticks.mcap", ticks()), "--model", model)


@pytest.mark.parametrize(
    ("targets", "sentence"),
    [
        (("--durations", "d.txt"), "--durations writes an archive: its file ends in .npz"),
        (
            ("-o", "x.npz", "--durations", "./x.npz"),
            "--durations and -o are the same file",
        ),
    ],
    ids=["suffix", "same"],
)
def test_durations_have_a_file_of_their_own(mdm, tmp_path, monkeypatch, targets, sentence):
    monkeypatch.chdir(tmp_path)
    status, output, errors = mdm("statistics", "run.mcap", "--model", "m.npz", *targets)
    assert (status, output) == (2, [])
    assert errors.endswith(f"mdm statistics: error: {sentence}\n")
    assert not list(tmp_path.iterdir())


def ticks():
    return [
        ("decisions", decision(number, state=number % 2, action=0, cause="tick", ensemble="robot"))
        for number in range(5)
    ]


def test_at_a_fixed_rate_there_are_no_durations(mdm, tmp_path, model, slippery):
    told = refusal(mdm, slippery, "--model", model, "--durations", tmp_path / "times.npz", "-o", tmp_path / "new.npz")
    assert told.endswith("'robot' decides at a fixed rate, so that each action takes the time between two ticks")
    assert not (tmp_path / "new.npz").exists()
    assert "a step in seconds is for rates" in refusal(mdm, slippery, "--model", model, "--step", 1)


@pytest.mark.parametrize("arguments", [["--level", "1"], ["--level", "x"], ["--step", "0"], ["--seed", "-1"], ["--x"]])
def test_wrong_usage_is_2(mdm, model, arguments):
    assert refusal(mdm, *arguments, "--model", model, "x.mcap", status=2).startswith("mdm statistics: error: ")


def test_json_is_strict(mdm, model, slippery):
    (line,) = mdm("statistics", slippery, "--model", model, "--json")[1]
    json.loads(line, parse_constant=pytest.fail)
