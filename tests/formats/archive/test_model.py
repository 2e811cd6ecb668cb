"""Archives of models: round trips, memory maps, damage."""

from __future__ import annotations

import contextlib
import mmap
import random
import warnings
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from random_models import NAMES, assert_same, dense, flat_models
from scipy import sparse
from sentences import refused

from mdm import FormatError, ModelError, load_model, load_policy
from mdm.errors import ModelWarning
from mdm.formats.archive import model as archive, npz
from mdm.formats.files import save_model, save_policy
from mdm.models import MDP, POMDP
from mdm.policies import AlphaVectors


@settings(max_examples=20)
@given(model=flat_models(names=NAMES, events=True), kind=st.sampled_from([None, True, False]))
def test_flat_models_come_back_bit_for_bit(model, kind, tmp_path_factory):
    path = tmp_path_factory.mktemp("round") / "model.npz"
    archive.write(model, path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        again = load_model(path, sparse=kind)
    assert again.is_sparse == (model.is_sparse if kind is None else kind)
    assert again.state_space == model.state_space
    assert again.action_space == model.action_space
    assert_same(model, again, within=0 if kind is None else 1e-15, finer=True)
    again.with_discount(0.5)


def large(states=300):
    random_ = np.random.default_rng(1)
    transition = sparse.random_array((states, states), density=0.02, rng=random_, format="csr") + sparse.eye_array(
        states
    )
    transition = sparse.csr_array(transition / transition.sum(axis=1)[:, None])
    return POMDP(
        [transition, transition],
        [np.full((states, 2), 0.5)] * 2,
        random_.random((states, 2)),
        discount=0.9,
        sparse=True,
    )


def test_matrices_are_mapped_and_shared(tmp_path):
    model = large()
    archive.write(model, tmp_path / "m.npz")
    again = load_model(tmp_path / "m.npz")
    assert again.transition_matrix(0) is again.transition_matrix(1)
    data = again.transition_matrix(0).data
    while isinstance(data, np.ndarray):
        assert not data.flags.writeable
        assert data.flags.aligned
        data = data.base
    assert isinstance(data.obj, mmap.mmap)
    with zipfile.ZipFile(tmp_path / "m.npz") as stored:
        assert sum(name.startswith("T") for name in stored.namelist()) == 3


def test_numpy_reads_it_too(tmp_path):
    model = MDP([np.eye(3)], [[1.0], [2.0], [4.0]], discount=0.9)
    archive.write(model, tmp_path / "m.npz")
    with np.load(tmp_path / "m.npz") as stored:
        np.testing.assert_array_equal(stored["T0"], np.eye(3))
        np.testing.assert_array_equal(stored["rewards"], model.rewards)


def test_the_same_model_makes_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        archive.write(large(), tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert isinstance(load_model(tmp_path / "a"), POMDP)  # told by its content, whatever its name


def test_policies_and_models_are_told_apart(tmp_path):
    archive.write(large(), tmp_path / "model.npz")
    save_policy(AlphaVectors([[1.0, 2.0]], [0], 1), tmp_path / "policy.npz")
    assert [npz.kind(tmp_path / f"{held}.npz") for held in ("model", "policy")] == ["model", "policy"]
    with refused(FormatError):
        load_model(tmp_path / "policy.npz")
    with refused(FormatError):
        load_policy(tmp_path / "model.npz")


def rewritten(path, change):
    """Write an archive anew with other arrays."""
    header, arrays = npz.read(path)
    arrays = {name: array.copy() for name, array in arrays.items()}
    change(arrays)
    import msgspec

    npz.write(path, msgspec.Raw(header), arrays)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a["T0.indices"].__setitem__(0, 10**6), "beyond its 300 columns"),
        (lambda a: a["T0.indices"].__setitem__(0, -1), "beyond its 300 columns"),
        (lambda a: a["T0.starts"].__setitem__(1, 10**6), "the row starts of"),
        (lambda a: a["T0.indices"].__setitem__(slice(0, 2), [5, 5]), "are not sorted"),
        (lambda a: a["T0.data"].__setitem__(0, np.nan), "not a distribution"),
        (lambda a: a["T0.data"].__setitem__(0, -1.0), "not a distribution"),
        (lambda a: a["T0.data"].__setitem__(0, a["T0.data"][0] / 2), "not a distribution"),
        (lambda a: a.__setitem__("T0.data", a["T0.data"][:-1]), "not a matrix of 300 rows"),
        (lambda a: a.__setitem__("O0.starts", a["O0.starts"][:-1]), "not a matrix of 300 rows"),
        (lambda a: a.__setitem__("rewards", a["rewards"][:-1]), "have the shape"),
        (lambda a: a.pop("rewards"), "'rewards' is missing"),
        (lambda a: a.__setitem__("initial", a["initial"] * 2), "sums to 2"),
        (lambda a: a.__setitem__("rewards", a["rewards"].astype(int)), "not float64"),
    ],
)
def test_wrong_numbers_are_refused(tmp_path, change, message):
    archive.write(large(), tmp_path / "m.npz")
    rewritten(tmp_path / "m.npz", change)
    with pytest.raises(FormatError, match=message):
        load_model(tmp_path / "m.npz")


@given(seed=st.integers(0, 2**32 - 1))
def test_damaged_files_make_a_model_or_an_error(seed, tmp_path_factory):
    chance = random.Random(seed)
    folder = tmp_path_factory.mktemp("damaged")
    archive.write(large(4), folder / "m.npz")
    data = bytearray((folder / "m.npz").read_bytes())
    for _ in range(chance.randint(1, 3)):
        at = chance.randrange(len(data))
        if chance.random() < 0.2:
            del data[at:]
        else:
            data[at : at + chance.choice([1, 1, 4])] = chance.randbytes(chance.choice([0, 1, 4]))
        if not data:
            break
    (folder / "m.npz").write_bytes(data)
    with contextlib.suppress(FormatError), warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        model = load_model(folder / "m.npz")
        for action in range(len(model.action_space)):
            np.testing.assert_allclose(dense(model.transition_matrix(action)).sum(axis=1), 1)


def test_the_false_negative_is_kept(tmp_path):
    model = POMDP([np.eye(2)], [np.eye(2)], np.eye(2)[:, :1], discount=0.5).with_false_negatives(1)
    archive.write(model, tmp_path / "m.npz")
    assert load_model(tmp_path / "m.npz").false_negative == 1
    with refused(ModelError):
        save_model(model, tmp_path / "m.pomdp")
    save_model(model.with_false_negatives(None), tmp_path / "m.pomdp")
