"""`mdm evaluate` and `mdm compare`: exact values, estimates, contradictions."""

from __future__ import annotations

import json

import pytest
from places import MODELS, ROOT, TIGER, TIGER_VECTORS

from mdm import evaluate, load_model, load_policy, save_policy, solve
from mdm.formats import save_durations
from mdm.models import Durations
from mdm.policies import FiniteStateController

CHAIN = MODELS / "chain.mdp"


def test_a_policy_over_beliefs_is_simulated(mdm, facts):
    found = facts("evaluate", TIGER, TIGER_VECTORS, "--seed", "3")
    assert found["claim"] == pytest.approx(19.3713, abs=1e-3)
    assert found["interval"][0] < 19.3713 < found["interval"][1]
    assert (found["exact"], found["episodes"], found["claim_is"]) == (None, 10_000, "not contradicted")
    found, again = (facts("evaluate", TIGER, TIGER_VECTORS, "--seed", "3", "--episodes", "500") for _ in range(2))
    for result in (found, again):
        del result["run"]
    assert found == again
    text = "\n".join(mdm("evaluate", TIGER, TIGER_VECTORS, "--seed", "3", "--episodes", "100")[1])
    assert "100 episodes" in text
    assert "contradiction" not in text


@pytest.mark.parametrize(("by", "told", "words"), [(5, "too high", "less than"), (-5, "too low", "more than")])
def test_a_wrong_claim_is_contradicted(mdm, by, told, words, facts, shifted):
    path, episodes = shifted(by), ("--episodes", "5000")  # the claim is off by eleven of the mean's errors
    assert facts("evaluate", TIGER, path, "--seed", "1", *episodes)["claim_is"] == told
    output = mdm("evaluate", TIGER, path, *episodes)[1]
    assert any(line.startswith("contradiction") and words in line for line in output)
    assert facts("evaluate", TIGER, path, "--steps", "9", *episodes)["claim_is"] == "not contradicted"


def test_tables_and_controllers_have_exact_values(tmp_path, facts):
    table, graph = tmp_path / "table.policy", tmp_path / "listen.npz"
    table.write_text("[3](1,1,0)")
    found = facts("evaluate", CHAIN, table)
    assert found["exact"] == pytest.approx((10 + 14 + 0.9 * 14) / 3)
    assert (found["exact_min"], found["exact_max"], found["mean"]) == (pytest.approx(10), pytest.approx(14), None)
    found = facts("evaluate", CHAIN, table, "--episodes", "500", "--seed", "1")
    assert abs(found["mean"] - found["exact"]) < 4 * found["standard_error"]
    save_policy(FiniteStateController([0], [[0, 0]], 3), graph)
    assert facts("evaluate", TIGER, graph)["exact"] == pytest.approx(-20)
    assert facts("evaluate", TIGER, graph, "--discount", "0.5")["exact"] == pytest.approx(-2)
    assert facts("evaluate", TIGER, graph, "--discount", "1", "--steps", "7")["exact"] == pytest.approx(-7)


def test_false_negatives(mdm):
    data = ROOT / "tests" / "data"
    given = ("evaluate", data / "models" / "guard.pgmx", data / "policies" / "guard.vf", "--discount", "0.5")
    without, told = (
        json.loads(mdm(*given, "--seed", "1", "--episodes", "2000", "--json", *more)[1][0])
        for more in ([], ["--false-negative", "nothing"])
    )
    assert without["mean"] != told["mean"]
    loop = mdm(
        "simulate",
        "--model",
        given[1],
        "--policy",
        given[2],
        "--discount",
        "0.5",
        "--false-negative",
        "nothing",
        "--episodes",
        "100",
        "--seed",
        "1",
        "--json",
    )
    found = json.loads(loop[1][0])
    errors = found["standard_error"] + told["standard_error"]
    assert abs(found["mean"] - told["mean"]) < 4 * errors


@pytest.mark.parametrize("verb", ["evaluate", "compare", "solve"])
def test_help_shows_signs_once(mdm, verb):
    _, output, _ = mdm(verb, "--help")
    assert "%%" not in "".join(output)
    assert "%" in "".join(output)


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["evaluate", TIGER], 2, "required"),
        (["evaluate", TIGER, TIGER_VECTORS, "--steps", "0"], 2, "1 or more"),
        (["evaluate", TIGER, TIGER_VECTORS, "--seed", "-1"], 2, "0 or more"),
        (["compare", TIGER], 2, "required"),
        (
            ["evaluate", TIGER, TIGER_VECTORS, "--discount", "1"],
            1,
            "an end: give a discount (--discount) or decisions (--steps)",
        ),
        (["evaluate", TIGER, TIGER_VECTORS, "--false-negative", "nobody"], 1, "no symbol 'nobody'"),
        (["evaluate", TIGER, ROOT / "nothing.vf"], 1, "nothing.vf"),
        (["compare", TIGER, TIGER_VECTORS, ROOT / "nothing.vf"], 1, "nothing.vf"),
        (["evaluate", TIGER, ROOT / "examples" / "patrol" / "top.policy"], 1, "top.policy"),
    ],
)
def test_mistakes(mdm, arguments, status, words):
    found, output, errors = mdm(*arguments)
    assert (found, output) == (status, [])
    assert words in errors
    assert "Traceback" not in errors


def test_durations_count_in_real_time(mdm, facts, tmp_path):
    drive, table, best = tmp_path / "drive.npz", tmp_path / "table.npz", tmp_path / "best.npz"
    chain, tiger = (model.with_discount(model.discount, of="second") for model in map(load_model, (CHAIN, TIGER)))
    timed = ("--durations", drive, "--discount-of", "second")
    durations = Durations([[1.0, 5.0], [3.0, 2.0], [4.0, 4.0]], 3)
    save_durations(durations, drive)
    solution = solve(chain, durations=durations)
    save_policy(solution.policy, table, chain)
    assert facts("evaluate", CHAIN, table, *timed)["exact"] == pytest.approx(solution.lower, abs=2e-3)
    rows = facts("compare", CHAIN, table, table, *timed, "--seed", "2", "--episodes", "100")
    right = evaluate(chain, load_policy(table, chain), durations=durations, seed=2, episodes=100)
    assert [row["mean"] for row in rows] == [right.mean] * 2
    durations = Durations([2.0, 5.0, 5.0])
    save_durations(durations, drive)
    save_policy(solve(tiger, durations=durations, gap=0.01).policy, best, tiger)
    assert facts("evaluate", TIGER, best, *timed, "--seed", "3")["claim_is"] == "not contradicted"
    for verb in ("evaluate", "compare"):
        status, _, errors = mdm(verb, CHAIN, table, "--durations", drive)
        assert status == 1
        assert "drive.npz: the durations have the shape" in errors


def test_a_policy_over_states_says_what_it_takes_as_seen(mdm, tmp_path):
    path = tmp_path / "sees.policy"
    path.write_text("[2](2,1)")  # opens the right door where the tiger is at the left, and the other way round
    note = "the policy is over states: it takes {} as seen at each step, which the model hides\n"
    for verb in ("evaluate", "compare"):
        status, _, errors = mdm(verb, TIGER, path)
        assert (status, errors) == (0, f"mdm {verb}: {note.format('state')}")
    _, _, errors = mdm("simulate", TIGER, path, "--episodes", "3", "--steps", "2")
    assert errors.endswith(note.format("state"))
