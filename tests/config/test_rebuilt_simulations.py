"""Recorded simulations: the ensemble is built anew from what the record's head says."""

from __future__ import annotations

import json

import pytest
from places import EXAMPLES
from records import Writing
from sentences import refused

from mdm.cli import main
from mdm.config.rebuilt import recorded_simulation
from mdm.config.recorded import Simulated
from mdm.errors import Error
from mdm.recording import Record, Recorder
from mdm.simulation import simulate
from mdm.testing import replay

pytestmark = pytest.mark.usefixtures("recorded_here")

TIGER = {"model": str(EXAMPLES / "tiger.pomdp"), "policy": str(EXAMPLES / "tiger.vf")}


def simulated(*arguments):
    assert main(["simulate", *map(str, arguments)]) == 0


@pytest.mark.parametrize("given", [TIGER, {"file": str(EXAMPLES / "tiger.toml")}])
def test_a_test_replays_what_was_simulated(tmp_path, given):
    path = tmp_path / "run.mcap"
    which = ["--model", TIGER["model"], "--policy", TIGER["policy"]] if "model" in given else [given["file"]]
    options = ["--episodes", "2", "--steps", "7", "--seed", "3", "--record", path]
    simulated(*which, *options)
    assert replay(path) == 14
    assert main(["replay", str(path)]) == 0


def test_another_configuration_is_compared_with_a_simulation(tmp_path):
    path, other = tmp_path / "run.mcap", tmp_path / "other.toml"
    options = ["--episodes", "2", "--steps", "7", "--seed", "3", "--record", path]
    simulated(EXAMPLES / "tiger.toml", *options)
    policy = [[0.0, 0.0], [1.0, 1.0], [0.0, 0.0]]
    (tmp_path / "tiger.alpha").write_text("".join(f"{number}\n{a} {b}\n\n" for number, (a, b) in enumerate(policy)))
    text = (EXAMPLES / "tiger.toml").read_text().replace("tiger.vf", "tiger.alpha")
    other.write_text(text.replace("tiger.pomdp", str(EXAMPLES / "tiger.pomdp")))
    with pytest.raises(AssertionError, match="action 'listen', now 'open-left'"):
        replay(path, config=other)


ELSEWHERE = {"model": "/etc/hostname", "policy": "tiger.vf"}


@pytest.mark.parametrize(
    "told", ["no JSON", '{"steps": "many"}', "{}", json.dumps({"model": "tiger.pomdp"}), json.dumps(ELSEWHERE)]
)
def test_a_head_that_says_nothing_is_refused(tmp_path, told):
    writing = Writing(tmp_path / "run.mcap", {"format": "1", "mdm": "0.1.0", "simulation": told})
    (tmp_path / "laid").mkdir()
    with refused(Error):
        recorded_simulation(Record(writing.close()), tmp_path / "laid")


def test_what_is_simulated_is_what_the_model_and_the_policy_say(tmp_path):
    given = Simulated(**TIGER, steps=5, seed=1)
    result = simulate(**given.options(), episodes=2, seed=1, record=Recorder(tmp_path / "run.mcap"))
    assert (result.episodes, result.steps) == (2, 5)
    assert len(list(Record(tmp_path / "run.mcap").messages(["decisions"]))) == 10
