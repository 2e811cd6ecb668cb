"""Beliefs for the eye, against plain sums."""

from __future__ import annotations

from math import log2

import numpy as np
import pytest
from hypothesis import given, strategies as st

from mdm.beliefs import Support
from mdm.models import Factor, Space
from mdm.snapshots.beliefs import belief_frame, likeliest

SPACE = Space([Factor("x", 3), Factor("door", ["open", "shut"]), Factor("y", 4)])


@given(st.lists(st.floats(0, 1), min_size=24, max_size=24).filter(lambda values: sum(values) > 0.1), st.booleans())
def test_it_is_what_plain_sums_say(values, by_support):
    belief = np.array(values) / sum(values)
    states = np.flatnonzero(belief)
    frame = belief_frame(Support(states, belief[states]) if by_support else belief, SPACE)
    ranked = sorted(((chance, SPACE.names[state]) for state, chance in enumerate(belief) if chance), reverse=True)
    assert [chance for _, chance in frame.top] == pytest.approx([chance for chance, _ in ranked[:12]], abs=1e-6)
    assert frame.rest == pytest.approx(sum(chance for chance, _ in ranked[12:]), abs=1e-4)
    assert frame.entropy == pytest.approx(-sum(chance * log2(chance) for chance, _ in ranked), abs=1e-3)
    for place, marginal in enumerate(frame.marginals):
        for symbol, value in zip(marginal.symbols, marginal.values, strict=True):
            own = SPACE.factors[place].names.index(symbol)
            total = sum(chance for state, chance in enumerate(belief) if SPACE.unravel(state)[place] == own)
            assert value == pytest.approx(total, abs=1e-6)
    grid = frame.grid
    assert (grid.down, grid.across, grid.rows, grid.columns) == ("y", "x", 4, 3)
    for row in range(4):
        for column in range(3):
            cell = sum(belief[SPACE.ravel((column, door, row))] for door in range(2))
            assert grid.values[row * 3 + column] == pytest.approx(cell, abs=1e-6)


def test_a_large_belief_shows_its_likeliest_states_alone():
    belief = np.full(100_000, 0.5 / 99_999)
    belief[77_777] = 0.5
    frame = belief_frame(belief, Space.single("state", 100_000))
    assert frame.top[0] == ("77777", 0.5)
    assert len(frame.top) == 12
    assert frame.states == 100_000
    assert frame.rest == pytest.approx(0.5, abs=1e-3)
    assert frame.marginals == ()
    (upper, many, mass), most = frame.octaves
    assert upper / 2 <= 0.5 / 99_999 < upper
    assert (many, mass) == (99_999, pytest.approx(0.5))
    assert most == (1.0, 1, 0.5)


def test_a_factor_of_many_symbols_shows_the_likeliest_and_the_rest():
    belief = np.zeros(200)
    belief[:100:2] = 1 / 50
    (many, two) = belief_frame(belief, Space([Factor("place", 100), Factor("lit", 2)])).marginals
    assert len(many.symbols) == 24
    assert sum(many.values) + many.rest == pytest.approx(1.0)
    assert two.values == (1.0, 0.0)


@pytest.mark.parametrize(
    ("sizes", "shown"),
    [
        ({"row": 64, "column": 64}, ("row", "column", 64, 64)),  # 4,096 cells
        ({"X": 128, "lit": 2, "Y": 32}, ("Y", "X", 32, 128)),
        ({"row": 17, "column": 241}, None),  # 4,097
        ({"row": 241, "column": 17}, None),
        ({"row": 4, "lit": 2}, None),
        ({"lit": 2, "column": 4}, None),
    ],
)
def test_a_grid_has_rows_and_columns_and_at_most_4096_cells(sizes, shown):
    space = Space([Factor(name, size) for name, size in sizes.items()])
    belief = np.zeros(len(space))
    belief[-1] = 1.0
    frame = belief_frame(belief, space)
    assert [marginal.factor for marginal in frame.marginals] == list(sizes)
    grid = frame.grid
    assert (grid and (grid.down, grid.across, grid.rows, grid.columns)) == shown
    assert grid is None or grid.values == (*(0.0,) * (shown[2] * shown[3] - 1), 1.0)


@pytest.mark.parametrize("other", [None, 3, (1, 2), np.array([1, 2])])
def test_what_is_no_belief_is_none(other):
    assert belief_frame(other, None) is None


@given(st.lists(st.floats(0.01, 1), min_size=1, max_size=30))
def test_the_likeliest_state_is_that_of_numpy_dense_or_by_its_support(weights):
    belief = np.array(weights) / sum(weights)
    assert likeliest(belief) == (int(np.argmax(belief)), belief.max())
    support = Support(np.arange(len(weights)) * 7, belief)
    assert likeliest(support) == (7 * int(np.argmax(belief)), belief.max())
    assert likeliest(3) is None
    assert likeliest(np.zeros(20_000)) is None
