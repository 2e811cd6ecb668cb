"""Archives as files: what is none, and what an array claims of itself."""

from __future__ import annotations

import zipfile

import numpy as np
import pytest

from mdm import FormatError, load_model
from mdm.formats import policies


def test_what_is_no_archive(tmp_path):
    cases = {"empty.npz": b"", "text.npz": b"hello", "cut.npz": b"PK\x03\x04", "cut.policy": b"PK\x03\x04 and so on"}
    for name, data in cases.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(FormatError, match=name):
            policies.load_policy(tmp_path / name)
    with pytest.raises(FormatError, match="no such file"):
        policies.load_policy(tmp_path / "none.npz")
    (tmp_path / "folder.npz").mkdir()
    with pytest.raises(FormatError, match="a folder"):
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
    with pytest.raises(FormatError, match="compressed"):
        load_model(tmp_path / "c.npz")
    np.savez(tmp_path / "p.npz", header=np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(FormatError, match="damaged|none of"):
        load_model(tmp_path / "p.npz")
    np.savez(tmp_path / "n.npz", numbers=np.zeros(3))
    with pytest.raises(FormatError, match="no header"):
        load_model(tmp_path / "n.npz")
