"""`mdm solve`: certificates, limits, interruption, files that cannot hold what is made."""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from places import MODELS, TIGER

from mdm import evaluate, load_model, load_policy, problems, save_model, solve
from mdm.formats import save_durations
from mdm.models import MDP, Durations
from mdm.policies import AlphaVectors
from mdm.solvers import SOLVERS, Limits, exact_values
from mdm.solvers.solution import makes

LAMP = MODELS / "lamp.pomdpx"
CHAIN = MODELS / "chain.mdp"


@pytest.fixture
def slow(monkeypatch):
    """Add a solver that has no end and is interrupted in its third round; return the seeds that it was called with."""
    module, calls = ModuleType("mdm.solvers.slow"), []

    def solver(model, *, limits=None, seed=None):
        calls.append(seed)
        lower, rounds = -1.0, 0
        with Limits() if limits is None else limits as guard:
            while not guard.ends(lower, 20.0, iterations=rounds, size=1):
                rounds, lower = rounds + 1, lower + 0.25
                if rounds == 3:
                    signal.raise_signal(signal.SIGINT)
            return guard.solution(
                AlphaVectors([[lower, lower]], [0], 3), "slow", lower, 20.0, iterations=rounds, size=1
            )

    module.solver = makes(AlphaVectors)(solver)
    monkeypatch.setitem(sys.modules, "mdm.solvers.slow", module)
    monkeypatch.setitem(SOLVERS, "slow", ("slow", "solver", "POMDP"))
    return calls


@pytest.mark.parametrize("seconds", [0.5, 30.0])
def test_the_size_of_the_file_is_told_and_the_time_it_took_if_that_was_long(mdm, tmp_path, monkeypatch, seconds):
    policy, times = tmp_path / "chain.npz", iter([7.0, 7.0 + seconds])
    monkeypatch.setattr("mdm.cli.policies.solve.perf_counter", lambda: next(times))
    status, output, _ = mdm("solve", CHAIN, "-o", policy)
    assert status == 0
    place, size, *took = output[-1].removeprefix("kept in").strip().split(", ")
    assert place == str(policy)
    number, unit = size.split()
    assert float(number) * {"kB": 1e3, "MB": 1e6}[unit] == pytest.approx(policy.stat().st_size, rel=5e-3)
    assert took == ([] if seconds < 1 else ["which took 30 s"])


def test_a_certificate_is_printed_and_the_policy_kept(mdm, tmp_path, monkeypatch):
    # On a busy machine it takes more than the second after which progress is told, which is not the matter here.
    monkeypatch.setattr("mdm.cli.progress.ProgressLine.tell", lambda *_: None)
    policy, history = tmp_path / "tiger.npz", tmp_path / "tiger.json"
    status, output, errors = mdm("solve", TIGER, "-o", policy, "--history", history, "--gap", "0.01", "--json")
    facts = json.loads(output[0])
    assert (status, errors) == (0, "")
    assert facts["lower"] <= 19.37137 <= facts["upper"] <= facts["lower"] + 0.01
    assert (facts["solver"], facts["reason"], facts["policy"]) == ("sarsop", "gap", str(policy))
    model = load_model(TIGER)
    assert load_policy(policy, model).value(model.initial_belief) >= facts["lower"] - 1e-9
    entries = json.loads(history.read_text())["history"]
    assert [entry["seconds"] for entry in entries] == sorted(entry["seconds"] for entry in entries)
    assert entries[-1]["lower"] == facts["lower"]
    status, output, errors = mdm("solve", TIGER, "--gap", "0.5")
    assert errors == "mdm solve: without -o the policy is not kept, and its bounds alone are printed\n"
    text = "\n".join(output)
    assert status == 0
    assert "the gap is at most 0.5" in text
    assert "nowhere: give -o, such as -o tiger.npz" in text


def test_ctrl_c_keeps_the_best_so_far(mdm, tmp_path, slow):
    policy = tmp_path / "tiger.vf"
    status, output, _ = mdm("solve", TIGER, "--solver", "slow", "-o", policy)
    assert status == 130
    assert any("interrupted" in line for line in output)
    assert load_policy(policy).value([0.5, 0.5]) == -0.25
    status, output, _ = mdm("solve", TIGER, "--solver", "slow", "--iterations", "2", "--seed", "7", "--json")
    assert (json.loads(output[0])["reason"], slow) == ("iterations", [None, 7])
    assert mdm("solve", TIGER, "--solver", "slow", "--time", "0", "--json")[1][0].count('"time"') == 1
    assert json.loads(mdm("solve", TIGER, "--solver", "slow", "--memory", "1", "--json")[1][0])["reason"] == "memory"


