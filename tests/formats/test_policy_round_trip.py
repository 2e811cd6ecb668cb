"""Whatever is written is read again, number by number; archives know their model; damage is told."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from mdm import FormatError, ModelError
from mdm.formats import policies
from mdm.formats.archive import packing, policy as policy_archive
from mdm.formats.tables import q_table, ublas
from mdm.formats.vectors import zmdp
from mdm.models import POMDP, Factor, Space
from mdm.policies import (
    AlphaVectors,
    DeterministicPolicy,
    FiniteStateController,
    JointController,
    MaskedAlphaVectors,
    MixedAlphaVectors,
    QTable,
    StochasticPolicy,
)


def floats(random, *shape):
    """Return numbers of all sizes, with no digits to spare."""
    return random.normal(size=shape) * 10.0 ** random.integers(-300, 300, size=shape)


def deterministic(random, count):
    return DeterministicPolicy(random.integers(4, size=count).tolist(), 4)


def stochastic(random, count):
    return StochasticPolicy(random.dirichlet(np.ones(3), size=count).T)


def q_values(random, count):
    return QTable(floats(random, count, 3) + 2)


def alpha(random, count):
    return AlphaVectors(floats(random, count, 3), random.integers(4, size=count).tolist())


def mixed(random, count):
    observed = [1, *random.integers(2, size=count).tolist()]
    actions = random.integers(4, size=len(observed)).tolist()
    return MixedAlphaVectors(floats(random, len(observed), 3), actions, observed)


def masked(random, count):
    states = [random.permutation(4)[: random.integers(1, 4)].tolist() for _ in range(count)]
    vectors = [dict(zip(own, floats(random, len(own)).tolist(), strict=True)) for own in states]
    return MaskedAlphaVectors(vectors, random.integers(4, size=count).tolist())


def controller(random, count):
    rows = random.integers(-1, count, size=(count, 2)).tolist()
    successors = [[None if node == -1 else node for node in row] for row in rows]
    values = floats(random, count, 3) if random.integers(2) else None
    return FiniteStateController(random.integers(4, size=count).tolist(), successors, values=values)


def joint(random, count):
    return JointController(controller(random, count) for _ in range(random.integers(1, 4)))


KINDS = [deterministic, stochastic, q_values, alpha, mixed, masked, controller, joint]
SUFFIXES = {
    deterministic: ["policy"],
    stochastic: ["policy"],
    q_values: ["policy"],
    alpha: ["alpha", "vf", "policy"],
    mixed: ["policy"],
    masked: ["policy"],
    controller: ["pg"],
    joint: [],
}
CASES = [(make, suffix) for make in KINDS for suffix in ["npz", *SUFFIXES[make]]]


def same(first, second):
    kind, sizes, arrays = packing.pack(first)
    other_kind, other_sizes, other_arrays = packing.pack(second)
    assert (kind, sizes) == (other_kind, other_sizes)
    assert arrays.keys() == other_arrays.keys()
    for name, array in arrays.items():
        assert array.dtype == other_arrays[name].dtype
        np.testing.assert_array_equal(array, other_arrays[name])


@pytest.mark.parametrize(("make", "suffix"), CASES)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 4))
def test_what_is_written_is_read(tmp_path_factory, make, suffix, seed, count):
    policy = make(np.random.default_rng(seed), count)
    path = tmp_path_factory.mktemp("round") / f"x.{suffix}"
    policies.save_policy(policy, path)
    kind = {deterministic: "table", stochastic: "stochastic", q_values: "q"}.get(make) if suffix == "policy" else None
    again = policies.load_policy(path, kind=kind)
    if make is deterministic and suffix == "policy":
        assert again.actions == policy.actions  # how many actions there are is the model's to say
    elif make is masked and suffix == "policy" and isinstance(again, AlphaVectors):
        assert [dict(enumerate(vector)) for vector in again.vectors.tolist()] == list(policy.vectors)
    else:
        same(again, policy)


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_tables_of_plain_rows_and_planes_of_all_states(tmp_path_factory, seed, count):
    random = np.random.default_rng(seed)
    folder = tmp_path_factory.mktemp("round")
    table, vectors = q_values(random, count), alpha(random, count)
    q_table.write(table, folder / "q")
    np.testing.assert_array_equal(q_table.read(folder / "q"), table.values)
    zmdp.write(vectors, folder / "z")
    same(policies.load_policy(folder / "z"), vectors)
    ublas.write(table.values, folder / "r")
    np.testing.assert_array_equal(policies.load_rewards(folder / "r"), table.values)


@pytest.mark.parametrize("make", KINDS)
def test_the_same_policy_gives_the_same_bytes(tmp_path, make):
    for name in ("a", "b"):
        policies.save_policy(make(np.random.default_rng(3), 3), tmp_path / f"{name}.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_draws_begin_with_the_seed(tmp_path):
    policies.save_policy(StochasticPolicy([[0.5], [0.5]]), tmp_path / "x.npz")
    first, second = (policies.load_policy(tmp_path / "x.npz", seed=7) for _ in range(2))
    draws = [first.action(0) for _ in range(20)]
    assert draws == [second.action(0) for _ in range(20)]
    assert set(draws) == {0, 1}


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
    same(policies.load_policy(path), POLICY)
    same(policies.load_policy(path, model()), POLICY)
    for other, words in [
        (model(actions=("listen", "wait")), "action 1 is 'open' in the policy's model, but 'wait' in this one"),
        (model(states=("right", "left")), "state 0 is 'left' in the policy's model, but 'right'"),
        (model(observations=("low", "loud")), "observation 1 is 'high'"),
        (model(observations=("low", "high", "loud")), "a model of 2 observations, but this one has 3"),
        (model(states=("left", "right", "middle")), "2 states and 2 actions, but the model has 3 and 2"),
    ]:
        with pytest.raises(FormatError) as caught:
            policies.load_policy(path, other)
        assert words in str(caught.value)
        assert str(path) in str(caught.value)


def test_an_archive_without_names_is_checked_by_size(tmp_path):
    policies.save_policy(POLICY, tmp_path / "x.npz")
    same(policies.load_policy(tmp_path / "x.npz", model()), POLICY)
    with pytest.raises(FormatError, match="the model has 3 and 2"):
        policies.load_policy(tmp_path / "x.npz", model(states=3 * ("x",) and ("a", "b", "c")))


def test_joint_names_may_be_factored_otherwise(tmp_path):
    space = Space([Factor("first", ["a", "b"]), Factor("second", ["c"])])
    policies.save_policy(POLICY, tmp_path / "x.npz", model(states=space))
    same(policies.load_policy(tmp_path / "x.npz", model(states=["a c", "b c"])), POLICY)
    with pytest.raises(FormatError, match="state 1 is 'b c' in the policy's model, but 'b d' in this one"):
        policies.load_policy(tmp_path / "x.npz", model(states=["a c", "b d"]))


def test_an_archive_is_told_by_its_content(tmp_path):
    policies.save_policy(POLICY, tmp_path / "x.npz")
    (tmp_path / "x.policy").write_bytes((tmp_path / "x.npz").read_bytes())
    same(policies.load_policy(tmp_path / "x.policy"), POLICY)


def test_a_kind_of_table_may_be_asked_of_an_archive(tmp_path):
    policies.save_policy(QTable([[1, 0]]), tmp_path / "x.npz")
    assert isinstance(policies.load_policy(tmp_path / "x.npz", kind="q"), QTable)
    with pytest.raises(FormatError, match="the archive holds QTable, but kind='stochastic' was asked for"):
        policies.load_policy(tmp_path / "x.npz", kind="stochastic")


@pytest.mark.parametrize(
    ("policy", "name", "words"),
    [
        (POLICY, "x.pg", "AlphaVectors cannot be written as 'x.pg'"),
        (DeterministicPolicy([0]), "x.alpha", "its files end in .npz, .policy"),
        (QTable([[1, 2]]), "x.vf", "QTable"),
        (FiniteStateController([0], [[0]]), "x.policy", "FiniteStateController"),
        (POLICY, "x.policy.gz", "'x.policy.gz'"),
        (POLICY, "x.pomdp", "its files end in .npz, .policy, .policyx, .alpha, .vf"),
        (POLICY, "x.png", "'x.png'"),
        (FiniteStateController([0], [[0]]), "x", "its files end in .npz, .pg"),
    ],
)
def test_a_form_that_cannot_hold_a_policy_is_refused(tmp_path, policy, name, words):
    with pytest.raises(ModelError) as caught:
        policies.save_policy(policy, tmp_path / name)
    assert words in str(caught.value)
    assert not (tmp_path / name).exists()


def test_a_policy_of_other_sizes_is_not_written(tmp_path):
    for write in (policies.save_policy, policy_archive.write):
        with pytest.raises(ModelError, match="2 states and 2 actions, but the model has 3 and 2"):
            write(POLICY, tmp_path / "x.npz", model(states=("a", "b", "c")))
    assert not (tmp_path / "x.npz").exists()


@pytest.mark.parametrize("name", ["x.npz", "x.policy"])
def test_where_nothing_can_be_written_is_said(tmp_path, name):
    with pytest.raises(FormatError, match="the file cannot be written: No such file"):
        policies.save_policy(POLICY, tmp_path / "none" / name)


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


def test_other_archives_of_numpy_are_refused(tmp_path):
    path = tmp_path / "x.npz"
    np.savez(path, a=np.ones(3))
    with pytest.raises(FormatError, match="it has no header"):
        policies.load_policy(path)
    np.savez_compressed(path, header=np.zeros(10**6))
    with pytest.raises(FormatError, match="compressed"):
        policies.load_policy(path)
    np.savez(path, header=np.array([{"a": 1}], dtype=object))
    with pytest.raises(FormatError, match="none of whole numbers or floats"):
        policies.load_policy(path)
    np.savez(path, header=np.frombuffer(b'{"kind": "alpha"}', np.uint8))
    with pytest.raises(FormatError, match="sizes"):
        policies.load_policy(path)
    for text, words in [
        (b'{"kind": "magic", "sizes": {}}', "'magic' is no kind of policy"),
        (b'{"kind": "alpha", "sizes": {"actions": 99999999999}}', "a size is not"),
        (b'{"kind": "alpha", "sizes": {"actions": -1}}', "a size is not"),
        (b'{"kind": "alpha", "sizes": {"actions": 2}}', "it has no 'vectors'"),
        (b'{"kind": "alpha", "sizes": {}, "format": "mdm policy 9"}', "format"),
    ]:
        np.savez(path, header=np.frombuffer(text, np.uint8))
        with pytest.raises(FormatError) as caught:
            policies.load_policy(path)
        assert words in str(caught.value)


HEAD = "{'descr': '<f8', 'fortran_order': False, 'shape': (%s), }"


@pytest.mark.parametrize(
    ("head", "words"),
    [
        (HEAD % "1000000000000,", "another size than its head says"),
        (HEAD % "0, 99999999999999999999999", "damaged"),
        (HEAD % "2,", "another size"),
        (HEAD.replace("<f8", "|O") % "1,", "none of whole numbers or floats"),
        ("__import__('os').abort()", "none of whole numbers or floats"),
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


def test_numpy_reads_an_archive_without_pickle(tmp_path):
    policies.save_policy(POLICY, tmp_path / "x.npz", model())
    with np.load(tmp_path / "x.npz", allow_pickle=False) as archive:
        assert archive["vectors"].tolist() == [[1, 2], [2, 1]]
        assert b'"left","right"' in archive["header"].tobytes()


def test_ublas_has_no_more_than_two_dimensions(tmp_path):
    with pytest.raises(ValueError, match="3 dimensions"):
        ublas.write(np.zeros((1, 1, 1)), Path(tmp_path / "x"))
