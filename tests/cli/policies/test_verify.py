"""`mdm verify`: numbers of a policy and of all policies, a policy that attains them, wrong input."""

from __future__ import annotations

import json

import numpy as np
import pytest
from places import TIGER, TIGER_VECTORS

from mdm import load_policy, save_model, save_policy
from mdm.models import MDP
from mdm.policies import DeterministicPolicy, FiniteStateController, StagedPolicy

NAMES, ACTIONS = ["hall", "landing", "stairs", "dock"], ["Go", "Creep", "Wait"]
GO = [[0, 0.7, 0.2, 0.1], [0, 0, 0.5, 0.5], [0, 0, 1, 0], [0, 0, 0, 1]]
CREEP = [[0, 0.9, 0, 0.1], [0, 0, 0.1, 0.9], [0, 0, 1, 0], [0, 0, 0, 1]]


@pytest.fixture
def floor(tmp_path):
    """Write a model and a policy for it."""
    rewards = np.zeros((3, 4, 4))
    rewards[:, :2, 2], rewards[:, :2, 3] = -1, 1
    start = [1, 0, 0, 0]
    model = MDP([GO, CREEP, np.eye(4)], rewards, discount=0.9, states=NAMES, actions=ACTIONS, initial_belief=start)
    save_model(model, tmp_path / "floor.npz")
    save_policy(DeterministicPolicy([0] * 4, 3), tmp_path / "go.npz", model)
    return tmp_path / "floor.npz", tmp_path / "go.npz"


def test_a_policy(mdm, floor):
    status, lines, errors = mdm("verify", *floor, "P(reach stairs before dock)")
    assert (status, errors) == (0, "")
    number, way, decision = lines
    assert number.startswith("probability         0.55 (error at most ")
    assert way == "most probable way   hall (Go), landing (Go), stairs: 0.35"
    assert decision == "worst decision      Go in hall: with Wait there X is reached with 0"
    facts = json.loads(mdm("verify", *floor, "P(reach stairs before dock)", "--json")[1][0])
    assert facts == {"probability": pytest.approx(0.55), "error": pytest.approx(0, abs=1e-12)}
    between = mdm("verify", floor[0], "--json", floor[1], "P(reach stairs before dock)")[1][0]
    assert (
        json.loads(between) == facts == json.loads(mdm("verify", *floor, "--json", "P(reach stairs before dock)")[1][0])
    )
    facts = json.loads(mdm("verify", *floor, "E(steps until stairs or dock)", "--from", "landing", "--json")[1][0])
    assert facts == {"value": pytest.approx(1), "error": pytest.approx(0, abs=1e-12)}


def test_all_policies_and_one_that_attains_a_number(mdm, floor, tmp_path):
    model, kept = floor[0], tmp_path / "kept.npz"
    status, lines, _ = mdm("verify", model, "P(reach stairs)", "-o", kept, "--greatest")
    assert status == 0
    assert lines[0] == "least               probability 0 (by the graph alone)"
    assert lines[1].startswith("greatest            probability 0.55 (error at most ")
    assert lines[-1] == f"kept in             {kept}: a policy that attains the greatest"
    assert load_policy(kept).actions[:2] == (0, 0)
    facts = json.loads(mdm("verify", model, "P(reach stairs)", "-o", kept, "--json")[1][0])
    assert facts["least"] == {"probability": 0.0, "error": 0.0}
    assert facts["greatest"]["probability"] == pytest.approx(0.55)
    assert json.loads(mdm("verify", model, kept, "P(reach stairs)", "--json")[1][0])["probability"] == 0
    mdm("verify", model, "P(reach stairs within 3)", "-o", kept)
    assert isinstance(load_policy(kept), StagedPolicy)
    facts = json.loads(mdm("verify", model, "E(steps until dock)", "--json")[1][0])
    assert facts["least"] == {"value": "infinite", "error": 0.0}
    assert (
        mdm("verify", model, "E(steps until dock)")[1][0]
        == "least               expected steps infinite: it is not certain"
    )


