"""Statements in any order and form, against one that fills plain arrays entry by entry."""

from __future__ import annotations

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import sparse
from sentences import refused

from mdm import FormatError, load_model
from mdm.formats.cassandra import model as cassandra
from mdm.formats.cassandra.statements import Statements
from mdm.formats.madp import dpomdp
from mdm.formats.source import Source, Words
from mdm.models import Factor, Space

NAMES = ["T", "O", "R", "a", "b-2", "c_3", "states", "uniform2", "start"]


class Writer:
    """Draws statements, writes them down, and does to plain arrays what they say."""

    def __init__(self, data, *, team, mdp):
        self.data, self.team, self.mdp = data, team, mdp
        size = st.integers(1, 3)
        count = data.draw(st.integers(1, 3)) if team else 1
        names = [f"n{i}" for i in range(9)] if team else data.draw(st.permutations(NAMES))
        self.states = Space([Factor("state", names[: data.draw(size)])])
        self.actions = Space(Factor(f"agent{i}", names[: data.draw(size)]) for i in range(count))
        self.observations = Space(Factor(f"agent{i}", names[: data.draw(size)]) for i in range(count))
        states, actions, observations = map(len, (self.states, self.actions, self.observations))
        self.T = np.zeros((actions, states, states))
        self.O = np.zeros((actions, states, observations))
        self.R = np.zeros((actions, states, states, 1 if mdp else observations))
        self.lines = []

    def number(self, kind):
        whole = self.data.draw(st.integers(-4 if kind == "R" else 0, 4))
        return str(whole / 4) if whole % 4 else str(whole // 4)

    def symbol(self, space, *, wild):
        """Return how a symbol is written, and the joint indices that it stands for."""
        if wild:
            return "*", list(range(len(space)))
        index = self.data.draw(st.integers(0, len(space) - 1))
        if len(space.factors) > 1 and self.data.draw(st.booleans()):
            return str(index), [index]
        words, chosen = [], []
        for factor, component in zip(space.factors, space.unravel(index), strict=True):
            form = self.data.draw(st.integers(0, 3 if len(space.factors) > 1 else 2))
            words.append(str(component) if form == 0 else "*" if form == 3 else factor.names[component])
            chosen.append(range(len(factor)) if form == 3 else [component])
        return " ".join(words), [space.ravel(each) for each in product(*chosen)]

    def statement(self):
        kind = self.data.draw(st.sampled_from("TR" if self.mdp else "TOR"))
        array, spaces = {
            "T": (self.T, [self.actions, self.states, self.states]),
            "O": (self.O, [self.actions, self.states, self.observations]),
            "R": (self.R, [self.actions, self.states, self.states, self.observations]),
        }[kind]
        extra = kind == "R" and self.mdp and self.data.draw(st.booleans())
        spaces = spaces[:3] if kind == "R" and self.mdp else spaces
        least = 2 if kind == "R" and not self.mdp else 1
        named = self.data.draw(st.integers(least, len(spaces)) | st.just(len(spaces)))
        repeats = self.data.draw(st.sampled_from([1, 1, 5, 20])) if named == len(spaces) else 1
        colon = self.team or (named == len(spaces) and self.data.draw(st.integers(0, 4)) == 0)
        wild = self.data.draw(st.sets(st.integers(0, 3), max_size=2))
        for _ in range(repeats):
            self.write(kind, array, spaces, named, wild, colon=colon, extra=extra and named == len(spaces))

    def write(self, kind, array, spaces, named, wild, *, colon, extra):
        fields = [self.symbol(space, wild=place in wild) for place, space in enumerate(spaces[:named])]
        shape = tuple(map(len, spaces[named:]))
        word = self.data.draw(st.sampled_from(["uniform", "identity", "numbers", "numbers", "numbers"]))
        square = len(shape) == 2 and shape[0] == shape[1]
        if kind != "R" and shape and word == "uniform":
            values, text = np.full(shape, 1 / shape[-1]), word
        elif kind != "R" and square and word == "identity":
            values, text = np.eye(shape[0]), word
        else:
            numbers = [self.number(kind) for _ in range(int(np.prod(shape)))]
            values, text = np.array(numbers, dtype=float).reshape(shape), " ".join(numbers)
        blank = self.data.draw(st.sampled_from([" ", "\n", "  # said before\n"]))
        written = f"{kind}: " + " : ".join(field for field, _ in fields) + (" : *" if extra else "")
        self.lines.append(f"{written}{' :' if colon else ''}{blank}{text}")
        for indices in product(*(chosen for _, chosen in fields)):
            if kind == "R" and self.mdp:
                array[(*indices, ..., 0)] = values
            else:
                array[indices] = values

    def read(self, path):
        path.write_text("\n".join(self.lines) + "\n")
        source = Source(path)
        reader = object.__new__(dpomdp._Reader if self.team else cassandra._Reader)
        reader._words = Words(source)
        statements = Statements(
            reader._words,
            states=self.states,
            actions=self.actions,
            observations=None if self.mdp else self.observations,
            start=np.full(len(self.states), 1 / len(self.states)),
            sign=1.0,
            field=reader._field,
            colons=self.team,
        )
        statements.read(0)
        return statements


def stochastic(random, *shape):
    array = random.random(shape) * (random.random(shape) < 0.5)
    array[..., 0] += 0.01
    return array / array.sum(axis=-1, keepdims=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("statements")


@pytest.mark.parametrize("form", ["pomdp", "mdp", "team"])
@given(data=st.data())
def test_every_form_in_any_order_fills_what_it_says(folder, form, data):
    writer = Writer(data, team=form == "team", mdp=form == "mdp")
    for _ in range(data.draw(st.integers(1, 8))):
        writer.statement()
    found = writer.read(folder / form)
    for array, stack in ((writer.T, found.transitions), (writer.O, found.observations)):
        if stack is not None:
            for expected, matrix in zip(array, stack.matrices(), strict=True):
                np.testing.assert_allclose(matrix.toarray(), expected, rtol=1e-15)
                assert matrix.has_canonical_format
    random = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    transitions, observations = stochastic(random, *writer.T.shape), stochastic(random, *writer.O.shape)
    expected = (
        np.einsum("asn,asn->sa", transitions, writer.R[..., 0])
        if writer.mdp
        else np.einsum("asn,ano,asno->sa", transitions, observations, writer.R)
    )
    rewards = found.rewards.expected(
        [sparse.csr_array(t) for t in transitions],
        None if writer.mdp else [sparse.csr_array(o) for o in observations],
    )
    np.testing.assert_allclose(rewards, expected, atol=1e-12)
    outcomes = writer.R[..., 0] if writer.mdp else writer.R
    np.testing.assert_array_equal(found.rewards.array(outcomes.size), outcomes)
    assert found.rewards.array(outcomes.size - 1) is None
    for place in np.ndindex(outcomes.shape):
        assert found.rewards.at(*place, *([None] if writer.mdp else [])) == outcomes[place]
    if not found.rewards.finer:
        flat = outcomes.reshape(*outcomes.shape[:2], -1)
        assert (flat == flat[..., :1]).all()


HEAD = "discount: 0.9\nvalues: reward\nstates: {states}\nactions: 2\n"


def swap(states, *, then=""):
    """Write an MDP that goes round through its states, an entry a line."""
    lines = (f"T: {a} : {s} : {(s + 1) % states} 1\nR: {a} : {s} : * {s}\n" for a in range(2) for s in range(states))
    return HEAD.format(states=states) + "".join(lines) + then


@pytest.mark.parametrize("states", [15, 16, 17, 18, 63, 64, 65, 66, 700])
def test_blocks_of_every_length_are_read_to_their_end(tmp_path, states):
    path = tmp_path / "round.mdp"
    path.write_text(swap(states))
    model = load_model(path)
    for action in range(2):
        np.testing.assert_array_equal(model.transition_matrix(action), np.roll(np.eye(states), 1, axis=1))
        np.testing.assert_array_equal(model.rewards[:, action], np.arange(states))


@pytest.mark.parametrize(
    ("line", "message", "column"),
    [
        ("T: 1 : 30 : 99 1", "99", 13),
        ("T: 1 : 30 : 31 one", "'one'", 16),
        ("T: 1 : 30 : 31 -0.5", "-0.5 is not a probability", 16),
        ("T: 1 : 30 : 31 nan", "nan is not a probability", 16),
        ("T: 1 : 30 : 31 1_0", "'1_0'", 16),
        ("R: 1 : 30 : 31 inf", "inf is not a reward", 16),
        ("R: 1 : hell : 31 1", "'hell'", 8),
        ("T: 1 : 30 : 31 1 1", "a statement 'T:', 'O:' or 'R:' was expected, not '1'", 18),
    ],
)
def test_an_error_within_a_block_is_told_in_its_place(tmp_path, line, message, column):
    text = swap(60, then=f"{line}\n") + "".join(f"R: 0 : {s} : * 1\n" for s in range(60))
    path = tmp_path / "round.mdp"
    path.write_text(text)
    with pytest.raises(FormatError) as caught:
        load_model(path)
    assert (caught.value.line, caught.value.column) == (4 + 2 * 2 * 60 + 1, column)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("T: * : * : * 0.00001\n", "100000 x 100000"),
        ("T: * uniform\n", "exceeds the limit"),
        (HEAD.format(states=100_000).replace("actions: 2", "actions: 600") + "T: * identity\n", "exceed the limit"),
    ],
)
def test_what_no_memory_holds_is_refused_before_it_is_made(tmp_path, text, message):
    path = tmp_path / "large.mdp"
    path.write_text(text if text.startswith("discount") else HEAD.format(states=100_000) + text)
    with pytest.raises(FormatError, match=message):
        load_model(path)