@pytest.mark.parametrize("name", ["tiger.pg", "tiger.alpha.gz", "nowhere/tiger.npz", "tiger.png", "tiger.mdp"])
def test_a_file_that_cannot_be_is_refused_before_the_work(mdm, tmp_path, slow, name):
    status, output, errors = mdm("solve", TIGER, "--solver", "slow", "-o", tmp_path / name)
    assert (status, output, slow) == (1, [], [])
    assert "cannot be written" in errors


def test_places_that_cannot_be_written_to_are_refused_before_the_work(mdm, tmp_path, slow):
    arguments = ("solve", TIGER, "--solver", "slow")
    for option, place in (("--history", tmp_path), ("--history", tmp_path / "no" / "a.json"), ("-o", "/proc/a.npz")):
        status, output, errors = mdm(*arguments, option, place)
        assert (status, output, slow) == (1, [], [])
        assert str(place) in errors
        assert len(errors.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_device_keeps_its_place(mdm):
    assert mdm("solve", TIGER, "--gap", "1", "-o", "/dev/null")[0] == 0
    assert Path("/dev/null").is_char_device()


def test_no_limit_is_a_limit_without_end(mdm):
    assert mdm("solve", TIGER, "--memory", "inf", "--time", "inf")[0] == 0


def test_false_negatives_choose_a_solver_that_plans_for_them(mdm, tmp_path):
    given = (TIGER, "--false-negative", "hear-left", "--iterations", "1")
    status, output, _ = mdm("solve", *given, "--json")
    assert (status, json.loads(output[0])["solver"]) == (0, "sarsop")
    status, output, _ = mdm("solve", *given, "--horizon", "2", "--json")
    assert (status, json.loads(output[0])["solver"]) == (0, "perseus")
    status, _, errors = mdm("solve", *given, "--solver", "qmdp")
    assert (status, len(errors.splitlines())) == (1, 1)
    assert "QMDP does not support false negatives" in errors
    status, _, errors = mdm("solve", CHAIN, "--false-negative", "0")
    assert (status, errors) == (1, "mdm solve: an MDP has no observations, and so no false negatives\n")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--solver", "magic"], "there are value-iteration"),
        (["--solver", "sarsop", "--horizon", "3"], "has no option --horizon"),
        (["--iterations", "0"], "1 or more"),
        (["--gap", "-1"], "--gap: a number of 0 or more"),
        (["--discount", "2"], "--discount: a number above 0 and at most 1"),
        (["--memory", "nan"], "--memory: a number of 0 or more"),
        (["--solver", "perseus", "--seed", "-1"], "--seed: a whole number of 0 or more"),
        (["--solver", "jesp"], "--horizon"),
        (["--history", "x.npz"], "its file ends in .json"),
    ],
)
def test_wrong_usage(mdm, arguments, words):
    status, _, errors = mdm("solve", TIGER, *arguments)
    assert status == 2
    assert words in errors


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--solver", "value-iteration"], "solves MDPs"),
        (["--discount", "1"], "or plan for a horizon (--solver perseus --horizon)"),
    ],
)
def test_what_cannot_be_solved_is_told_in_a_sentence(mdm, arguments, words):
    status, output, errors = mdm("solve", TIGER, *arguments)
    assert (status, output) == (1, [])
    assert errors.startswith("mdm solve: ")
    assert words in errors
    assert len(errors.splitlines()) == 1


def test_a_policy_in_place_of_a_model_is_told(mdm, tmp_path):
    path = tmp_path / "tiger.pomdp"
    path.write_bytes(TIGER.with_suffix(".vf").read_bytes())
    for name in (TIGER.with_suffix(".vf"), path):
        assert mdm("solve", name) == (1, [], f"mdm solve: {name}: the file holds a policy; a model was expected\n")
    assert mdm("convert", path, tmp_path / "tiger.npz")[1] == [f"{tmp_path / 'tiger.npz'}: a policy (alpha vectors)"]