def test_policies_over_beliefs_are_simulated(mdm):
    asked = "P(reach tiger-left and action = open-left within 20)"
    facts = json.loads(mdm("verify", TIGER, TIGER_VECTORS, asked, "--seed", "1", "--json")[1][0])
    assert facts.keys() == {"lower", "upper", "confidence"}
    assert 0 < facts["lower"] < facts["upper"] < 1
    lines = mdm("verify", TIGER, TIGER_VECTORS, asked, "--seed", "1", "--episodes", "50")[1]
    assert lines[0].startswith("probability         between ")
    assert lines[0].endswith(", with 95% confidence")
    assert lines[1] == "                    50 simulated episodes, seed 1"
    line = mdm("verify", TIGER, TIGER_VECTORS, asked, "--seed", "1", "--episodes", "50", "--bounds", "60")[1][2]
    assert line.startswith("belief graph        between 0.")
    assert " apart, by " in line
    lines = mdm("verify", TIGER, TIGER_VECTORS, "E(steps until action = listen and not action = listen)")[1]
    assert lines[0] == "expected steps      infinite: some episodes never end there"


def test_notes_say_what_is_seen(mdm, tmp_path):
    errors = mdm("verify", TIGER, "P(reach tiger-left)")[2]
    assert "over policies that see the state: no policy over observations is outside" in errors
    listen = tmp_path / "listen.npz"
    save_policy(FiniteStateController([0], [[0, 0]], 3), listen)
    status, lines, errors = mdm("verify", TIGER, listen, "S(tiger-left)")
    assert (status, errors) == (0, "")
    assert lines[0].startswith("share of steps      0.5 ")


def test_a_long_way_is_cut(mdm, tmp_path):
    size = 30
    ways = np.roll(np.eye(size), 1, axis=1)
    save_model(MDP([ways], np.zeros((size, 1)), discount=0.9, initial_belief=np.eye(size)[0]), tmp_path / "ring.npz")
    line = mdm("verify", tmp_path / "ring.npz", "P(reach 29)")[1][2]
    assert "18 more" in line


@pytest.mark.parametrize(
    ("more", "status", "words"),
    [
        (["P(reach stars)"], 1, "the model has no state 'stars'; did you mean 'stairs'?"),
        (["P(reach stairs"], 1, "does not parse at column 15"),
        (["P(reach hole-*)"], 0, "nothing in the model satisfies hole-*"),
        (["P(reach stairs)", "--from", "attic"], 1, "has no symbol 'attic'"),
        (["P(reach stairs)", "--greatest"], 2, "give -o"),
        (["go.npz", "P(reach stairs)", "-o", "other.npz"], 2, "goes without a POLICY"),
        (["P(reach stairs)", "-o", "other.txt"], 1, "other.txt"),
        (["tiger.npz", "P(reach stairs)"], 1, "the policy is for"),
        (["P(reach stairs)", "--config", "robot.toml"], 2, "it goes without a model"),
        (["P(reach stairs)", "--seed", "1"], 2, "this number is exact without them"),
        (["go.npz", "P(reach stairs)", "--episodes", "5"], 2, "this number is exact without them"),
    ],
)
def test_wrong_input(mdm, floor, monkeypatch, more, status, words):
    monkeypatch.chdir(floor[0].parent)
    save_policy(FiniteStateController([0], [[0, 0]], 3), "tiger.npz")
    found, _, errors = mdm("verify", "floor.npz", *more)
    assert found == status
    assert words in errors or "needs observations" in errors


def test_ensembles_of_a_file(mdm, floor):
    (floor[0].parent / "robot.toml").write_text(
        '[predicates]\nh = { sensor = true }\n[ensembles.robot]\nmodel = "floor.npz"\npolicy = "go.npz"\n'
    )
    status, _, errors = mdm("verify", floor[0].parent / "robot.toml", "P(reach stairs)")
    assert status == 2
    assert "give its name before the specification" in errors


def test_what_solve_and_evaluate_say_of_a_pit(mdm, tmp_path):
    """A corridor of four cells between a pit, which costs less than the way, and a goal."""
    ways, rewards = np.zeros((2, 6, 6)), np.zeros((2, 6, 6))
    ways[:, 0, 0] = ways[:, 5, 5] = 1
    for cell in range(1, 5):
        ways[0, cell, cell - 1] = ways[1, cell, cell + 1] = 1
        rewards[:, cell] = [-0.1, *[-0.4] * 4, 1]
    names = ["pit", "c1", "c2", "c3", "c4", "goal"]
    model = MDP(ways, rewards, discount=0.5, states=names, initial_belief=np.eye(6)[1])
    path, policy = tmp_path / "corridor.npz", tmp_path / "policy.npz"
    save_model(model, path)
    told = "the policy ends in 'pit' with probability 1, and 0 is possible on a way to 'goal': see mdm verify"
    assert told in mdm("solve", path, "-o", policy)[2]
    assert told in mdm("evaluate", path, policy)[2]
    save_policy(DeterministicPolicy([1] * 6, 2), policy, model)
    assert mdm("evaluate", path, policy)[2] == ""
