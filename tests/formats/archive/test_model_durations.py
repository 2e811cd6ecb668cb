"""Archives of durations: every form as it was, and archives of other things."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from sentences import refused

import mdm
from mdm import FormatError
from mdm.formats import load_durations, save_durations
from mdm.formats.archive.npz import kind
from mdm.models import Durations


@given(
    means=arrays(float, st.sampled_from([(), (2,), (3, 2)]), elements=st.floats(1e-3, 1e6)),
    stages=arrays(float, st.sampled_from([(), (2,), (3, 2)]), elements=st.integers(1, 50)),
)
def test_what_was_written_is_read(tmp_path_factory, means, stages):
    path = tmp_path_factory.mktemp("durations") / "x.npz"
    save_durations(Durations(means, stages), path)
    read = load_durations(path)
    assert (read.means.tolist(), read.stages.tolist()) == (means.tolist(), stages.tolist())
    assert read.means.shape == means.shape


def test_equal_durations_give_equal_bytes_which_damage_changes(tmp_path):
    path = tmp_path / "x.npz"
    save_durations(Durations([1.0, 2.0]), path)
    content = path.read_bytes()
    save_durations(Durations([1.0, 2.0]), path)
    assert path.read_bytes() == content
    place = content.index(np.float64(2.0).tobytes())
    path.write_bytes(content[:place] + np.float64(3.0).tobytes() + content[place + 8 :])
    with refused(FormatError):
        load_durations(path)


def test_archives_of_other_things_are_told(tmp_path):
    model, policy, durations = (tmp_path / f"{name}.npz" for name in ("model", "policy", "durations"))
    mdm.save_model(mdm.problems.tiger(), model)
    mdm.save_policy(mdm.policies.QTable(np.zeros((2, 3))), policy)
    save_durations(Durations(1.0), durations)
    assert [kind(path) for path in (model, policy, durations)] == ["model", "policy", "durations"]
    for load, path, words in [
        (load_durations, model, "does not hold durations: it is a model"),
        (load_durations, policy, "does not hold durations: it is a policy"),
        (mdm.load_model, durations, "does not hold a model: it holds durations"),
        (mdm.load_policy, durations, "does not hold a policy: it holds durations"),
    ]:
        with pytest.raises(FormatError, match=words):
            load(path)


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"header": b"{}"}, "it holds something else"),
        ({"header": b'{"format": "mdm durations 9"}'}, "format"),
        ({"header": b'{"format": "mdm durations 1"}', "means": [1.0]}, "'stages' is missing"),
        ({"header": b'{"format": "mdm durations 1"}', "means": [-1.0], "stages": [1.0]}, "a duration is -1"),
        ({"header": b'{"format": "mdm durations 1"}', "means": [1.0], "stages": [0.5]}, "whole numbers from 1"),
        ({"header": b'{"format": "mdm durations 1"}', "means": np.ones((1, 1, 1)), "stages": [1.0]}, "S x A numbers"),
        ({"header": b'{"format": "mdm durations 1"}', "means": np.ones((0, 2)), "stages": [1.0]}, "none"),
    ],
)
def test_bad_archives(tmp_path, arrays, words):
    path = tmp_path / "x.npz"
    np.savez(path, header=np.frombuffer(arrays.pop("header"), np.uint8), **arrays)
    with pytest.raises(FormatError) as caught:
        load_durations(path)
    assert words in str(caught.value)
    assert str(path) in str(caught.value)
