"""Archives as files: what is none, and what an array claims of itself."""

from __future__ import annotations

import random
import zipfile

import numpy as np
import pytest
from random_models import assert_same
from sentences import refused

from mdm import FormatError, load_model, save_model
from mdm.formats import files as policies
from mdm.models import POMDP


def test_what_is_no_archive(tmp_path):
    cases = {"empty.npz": b"", "text.npz": b"hello", "cut.npz": b"PK\x03\x04", "cut.policy": b"PK\x03\x04 and so on"}
    for name, data in cases.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(FormatError, match=name):
            policies.load_policy(tmp_path / name)
    with refused(FormatError):
        policies.load_policy(tmp_path / "none.npz")
    (tmp_path / "folder.npz").mkdir()
    with refused(FormatError):
        policies.load_policy(tmp_path / "folder.npz")


HEAD = "{'descr': '<f8', 'fortran_order': False, 'shape': (%s), }"


@pytest.mark.parametrize(
    ("head", "words"),
    [
        (HEAD % "1000000000000,", "size differs from its header"),
        (HEAD % "0, 99999999999999999999999", "damaged"),
        (HEAD % "2,", "size differs"),
        (HEAD.replace("<f8", "|O") % "1,", "not one of integers or floats"),
        ("__import__('os').abort()", "not one of integers or floats"),
    ],
)
def test_what_an_array_claims_is_not_believed(tmp_path, head, words):
    text = head.encode() + b"\n"
    data = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + (b"" if "0, 9" in head else b"\0" * 8)
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        archive.writestr("header.npy", data)
    with pytest.raises(FormatError) as caught:
        policies.load_policy(tmp_path / "x.npz")
    assert words in str(caught.value)


def test_compressed_and_pickled_archives_are_refused(tmp_path):
    np.savez_compressed(tmp_path / "c.npz", header=np.zeros(3))
    with refused(FormatError):
        load_model(tmp_path / "c.npz")
    np.savez(tmp_path / "p.npz", header=np.array([{}], dtype=object), allow_pickle=True)
    with refused(FormatError):
        load_model(tmp_path / "p.npz")
    np.savez(tmp_path / "n.npz", numbers=np.zeros(3))
    with refused(FormatError):
        load_model(tmp_path / "n.npz")


def test_each_flipped_bit_is_found_or_harmless(tmp_path):
    model = POMDP(
        [np.array([[0.25, 0.75], [1, 0]]), np.eye(2)], [np.eye(2)] * 2, [[1.0, 2.0], [3.0, 4.0]], discount=0.9
    )
    path = tmp_path / "m.npz"
    save_model(model, path)
    data = path.read_bytes()
    chance = random.Random(1)
    found = 0
    for bit in chance.sample(range(8 * len(data)), 600):
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << bit % 8
        path.write_bytes(flipped)
        try:
            assert_same(load_model(path), model, within=0)
        except FormatError:
            found += 1
    assert found > 200


def test_an_archive_without_a_digest_has_checksums(tmp_path):
    path = tmp_path / "m.npz"
    save_model(POMDP([np.eye(2)], [np.eye(2)], [[1.0], [2.0]], discount=0.9), path)
    with np.load(path) as stored:
        np.savez(path, **stored)
    assert load_model(path).rewards.tolist() == [[1], [2]]
    data = bytearray(path.read_bytes())
    data[data.index(np.float64(2).tobytes())] ^= 1
    path.write_bytes(data)
    with refused(FormatError):
        load_model(path)