def test_a_large_model_of_few_numbers_is_small(tmp_path):
    path = tmp_path / "large.pomdp"
    text = "observations: 3\nT: * identity\nT: 1 : 5\nreset\nO: * uniform\nR: * : 7 : * : 2 3\nR: 1 : 8 : 8 : * 4\n"
    path.write_text(HEAD.format(states=100_000).replace("actions", "start: 6\nactions") + text)
    model = load_model(path)
    assert model.is_sparse
    assert [model.transition_matrix(action).nnz for action in range(2)] == [100_000, 100_000]
    assert model.transition_matrix(1)[5, 6] == 1
    np.testing.assert_allclose(model.rewards[[7, 8]], [[1, 1], [0, 4]])
    assert np.count_nonzero(model.rewards) == 3


def test_names_are_told_from_words_that_stand_for_numbers(tmp_path):
    path = tmp_path / "words.pomdp"
    path.write_text(
        "discount: 1\nvalues: reward\nstates: identity b\nactions: T\nobservations: O R\n"
        "T: T : identity : b 1\nT: T : b : b 1\nO: T : * : O 1\nR: T : identity : b : O 5\nR: T : b : b : R 7\n"
    )
    model = load_model(path)
    np.testing.assert_array_equal(model.transition_matrix("T"), [[0, 1], [0, 1]])
    np.testing.assert_array_equal(model.rewards, [[5], [0]])


def test_no_observations_may_be_said_of_an_mdp():
    words = SimpleNamespace(
        words=["O", ":", "0", "uniform"], fail=lambda at, message: pytest.fail(message), report=lambda at: None
    )
    with refused(pytest.fail.Exception):
        Statements(
            words,
            states=Space.single("state", 2),
            actions=Space.single("agent", 2),
            observations=None,
            start=np.array([0.5, 0.5]),
            sign=1.0,
            field=lambda *_: None,
            colons=False,
        ).read(0)
