"""`mdm evaluate` and `mdm compare`: exact values, estimates, contradictions."""

from __future__ import annotations

import json

import numpy as np
import pytest
from places import ROOT

from mdm import load_model, load_policy, save_policy
from mdm.policies import AlphaVectors, FiniteStateController

TIGER, VECTORS = ROOT / "examples" / "tiger.pomdp", ROOT / "examples" / "tiger.vf"
CHAIN = """discount: 0.9
values: reward
states: 3
actions: stay go
T: stay identity
T: go
0 1 0
0 0 1
0 0 1
R: go : 1 : * : * 5
R: * : 2 : * : * 1
"""


def facts(mdm, *arguments):
    status, output, errors = mdm(*arguments, "--json")
    assert (status, errors) == (0, "")
    return json.loads(output[0])


def shifted(tmp_path, by):
    policy = load_policy(VECTORS)
    save_policy(AlphaVectors(policy.vectors + by, policy.actions), tmp_path / "shifted.npz")
    return tmp_path / "shifted.npz"


def test_a_policy_over_beliefs_is_simulated(mdm):
    found = facts(mdm, "evaluate", TIGER, VECTORS, "--seed", "3")
    assert found["claim"] == pytest.approx(19.3713, abs=1e-3)
    assert found["interval"][0] < 19.3713 < found["interval"][1]
    assert (found["exact"], found["episodes"], found["claim_is"]) == (None, 10_000, "not contradicted")
    again = facts(mdm, "evaluate", TIGER, VECTORS, "--seed", "3")
    for result in (found, again):
        del result["steps_a_second"]
    assert found == again
    text = "\n".join(mdm("evaluate", TIGER, VECTORS, "--seed", "3", "--episodes", "100")[1])
    assert "100 episodes" in text
    assert "contradiction" not in text


@pytest.mark.parametrize(("by", "told", "words"), [(5, "too high", "less than"), (-5, "too low", "more than")])
def test_a_wrong_claim_is_contradicted(mdm, tmp_path, by, told, words):
    path = shifted(tmp_path, by)
    assert facts(mdm, "evaluate", TIGER, path, "--seed", "1")["claim_is"] == told
    assert any(line.startswith("contradiction") and words in line for line in mdm("evaluate", TIGER, path)[1])
    assert facts(mdm, "evaluate", TIGER, path, "--steps", "9")["claim_is"] == "not contradicted"


def test_tables_and_controllers_have_exact_values(mdm, tmp_path):
    chain, table, graph = tmp_path / "chain.mdp", tmp_path / "table.policy", tmp_path / "listen.npz"
    chain.write_text(CHAIN)
    table.write_text("[3](1,1,0)")
    found = facts(mdm, "evaluate", chain, table)
    assert found["exact"] == pytest.approx((10 + 14 + 0.9 * 14) / 3)
    assert (found["exact_min"], found["exact_max"], found["mean"]) == (pytest.approx(10), pytest.approx(14), None)
    found = facts(mdm, "evaluate", chain, table, "--episodes", "500", "--seed", "1")
    assert abs(found["mean"] - found["exact"]) < 4 * found["standard_error"]
    save_policy(FiniteStateController([0], [[0, 0]], 3), graph)
    assert facts(mdm, "evaluate", TIGER, graph)["exact"] == pytest.approx(-20)
    assert facts(mdm, "evaluate", TIGER, graph, "--discount", "0.5")["exact"] == pytest.approx(-2)
    assert facts(mdm, "evaluate", TIGER, graph, "--discount", "1", "--steps", "7")["exact"] == pytest.approx(-7)


def test_false_negatives(mdm):
    data = ROOT / "tests" / "data"
    given = ("evaluate", data / "models" / "guard.pgmx", data / "policies" / "guard.vf", "--discount", "0.5")
    means = [
        json.loads(mdm(*given, "--seed", "1", "--json", *more)[1][0])["mean"]
        for more in ([], ["--false-negative", "nothing"])
    ]
    assert means[0] != means[1]
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
    assert abs(found["mean"] - means[1]) < 4 * found["standard_error"] + 0.02


@pytest.mark.parametrize("verb", ["evaluate", "compare", "solve"])
def test_help_shows_signs_once(mdm, verb):
    _, output, _ = mdm(verb, "--help")
    assert "%%" not in "".join(output)
    assert "%" in "".join(output)


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["evaluate", TIGER], 2, "required"),
        (["evaluate", TIGER, VECTORS, "--steps", "0"], 2, "1 or more"),
        (["evaluate", TIGER, VECTORS, "--seed", "-1"], 2, "0 or more"),
        (["compare", TIGER], 2, "required"),
        (["evaluate", TIGER, VECTORS, "--discount", "1"], 1, "needs an end"),
        (["evaluate", TIGER, VECTORS, "--false-negative", "nobody"], 1, "no symbol 'nobody'"),
        (["evaluate", TIGER, ROOT / "nothing.vf"], 1, "nothing.vf"),
        (["compare", TIGER, VECTORS, ROOT / "nothing.vf"], 1, "nothing.vf"),
        (["evaluate", TIGER, ROOT / "examples" / "patrol" / "top.policy"], 1, "top.policy"),
    ],
)
def test_mistakes(mdm, arguments, status, words):
    found, output, errors = mdm(*arguments)
    assert (found, output) == (status, [])
    assert words in errors
    assert "Traceback" not in errors


def test_policies_meet_the_same_luck(mdm, tmp_path):
    graph = tmp_path / "listen.npz"
    save_policy(FiniteStateController([0], [[0, 0]], 3), graph)
    arguments = ("compare", TIGER, VECTORS, shifted(tmp_path, 1), graph, "--episodes", "400", "--seed", "5")
    rows = facts(mdm, *arguments)
    assert [row["difference"] for row in rows[:2]] == [0, 0]
    assert rows[1]["claim"] == pytest.approx(rows[0]["claim"] + 1)
    assert rows[2]["exact"] == pytest.approx(-20)
    assert rows[2]["difference"] == pytest.approx(rows[2]["mean"] - rows[0]["mean"])
    assert rows[2]["mean"] == pytest.approx(-20, abs=1e-3)
    status, output, _ = mdm(*arguments)
    assert status == 0
    assert output[0].split() == ["policy", "claims", "is", "worth", "simulated", "to", "the", "first"]
    assert [line.split()[0] for line in output[1:4]] == [str(path) for path in arguments[2:5]]
    assert "seed 5" in output[-1]
    assert "seed" in mdm("compare", TIGER, VECTORS, "--episodes", "2")[1][-1]


def test_common_numbers_make_differences_sharp(mdm, tmp_path):
    """Two policies that part only where beliefs are nearly sure differ far less than their own errors."""
    model = load_model(TIGER)
    policy = load_policy(VECTORS, model)
    vectors = policy.vectors + np.array([[0.3 if action == 1 else 0.0] for action in policy.actions])
    save_policy(AlphaVectors(vectors, policy.actions), tmp_path / "other.npz")
    rows = facts(mdm, "compare", TIGER, VECTORS, tmp_path / "other.npz", "--seed", "1")
    assert rows[1]["difference_within"] <= 2 * rows[1]["standard_error"]
