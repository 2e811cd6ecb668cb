"""What a file holds, told by its content and its name."""

from __future__ import annotations

import json

import pytest
from places import POLICIES, TIGER

from mdm import load_model, load_policy, save_model, save_policy


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


LINES = "2 1.5 2.5 0\n0 3.25 4 0\n1 0 0.5 0\n0 3 4.5 5\n"
NAMED = "# a comment\nlisten\n-1 1\nopen-left\n0 1\n"
SPUDD = "(variables (huc yes no))\n"


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("lines.policy", LINES, "alpha vectors"),
        ("named.alpha", NAMED, "alpha vectors"),
        ("coffee.spudd", SPUDD, "this is a model of SPUDD or Symbolic Perseus"),
        ("tree.policy", '{"nodes": []}', "this is JSON"),
        ("tree.txt", "x1 -> left", "this is no model and no policy of a known form"),
    ],
)
def test_every_verb_tells_a_file_alike(mdm, tmp_path, name, text, told):
    path, model = tmp_path / name, tmp_path / "model.pomdp"
    path.write_text(text)
    states, actions = (3, "3") if name == "lines.policy" else (2, "listen open-left open-right")
    model.write_text(
        f"discount: 0.9\nvalues: reward\nstates: {states}\nactions: {actions}\nobservations: 2\n"
        "T: *\nuniform\nO: *\nuniform\nR: 0 : * : * : * 1\n"
    )
    read = told == "alpha vectors"
    for verb in (
        ("info", path),
        ("check", path),
        ("evaluate", model, path, "--episodes", "3"),
        ("simulate", model, path, "--episodes", "3"),
        ("compare", model, path, "--episodes", "3"),
    ):
        status, output, errors = mdm(*verb)
        assert (status == 0) is read, (verb, errors)
        assert told in "\n".join(output) + errors or verb[0] in {"simulate", "compare"}, verb
    for verb in (("info", path), ("solve", path), ("show", path), ("evaluate", path, path)):
        status, _, errors = mdm(*verb)
        if not read:
            assert (status, told in errors) == (1, True), verb
        elif verb[0] != "info":
            assert (status, "holds a policy" in errors) == (1, True), verb
