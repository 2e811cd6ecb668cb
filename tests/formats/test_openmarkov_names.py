"""Names of variables and values are such that MADP finds each, and none for another."""

from __future__ import annotations

import warnings

import numpy as np
from hypothesis import given, strategies as st
from sentences import refused
from strict import pgmx as strict
from strict.numbers import RefusedError, assert_same_numbers

from mdm.errors import ModelWarning
from mdm.formats import openmarkov as pgmx
from mdm.formats.openmarkov import Names
from mdm.models import POMDP, Factor, Space

CLASHING = [
    "a", "aa", "ab", "alice", "alice_2", "alice_2_2", "bob", "a_", "reward0", "reward1", "informed1", "room[1]", "x]",
    "]", "[0]", "a [0]", "a [1]", "it's", 'say "no"', "'", "é", "b a",
]  # fmt: skip
TITLES = st.lists(st.sampled_from(CLASHING), min_size=2, max_size=2, unique=True)


def random_rows(random, *shape):
    rows = random.random(shape) + 0.1
    return rows / rows.sum(axis=-1, keepdims=True)


def team(states, actions, observations, names=("p", "q")):
    """Return a model whose factors have these names, and whose agents see each for itself."""
    random = np.random.default_rng(3)
    start = np.multiply.outer(random_rows(random, 2), random_rows(random, 2)).ravel()
    seen = np.einsum("na,nb->nab", random_rows(random, 4, 2), random_rows(random, 4, 2)).reshape(4, 4)
    return POMDP(
        list(random_rows(random, 4, 4, 4)),
        [seen] * 4,
        random.normal(size=(4, 4)),
        discount=0.9,
        states=Space(Factor(name, names) for name in states),
        actions=Space(Factor(name, names) for name in actions),
        observation_names=Space(Factor(name, names) for name in observations),
        initial_belief=start,
    )


def written(model, folder):
    with warnings.catch_warnings():
        warnings.filterwarnings("error", ".*MADP", ModelWarning)
        warnings.filterwarnings("ignore", ".*names not allowed", ModelWarning)
        pgmx.write(model, folder / "m.pgmx")
    return folder / "m.pgmx"


@given(states=TITLES, actions=TITLES, observations=TITLES)
def test_no_name_is_taken_for_another(states, actions, observations, tmp_path_factory):
    model = team(states, actions, observations)
    assert_same_numbers(strict.read(written(model, tmp_path_factory.mktemp("names"))), model)


@given(names=TITLES)
def test_no_value_is_taken_for_another(names, tmp_path_factory):
    model = team(["s", "t"], ["u", "v"], ["w", "x"], names)
    assert_same_numbers(strict.read(written(model, tmp_path_factory.mktemp("names"))), model)


def test_observations_of_one_letter_get_another_beside_a_slice(tmp_path):
    """MADP looks for an observation by its name and slice, and finds none of one letter, after which a blank stays."""
    text = written(team(["alice", "bob"], ["alice", "bob"], ["x", "y"]), tmp_path).read_text()
    assert '<Variable name="x_ [1]"' in text
    assert '<Variable name="alice_2 [0]" timeSlice="0" type="finiteStates" role="decision">' in text
    with refused(RefusedError):
        strict.read(replaced(tmp_path, text, 'name="x_ ', 'name="x '))


def replaced(folder, text, before, after):
    path = folder / "other.pgmx"
    path.write_text(text.replace(before, after))
    return path


def test_the_start_of_a_factor_is_before_those_of_names_that_it_begins(tmp_path):
    path = written(team(["door2", "door"], ["u", "v"], ["see", "hear"]), tmp_path)
    starts = [line for line in path.read_text().splitlines() if line.startswith("<Potential ")][-3:-1]
    assert ['name="door [0]"' in line for line in starts] == [True, False]


def test_names_keep_what_madp_reads():
    names = Names(["robot", "two words", "<&>", "x[1]y", "it's", "room[1]"], range(0))
    assert names.variables == ["robot", "two words", "<&>", "x_y", "it_s", "room_1_"]
    assert names.values(["it's", "a[b]", "]"]) == ["it's", "a_b_", "_"]
    assert names.of("robot", 1) == "robot"
    assert Names(["robot", "robot"], range(0)).of("robot", 1) == "robot [1]"
