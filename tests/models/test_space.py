from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm.errors import ModelError
from mdm.models import Factor, Space

shapes = st.lists(st.integers(1, 5), min_size=1, max_size=4)


def space_of(shape):
    return Space(Factor(f"f{i}", size, prefix="x") for i, size in enumerate(shape))


@given(shapes, st.data())
def test_ravel_and_unravel_are_those_of_numpy(shape, data):
    space = space_of(shape)
    components = tuple(data.draw(st.integers(0, size - 1)) for size in shape)
    index = int(np.ravel_multi_index(components, shape))
    assert space.ravel(components) == index
    assert space.unravel(index) == components
    assert len(space) == np.prod(shape)


@given(shapes)
def test_every_name_leads_back_to_its_index(shape):
    space = space_of(shape)
    assert [space.index(name) for name in space.names] == list(range(len(space)))
    assert [space.index(space.names[i].split()) for i in range(len(space))] == list(range(len(space)))
    assert len(set(space.names)) == len(space)


def test_a_huge_joint_space_costs_no_more_than_its_factors():
    space = Space(Factor(f"f{i}", 1000) for i in range(4))
    assert len(space) == 10**12
    assert space.names[10**12 - 1] == "999 999 999 999"


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: s.index("lisen hear"), r"'first' has no symbol 'lisen'; did you mean 'listen'"),
        (lambda s: s.index("listen"), "a component for each of first, second"),
        (lambda s: s.index(4), "no symbol 4; the 4 symbols count from 0"),
        (lambda s: s.index(-1), "no symbol -1"),
        (lambda s: s.unravel(4), "no symbol 4"),
        (lambda s: s.ravel((0, 2)), "'second' has no symbol 2"),
        (lambda s: s.ravel((0,)), "2 components, not 1"),
    ],
)
def test_wrong_symbols_are_named(call, message):
    space = Space([Factor("first", ["listen", "open"]), Factor("second", ["hear", "nothing"])])
    with pytest.raises(ModelError, match=message):
        call(space)


def test_names_must_differ():
    with refused(ModelError):
        Factor("agent", ["a", "b", "a"])


@pytest.mark.parametrize("names", [[2, 1, 0], ["a", None], [b"a", "b"]])
def test_names_are_texts(names):
    with refused(ModelError):
        Factor("state", names)
    assert Factor("state", np.array(["a", "b"])).index("b") == 1


def test_an_index_may_stand_for_a_name():
    assert Space.single("state", ["left", "right"]).index("1") == 1


def test_an_index_may_be_a_number_of_numpy():
    index = Space.single("state", ["left", "right"]).index(np.int64(1))
    assert (index, type(index)) == (1, int)
    with refused(ModelError):
        Space.single("state", ["left", "right"]).index(np.int64(2))


def test_names_that_hold_blanks_are_given_one_by_one():
    space = Space([Factor("place", ["Room A", "Room B"]), Factor("fire", ["no fire", "fire"])])
    assert space.index(("Room B", "no fire")) == 2
    assert space.names[2] == "Room B no fire"


@given(st.integers(1, 300), st.sampled_from(["", "s", "agent", "1", "s0"]))
def test_counted_names_are_as_if_they_were_listed(count, prefix):
    counted, listed = Factor("x", count, prefix=prefix), Factor("x", [f"{prefix}{i}" for i in range(count)])
    assert counted == listed
    assert hash(counted) == hash(listed)
    assert list(counted.names) == list(listed.names)
    assert counted.names == listed.names
    assert counted.names[1:3] == listed.names[1:3]
    assert (counted.names[-1], repr(counted.names)) == (listed.names[-1], repr(listed.names))
    for symbol in (*listed.names, *range(count), *map(str, range(count))):
        assert counted.index(symbol) == listed.index(symbol)
    for symbol in (f"{prefix}{count}", f"{prefix}00", f"{prefix}-1", prefix + "x", count, "²"):
        if symbol in listed.names:
            continue
        assert symbol not in counted.names
        try:
            expected = listed.index(symbol)
        except ModelError:
            with pytest.raises(ModelError):
                counted.index(symbol)
        else:
            assert counted.index(symbol) == expected


def test_a_million_counted_names_cost_nothing():
    factor = Factor("x", 10**9, prefix="s")
    assert factor.index("s999999999") == 999_999_999
    assert factor.names[123456789] == "s123456789"
