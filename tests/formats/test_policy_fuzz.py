"""Damaged policy files give a policy or a `FormatError`, never anything else."""

from __future__ import annotations

from time import process_time

import numpy as np
import places
import pytest
from hypothesis import given, strategies as st

from mdm import FormatError
from mdm.formats import files as policies
from mdm.models import POMDP, Factor, Space

DATA = places.DATA / "policies"
FILES = sorted(DATA.iterdir())
WORDS = [
    b"0",
    b"-1",
    b"9999999999",
    b"1e999",
    b"nan",
    b"X",
    b"\n\n",
    b" ",
    b"[",
    b")",
    b"<",
    b">",
    b'"',
    b"=>",
    b"\xff",
    b"",
]
ACTIONS, SOUNDS = ["listen", "open-left", "open-right"], ["hear-left", "hear-right"]
MODEL = POMDP(
    [np.eye(2)] * 9,
    np.full((9, 2, 4), 0.25),
    np.zeros((2, 9)),
    discount=0.9,
    actions=Space([Factor("first", ACTIONS), Factor("second", ACTIONS)]),
    observation_names=Space([Factor("first", SOUNDS), Factor("second", SOUNDS)]),
)
CHANGES = st.lists(
    st.tuples(st.floats(0, 1), st.sampled_from(["cut", "drop", "put", "swap", "end"]), st.sampled_from(WORDS)),
    min_size=1,
    max_size=4,
)


def changed(data, changes):
    for where, what, word in changes:
        at = int(where * len(data))
        if what == "end":
            data = data[:at]
        elif what == "cut":
            data = data[:at] + data[at + 20 :]
        elif what == "drop":
            data = data[:at] + data[at + 1 :]
        elif what == "put":
            data = data[:at] + word + data[at:]
        else:
            data = data[:at] + word + data[at + len(word) :]
    return data


def read(path, data):
    path.write_bytes(data)
    for model in (None, MODEL):
        try:
            assert policies.load_policy(path, model).num_actions > 0
        except FormatError as error:
            assert "\n" not in str(error)
            assert str(path) in str(error)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
@given(changes=CHANGES)
def test_damaged_files(tmp_path_factory, file, changes):
    read(tmp_path_factory.mktemp("fuzz") / file.name, changed(file.read_bytes(), changes))


@pytest.mark.parametrize("name", ["tiger.alpha", "tiger.pg", "mixed.policy", "masked.policy", "table.policy"])
@given(changes=CHANGES)
def test_damaged_archives(tmp_path_factory, name, changes):
    folder = tmp_path_factory.mktemp("fuzz")
    policies.save_policy(policies.load_policy(DATA / name), folder / "x.npz")
    read(folder / "x.npz", changed((folder / "x.npz").read_bytes(), changes))


@pytest.mark.parametrize(
    "text",
    [
        "\n" * 300_000 + "0",
        "," * 300_000 + " ,",
        "policyType => x\n" + "," * 300_000 + " ,",
        "policyType => x\n" + "a " * 150_000,
        "Policy for agent 0 (index 0):\n" + "(" * 300_000,
        "Policy for agent 0 (index 0):\n" + "-- " * 100_000,
        "[3]" + "(" * 300_000,
        "<" * 300_000,
        "<Policy>" * 100_000,
        "0 " * 300_000,
        "0\n" * 60_000,
        pytest.param("0\n" * 300_000, marks=pytest.mark.slow),
        "0 1\n" * 100_000,
    ],
)
def test_long_nonsense_costs_no_time(tmp_path, text):
    began = process_time()
    read(tmp_path / "x", text.encode())
    read(tmp_path / "x.pg", text.encode())
    assert process_time() - began < 20


@given(st.text(alphabet='[](),0123.-e \nX<>="/{}Policyactn#', max_size=60), st.sampled_from(["pg", "alpha", "vf", "x"]))
def test_any_text(tmp_path_factory, text, suffix):
    read(tmp_path_factory.mktemp("fuzz") / f"x.{suffix}", text.encode())
