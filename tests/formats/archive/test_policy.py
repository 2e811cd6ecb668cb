"""Archives of policies: the names of their model, and archives of other things."""

from __future__ import annotations

import numpy as np
import pytest
from random_policies import assert_same
from sentences import refused

from mdm import FormatError, ModelError
from mdm.formats import files as policies
from mdm.formats.archive import policy as policy_archive
from mdm.models import POMDP, Factor, Space
from mdm.policies import (
    AlphaVectors,
)


def model(states=("left", "right"), actions=("listen", "open"), observations=("low", "high")):
    return POMDP(
        [np.eye(len(states))] * len(actions),
        np.full((len(actions), len(states), len(observations)), 1 / len(observations)),
        np.zeros((len(states), len(actions))),
        discount=0.9,
        states=states,
        actions=actions,
        observation_names=observations,
    )


POLICY = AlphaVectors([[1, 2], [2, 1]], [0, 1])


def test_an_archive_knows_the_names_of_its_model(tmp_path):
    path = tmp_path / "x.npz"
    policies.save_policy(POLICY, path, model())
    assert_same(policies.load_policy(path), POLICY)
    assert_same(policies.load_policy(path, model()), POLICY)
    for other, words in [
        (model(actions=("listen", "wait")), "action 1 is 'open' in the policy's model, but 'wait' in this one"),
        (model(states=("right", "left")), "state 0 is 'left' in the policy's model, but 'right'"),
        (model(observations=("low", "loud")), "observation 1 is 'high'"),
        (model(observations=("low", "high", "loud")), "a model of 2 observations, but this one has 3"),
        (model(states=("left", "right", "middle")), "for 2 states, but the model has 3"),
    ]:
        with pytest.raises(FormatError) as caught:
            policies.load_policy(path, other)
        assert words in str(caught.value)
        assert str(path) in str(caught.value)


def test_an_archive_without_names_is_checked_by_size(tmp_path):
    policies.save_policy(POLICY, tmp_path / "x.npz")
    assert_same(policies.load_policy(tmp_path / "x.npz", model()), POLICY)
    with refused(FormatError):
        policies.load_policy(tmp_path / "x.npz", model(states=3 * ("x",) and ("a", "b", "c")))


def test_joint_names_may_be_factored_otherwise(tmp_path):
    space = Space([Factor("first", ["a", "b"]), Factor("second", ["c"])])
    policies.save_policy(POLICY, tmp_path / "x.npz", model(states=space))
    assert_same(policies.load_policy(tmp_path / "x.npz", model(states=["a c", "b c"])), POLICY)
    with refused(FormatError):
        policies.load_policy(tmp_path / "x.npz", model(states=["a c", "b d"]))


def test_other_archives_of_numpy_are_refused(tmp_path):
    path = tmp_path / "x.npz"
    np.savez(path, a=np.ones(3))
    with refused(FormatError):
        policies.load_policy(path)
    np.savez_compressed(path, header=np.zeros(10**6))
    with refused(FormatError):
        policies.load_policy(path)
    np.savez(path, header=np.array([{"a": 1}], dtype=object))
    with refused(FormatError):
        policies.load_policy(path)
    np.savez(path, header=np.frombuffer(b'{"kind": "alpha"}', np.uint8))
    with refused(FormatError):
        policies.load_policy(path)
    for text, words in [
        (b'{"kind": "magic", "sizes": {}}', "the kind of policy 'magic' is unknown"),
        (b'{"kind": "alpha", "sizes": {"actions": 99999999999}}', "a size is not"),
        (b'{"kind": "alpha", "sizes": {"actions": -1}}', "a size is not"),
        (b'{"kind": "alpha", "sizes": {"actions": 2}}', "'vectors' is missing"),
        (b'{"kind": "alpha", "sizes": {}, "format": "mdm policy 9"}', "format"),
    ]:
        np.savez(path, header=np.frombuffer(text, np.uint8))
        with pytest.raises(FormatError) as caught:
            policies.load_policy(path)
        assert words in str(caught.value)


def test_numpy_reads_an_archive_without_pickle(tmp_path):
    policies.save_policy(POLICY, tmp_path / "x.npz", model())
    with np.load(tmp_path / "x.npz", allow_pickle=False) as archive:
        assert archive["vectors"].tolist() == [[1, 2], [2, 1]]
        assert b'"left","right"' in archive["header"].tobytes()


def test_a_policy_of_other_sizes_is_not_written(tmp_path):
    for write in (policies.save_policy, policy_archive.write):
        with refused(ModelError):
            write(POLICY, tmp_path / "x.npz", model(states=("a", "b", "c")))
    assert not (tmp_path / "x.npz").exists()
