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
