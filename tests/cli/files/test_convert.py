"""`mdm convert`: into every format, and what is lost on the way."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
from places import MODELS, POLICIES, TIGER

from mdm import load_model, load_policy


@pytest.mark.parametrize("suffix", ["pomdp", "pomdp.gz", "dpomdp", "pgmx", "pomdpx", "npz"])
def test_convert_and_info_on_every_format(mdm, tmp_path, suffix):
    target = tmp_path / f"tiger.{suffix}"
    status, output, errors = mdm("convert", TIGER, target)
    assert (status, errors) == (0, "")
    assert output == [f"{target}: a model (POMDP)"]
    status, output, errors = mdm("info", target, "--json")
    facts = json.loads(output[0])
    assert (facts["kind"], facts["states"], facts["actions"], facts["observations"]) == ("POMDP", 2, 3, 2)
    assert facts["event_observations"] is False
    np.testing.assert_array_equal(load_model(target).rewards, load_model(TIGER).rewards)
    assert mdm("check", target)[0] == 0


def test_convert_tells_what_is_lost(mdm, tmp_path):
    status, _, errors = mdm("convert", MODELS / "lamp.pomdpx", tmp_path / "lamp.pomdp")
    assert status == 0
    assert "2 state factors became 1" in errors
    assert "the network of the factored model became matrices" in errors
    status, _, errors = mdm("convert", MODELS / "guard.pgmx", tmp_path / "guard.pomdp")
    assert status == 1
    assert "events" in errors
    assert not (tmp_path / "guard.pomdp").exists()
    status, _, errors = mdm("convert", MODELS / "guard.pgmx", tmp_path / "guard.npz", "--discount", "0.5")
    assert (status, errors) == (0, "")
    assert load_model(tmp_path / "guard.npz").discount == 0.5


def test_convert_writes_to_a_pipe_and_does_not_read_it(mdm, tmp_path):
    path = tmp_path / "pipe.pomdp"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        assert mdm("convert", TIGER, path) == (0, [f"{path}: a model (POMDP)"], "")
        assert os.read(reader, 9) == b"discount:"
    finally:
        os.close(reader)


def test_convert_normalizes_on_demand(mdm, tmp_path):
    status, _, errors = mdm("convert", MODELS / "odd.pomdp", tmp_path / "even.npz")
    assert status == 1
    assert "sums to 0.95" in errors
    status, _, errors = mdm("convert", "--normalize", MODELS / "odd.pomdp", tmp_path / "even.npz")
    assert status == 0
    assert "1 distributions did not sum to 1 and were normalised" in errors
    assert load_model(tmp_path / "even.npz").transition("go", "a", "b") == pytest.approx(0.9 / 0.95)


def test_convert_of_policies(mdm, tmp_path):
    target = tmp_path / "tiger.npz"
    status, output, errors = mdm("convert", POLICIES / "tiger.vf", target, "--model", TIGER)
    assert (status, errors) == (0, "")
    assert output == [f"{target}: a policy (alpha vectors)"]
    np.testing.assert_array_equal(load_policy(target).vectors, load_policy(POLICIES / "tiger.vf").vectors)
    assert mdm("convert", POLICIES / "tiger.vf", "/dev/null")[0] == 0
    assert mdm("convert", POLICIES / "tiger.vf", target, "--discount", "1")[0] == 2
    assert mdm("convert", TIGER, target, "--model", TIGER)[0] == 2
    status, _, errors = mdm("convert", POLICIES / "tiger.vf", tmp_path / "tiger.pg")
    assert status == 1
    assert ".npz" in errors
    for name in ("tiger.txt", "tiger.vf"):
        status, _, errors = mdm("convert", TIGER, tmp_path / name)
        assert status == 1
        assert ".pomdpx" in errors
    status, _, errors = mdm("convert", POLICIES / "tiger.vf", tmp_path / "out.pomdp")
    assert status == 1
    assert "'out.pomdp': its files end in .npz, .policy, .policyx, .alpha, .vf" in errors
    assert [file.name for file in tmp_path.iterdir()] == ["tiger.npz"]
