"""What `mdm check` says of shields: the numbers before and after, and what stands in for a policy without one."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from shielded import SHIELD, WRONG, house, written

import mdm
from mdm.cli import main
from mdm.cli.files.shields import of_shields
from mdm.policies import DeterministicPolicy


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def check(path, capsys):
    status = main(["check", str(path)])
    out, err = capsys.readouterr()
    return status, out, err


def test_check_tells_the_numbers_before_and_after_at_the_line_of_the_shield(folder, capsys):
    path = written(folder)
    status, out, _ = check(path, capsys)
    line = 1 + path.read_text().split("\n").index(SHIELD)
    # By hand: straight on pays 1 at the landing, after one step, and may lead to the stairs; around, after two.
    expected = (
        f"{path}:{line}:1: note: the shield changes P(reach position = stairs) from 0.25 to 0, "
        f"P(reach position = goal) from 0.75 to 1, the expected return from 0.9 to 0.81: 0.09 of the return is lost"
    )
    assert (status, expected in out) == (0, True), out


def test_a_policy_that_the_shield_makes_better_gains(folder, capsys, monkeypatch):
    chances = (mdm.verification.Exact(0.5, 0.0), mdm.verification.Exact(0.0, 0.0))
    monkeypatch.setattr(
        mdm.verification, "effect", lambda *_, **__: mdm.verification.Effect(chances, None, (0.25, 1.0), 0.0)
    )
    assert "from 0.25 to 1: 0.75 of the return is gained" in check(written(folder), capsys)[1]


def test_a_policy_that_is_safe_loses_nothing(folder, capsys):
    _, out, _ = check(written(folder, policy=(2, 1, 2, 0, 0)), capsys)
    assert "P(reach position = stairs) from 0 to 0" in out
    assert ": 0 of the return is lost" in out


@pytest.mark.parametrize(
    ("shield", "words"),
    [
        ('shield = { avoid = "position = stairs" }', "would stand for ever"),
        ('shield = { avoid = "position = landing", keep = "reach position = goal" }', "no way to"),
    ],
)
def test_check_refuses_a_shield_under_which_the_robot_stands_or_cannot_come_to_its_goal(folder, capsys, shield, words):
    status, _, err = check(written(folder, shield), capsys)
    assert (status, words in err) == (1, True), err


@pytest.mark.parametrize(("action", "told"), [("Straight", True), ("Around", False)])
def test_a_safe_action_of_the_models_that_the_shield_would_forbid_is_told(folder, capsys, action, told):
    path = written(folder, f'{SHIELD}\nsafe_action = "{action}"')
    _, out, _ = check(path, capsys)
    place = path.read_text().split("\n").index(f'safe_action = "{action}"') + 1
    note = f"{path}:{place}:1: note: the safe action is not shielded: in landing it may lead to position = stairs"
    assert (note in out) is told, out


@pytest.mark.parametrize("planted", [True, False])
def test_a_fallback_without_a_shield_is_found(planted):
    model = house()
    policy = mdm.shield(WRONG, model, avoid="position = stairs", keep="reach position = goal")
    policy.fallback = DeterministicPolicy(WRONG, 3) if planted else policy
    symbols = mdm.Controller(policy, model).symbols
    ensemble = SimpleNamespace(
        name="robot",
        controller=SimpleNamespace(policy=policy, model=model, symbols=symbols),
        action=SimpleNamespace(bindings=(), safe=None),
    )
    notes = [text for _, text in of_shields([ensemble, ensemble])]
    assert len(notes) == 1 + planted
    assert ("the fallback of the search is not shielded: it may lead to position = stairs" in notes) is planted


PROGRAM = """
from hidden_dangers import tiger

import mdm


def make(planted=False):
    model, opens = tiger(), mdm.policies.AlphaVectors([[0.0] * 4], [1], 3)
    search = mdm.solvers.TreeSearch(model, expansions=2, fallback=opens)
    policy = mdm.shield(search, model, avoid="eaten", keep="reach free")
    policy.fallback = opens if planted else policy.fallback
    actions = dict.fromkeys(["listen", "left", "right"], lambda: None)
    return mdm.Ensemble("tiger", model=model, policy=policy, actions=actions)


def planted():
    return make(planted=True)
"""


@pytest.mark.parametrize("function", ["make", "planted"])
def test_check_of_a_program_finds_a_fallback_without_a_shield(folder, capsys, monkeypatch, function):
    monkeypatch.setattr("mdm.cli.files.shields._SECONDS", 0.0)
    (folder / "robot.py").write_text(PROGRAM)
    status, out, err = check(f"{folder / 'robot.py'}:{function}", capsys)
    assert (status, "the shield changes P(reach eaten) from " in out) == (0, True), out + err
    assert ("the fallback of the search is not shielded: it may lead to eaten" in out) is (function == "planted")
