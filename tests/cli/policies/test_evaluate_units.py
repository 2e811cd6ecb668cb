"""What a discount is of, by the commands; and the model of a semi-Markov policy in a TOML file."""

from __future__ import annotations

import pytest
from places import MODELS, TIGER, TIGER_VECTORS

import mdm as library
from mdm.cli.policies.evaluate import Verdict
from mdm.formats import save_durations
from mdm.models import Durations

CHAIN = MODELS / "chain.mdp"
ROBOT = """
[ensembles.robot]
model = "model.npz"
policy = "policy.npz"
DURATIONS
[ensembles.robot.actions]
"""


@pytest.fixture
def timed(tmp_path):
    """A folder with a model whose discount is of a second, durations with rewards by time, and its policy."""
    model = library.load_model(CHAIN)
    model = model.with_discount(model.discount, of="second")
    durations = Durations([[1.0, 50.0], [30.0, 2.0], [4.0, 4.0]], 3, [[0.0, 0.3], [-0.2, 0.1], [0.0, 0.0]])
    library.save_model(model, tmp_path / "model.npz")
    save_durations(durations, tmp_path / "times.npz")
    solution = library.solve(model, durations=durations, gap=1e-6)
    library.save_policy(solution.policy, tmp_path / "policy.npz", model)
    actions = "".join(f'"{name}" = "gc:collect"\n' for name in model.action_space.names)
    (tmp_path / "robot.toml").write_text(ROBOT.replace("DURATIONS", 'durations = "times.npz"') + actions)
    (tmp_path / "untimed.toml").write_text(ROBOT.replace("DURATIONS", "") + actions)
    return tmp_path, solution


@pytest.mark.parametrize(("claimed", "is_less"), [(-145.12301, 0), (-145.1250, -1), (-145.12, 1)])
def test_values_that_read_the_same_do_not_contradict(claimed, is_less):
    """A solver stops at a gap."""
    verdict = Verdict("Q-table", "2 states", claimed, (-145.12345, -150.0, -140.0), None, comparable=True)
    assert verdict.contradicts == is_less


def test_info_says_what_a_discount_is_of(facts, timed):
    folder, _ = timed
    for name in ("model", "policy"):
        assert facts("info", folder / f"{name}.npz")["discount_of"] == "a second"
    assert facts("info", CHAIN)["discount_of"] == facts("info", TIGER_VECTORS)["discount_of"] == "a step"
    told = facts("info", folder / "times.npz")
    assert (told["least_seconds"], told["most_seconds"]) == (1.0, 50.0)
    assert (told["least_reward_a_second"], told["most_reward_a_second"]) == (-0.2, 0.3)
    save_durations(Durations([1.0, 2.0], of="step"), folder / "steps.npz")
    told = facts("info", folder / "steps.npz")
    assert (told["least_steps"], told["most_reward_a_step"]) == (1.0, 0.0)


@pytest.mark.parametrize(("unit", "told"), [("step", "a step"), ("second", "a second"), ("2.5", "a step of 2.5 s")])
def test_a_unit_may_be_given(mdm, facts, tmp_path, unit, told):
    assert mdm("convert", CHAIN, tmp_path / "chain.npz", "--discount-of", unit)[0] == 0
    assert facts("info", tmp_path / "chain.npz")["discount_of"] == told


def test_what_is_no_unit_is_refused(mdm):
    for text in ("minute", "0", "nan"):
        status, _, errors = mdm("solve", TIGER, "--discount-of", text)
        assert status == 2
        assert f"step, second, or the seconds of a step was expected, not '{text}'" in errors


@pytest.mark.parametrize("verb", ["solve", "evaluate", "compare"])
def test_what_cannot_be_converted_is_refused(mdm, timed, verb):
    folder, _ = timed
    policies = () if verb == "solve" else (folder / "policy.npz",)
    status, _, errors = mdm(verb, CHAIN, *policies, "--durations", folder / "times.npz")
    assert status == 1
    assert "the model's discount is of a step, the durations count seconds" in errors
    status, _, errors = mdm(verb, folder / "model.npz", *policies)
    assert status == 1
    assert "say how long actions take by durations" in errors
    assert mdm(verb, folder / "model.npz", *policies, "--discount-of", "2")[0] == 0


def test_a_claim_by_another_unit_is_not_compared(mdm, facts, timed):
    folder, solution = timed
    durations = ("--durations", folder / "times.npz")
    model, policy = folder / "model.npz", folder / "policy.npz"
    told = facts("evaluate", model, policy, *durations)
    assert told["exact"] == pytest.approx(solution.lower, abs=1e-4)
    assert told["claim_is"] == "not contradicted"
    other = library.load_policy(policy)
    other = type(other)(other.values + 1.0)
    library.save_policy(other, folder / "other.npz")
    assert facts("evaluate", model, folder / "other.npz", *durations)["claim_is"] == "not contradicted"
    _, output, _ = mdm("evaluate", model, folder / "other.npz", *durations)
    assert any(line.endswith("at the start by a discount of a step: not compared") for line in output)
    other.discount_of = 5.0
    library.save_policy(other, folder / "other.npz")
    assert facts("evaluate", model, folder / "other.npz", *durations)["claim_is"] == "too high"


def stale(told):
    return any(note.startswith("policy.npz is not that of model.npz") for note in told["notes"])


def test_check_and_evaluate_know_the_model_of_a_semi_markov_policy(mdm, facts, timed):
    folder, solution = timed
    durations = ("--durations", folder / "times.npz")
    told = facts("evaluate", folder / "robot.toml", "robot")
    assert told["exact"] == pytest.approx(solution.lower, abs=1e-4)
    for arguments in ([folder / "robot.toml"], [folder / "policy.npz", "--model", folder / "model.npz", *durations]):
        assert not stale(facts("check", *arguments))
    table = library.load_policy(folder / "policy.npz")
    other = type(table)(table.values[::-1].copy())
    other.discount_of = "second"
    library.save_policy(other, folder / "policy.npz")
    for arguments in ([folder / "robot.toml"], [folder / "policy.npz", "--model", folder / "model.npz", *durations]):
        assert stale(facts("check", *arguments))
    assert not stale(facts("check", folder / "untimed.toml"))  # nothing is known of it


def test_durations_in_a_file_fit_its_model_or_are_refused(mdm, timed):
    folder, _ = timed
    save_durations(Durations([1.0] * 5), folder / "times.npz")
    status, _, errors = mdm("check", folder / "robot.toml")
    assert status == 1
    assert "ensembles.robot.durations" in errors
    status, _, errors = mdm("evaluate", folder / "untimed.toml", "nobody")
    assert "there is no ensemble 'nobody'" in errors
    status, _, errors = mdm("evaluate", folder / "untimed.toml", "robot", "--durations", folder / "times.npz")
    assert "--durations is for a model's file; an ensemble has its own" in errors
    status, _, errors = mdm("check", folder / "untimed.toml", "--durations", folder / "times.npz")
    assert "--durations are those of a policy's --model" in errors
