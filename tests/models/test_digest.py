"""Digests: the same for the same model, however it is held, and another for any other."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, strategies as st
from loading import load
from random_models import factored_models, flat_models
from scipy import sparse

from mdm import save_model
from mdm.models import MDP, POMDP
from mdm.models.digest import digest, of_bytes, of_parts, parts
from mdm.problems import tiger


@given(model=flat_models(events=True, finer=False) | factored_models(events=True))
def test_a_model_that_comes_back_bit_for_bit_has_the_same_digest(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("digest") / "m.npz"
    save_model(model, path)
    assert digest(load(path)) == digest(model)
    other = 0.3 if model.discount != 0.3 else 0.4
    assert digest(model.with_discount(other)) != digest(model)


@given(st.data())
def test_any_number_or_name_that_differs_shows(data):
    arrays = {"T": np.full((2, 2, 2), 0.5), "O": np.full((2, 2, 2), 0.5), "R": np.zeros((2, 2)), "b": np.full(2, 0.5)}
    names = {"states": ["a", "b"], "actions": ["c", "d"], "observation_names": ["e", "f"]}

    def made():
        return POMDP(arrays["T"], arrays["O"], arrays["R"], discount=0.9, initial_belief=arrays["b"], **names)

    before = digest(made())
    assert digest(made()) == before
    what = data.draw(st.sampled_from([*arrays, *names, "false negative"]))
    if what in names:
        names[what] = [names[what][0], "other"]
    elif what in arrays:
        row = arrays[what].reshape(-1, 2)[data.draw(st.integers(0, arrays[what].size // 2 - 1))]
        row += [2**-30, -(2**-30)]
    changed = made().with_false_negatives(0) if what == "false negative" else made()
    assert digest(changed) != before


@given(st.data())
def test_the_part_that_differs_has_its_name(data):
    arrays = {"T": np.full((2, 2, 2), 0.5), "O": np.full((2, 2, 2), 0.5), "R": np.zeros((2, 2)), "b": np.full(2, 0.5)}
    names = {"states": ["a", "b"], "actions": ["c", "d"], "observation_names": ["e", "f"]}

    def made(discount=0.9):
        return POMDP(arrays["T"], arrays["O"], arrays["R"], discount=discount, initial_belief=arrays["b"], **names)

    before = parts(made())
    what = data.draw(st.sampled_from([*arrays, *names, "discount"]))
    action = data.draw(st.integers(0, 1))
    expected = {
        "T": f"transition function of action {'cd'[action]!r}",
        "O": f"observation function of action {'cd'[action]!r}",
        "R": "reward function",
        "b": "initial belief",
        "states": "list of states",
        "observation_names": "list of observations",
        "discount": "discount",
    }
    if what in {"T", "O"}:
        arrays[what][action, 0] += [2**-30, -(2**-30)]
    elif what in arrays:
        arrays[what].reshape(-1, 2)[0] += [2**-30, -(2**-30)]
    elif what in names:
        names[what] = [names[what][0], "other"]
    after = parts(made(0.8 if what == "discount" else 0.9))
    if what == "actions":
        assert after["list of actions"] != before["list of actions"]
    else:
        assert {name for name in before if after[name] != before[name]} == {expected[what]}


@given(model=flat_models(events=True, finer=False) | factored_models(events=True))
def test_parts_are_few_and_differ_where_digests_do(model):
    other = model.with_discount(0.3 if model.discount != 0.3 else 0.4)
    assert {name for name, part in parts(model).items() if parts(other)[name] != part} == {"discount"}
    assert len(parts(model)) < 80
    assert max(map(len, parts(model).values())) < 80


def test_a_model_of_many_actions_has_one_part_for_all():
    def made(last):
        transitions = [np.eye(2)] * 99 + [last]
        return MDP(transitions, np.zeros((2, 100)), discount=0.9)

    one, other = parts(made(np.eye(2))), parts(made(np.full((2, 2), 0.5)))
    assert len(one) < 10
    assert {name for name in one if one[name] != other[name]} == {"transition function"}


def test_another_process_finds_the_same():
    program = "from mdm.models.digest import digest; from mdm.problems import tiger; print(digest(tiger()))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == digest(tiger())


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ([np.zeros(2)], [np.zeros((1, 2))]),
        ([np.zeros(2)], [np.zeros(2, dtype=np.float32)]),
        ([np.zeros(2)], [np.zeros(1), np.zeros(1)]),
        ([sparse.csr_array(np.eye(2))], [np.eye(2)]),
        ([sparse.csr_array((2, 3))], [sparse.csr_array((2, 4))]),
        ([None], [0]),
        (["a", "b"], ["ab"]),
        ([["a"], "b"], [["a", "b"]]),
    ],
)
def test_parts_of_other_kinds_and_shapes_differ(one, other):
    assert of_parts(one) == of_parts(one)
    assert of_parts(one) != of_parts(other)


def test_the_layout_of_a_matrix_makes_no_difference():
    matrix = np.array([[0, 2.0], [1, 0]])
    assert of_parts([sparse.csr_array(matrix)]) == of_parts([sparse.csc_array(matrix)])
    assert of_parts([matrix]) == of_parts([np.asfortranarray(matrix)])


def test_bytes_alone_have_the_digest_that_they_have_among_parts():
    for size in (0, 1, 200, 300, 70_000):  # whose lengths msgpack writes in one, two and four bytes
        assert of_bytes(bytes(size)) == of_parts([bytes(size)])