@pytest.mark.parametrize("arguments", [[], [TIGER]])
def test_help_lists_the_solvers(mdm, arguments):
    status, output, errors = mdm("solve", *arguments, "--solver", "help")
    assert (status, errors) == (0, "")
    assert [line.split()[0] for line in output[: len(SOLVERS)]] == [*SOLVERS]


def test_an_mdp_with_and_without_a_horizon(mdm, tmp_path):
    path, table, staged = CHAIN, tmp_path / "chain.policy", tmp_path / "staged.npz"
    model = load_model(path)
    assert isinstance(model, MDP)
    facts = json.loads(mdm("solve", path, "-o", table, "--json")[1][0])
    worth = model.initial_belief @ exact_values(model, load_policy(table, model))
    assert facts["lower"] - 1e-6 <= worth <= facts["upper"] + 1e-6
    assert worth == pytest.approx((10 + 14 + 0.9 * 14) / 3)
    arguments = ("solve", path, "--solver", "value-iteration", "--horizon", "2")
    facts = json.loads(mdm(*arguments, "-o", staged, "--json")[1][0])
    policy = load_policy(staged, model)
    assert facts["lower"] == pytest.approx((1.9 + 5.9 + 0.9 * 5) / 3)
    assert evaluate(model, policy, seed=1, episodes=5).steps == 2
    assert mdm("info", staged)[0] == 0
    status, _, errors = mdm(*arguments, "-o", table)
    assert status == 1
    assert "its files end in .npz" in errors


def test_fully_observed_factors_are_shown_to_the_policy(mdm, tmp_path):
    policy = tmp_path / "lamp.npz"
    status, _, errors = mdm("solve", LAMP, "-o", policy, "--gap", "0.01")
    assert status == 0
    assert "the agent sees" in errors
    status, output, errors = mdm("evaluate", LAMP, policy, "--seed", "1", "--json")
    assert status == 0
    assert "the agent sees" in errors
    assert json.loads(output[0])["claim_is"] == "not contradicted"


def test_durations_count_in_real_time(mdm, tmp_path):
    """A process is solved as `mdm.solve` solves it, and its policy is for the model's own states."""
    hidden = "mdm solve: how long actions take differs among states that the agent cannot tell apart: "
    drive, policy = tmp_path / "drive.npz", tmp_path / "policy.npz"
    for name, model, suffix in [("forest", problems.forest(), "mdp"), ("tiger", load_model(TIGER), "pomdp")]:
        path = tmp_path / f"{name}.{suffix}"
        save_model(model, path)
        means = np.linspace(9.0, 12.0, len(model.state_space) * len(model.action_space))
        durations = Durations(means.reshape(-1, len(model.action_space)), 3)
        save_durations(durations, drive)
        timed = ("--durations", drive, "--discount-of", "second", "-o", policy)
        status, output, errors = mdm("solve", path, *timed, "--gap", "0.01", "--json")
        assert (status, errors.startswith(hidden), bool(errors)) == (0, suffix == "pomdp", suffix == "pomdp")
        told = json.loads(output[0])
        right = solve(model.with_discount(model.discount, of="second"), durations=durations, gap=0.01)
        assert (told["lower"], told["upper"]) == pytest.approx((right.lower, right.upper), abs=1e-6)
        assert load_policy(policy, model).mismatch(model) is None


def test_nothing_is_said_of_durations_that_differ_by_action_alone(mdm, tmp_path):
    save_durations(Durations([1.0, 2.0, 3.0]), tmp_path / "drive.npz")
    timed = ("--durations", tmp_path / "drive.npz", "--discount-of", "1")
    _, _, errors = mdm("solve", TIGER, *timed, "-o", tmp_path / "p.npz", "--gap", "1")
    progress = "  iteration "  # which a busy machine tells
    assert [line for line in errors.splitlines() if progress not in line] == []


def test_durations_of_another_model_are_refused(mdm, tmp_path):
    save_durations(Durations([[1.0] * 5]), tmp_path / "drive.npz")
    status, output, errors = mdm("solve", TIGER, "--durations", tmp_path / "drive.npz")
    assert (status, output) == (1, [])
    assert "drive.npz: the durations have the shape (1, 5); the model has 2 states and 3 actions" in errors
    status, _, errors = mdm("solve", TIGER, "--durations", tmp_path / "drive.npz", "-o", tmp_path / "drive.npz")
    assert status == 1
    assert "this file is an input and would be overwritten" in errors
