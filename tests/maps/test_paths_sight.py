"""Sight, in rooms where it is plain."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies as st

from mdm.maps.paths import seen_from, sees


@given(st.integers(1, 40), st.integers(1, 40), st.data())
def test_in_an_empty_room_all_is_seen(rows, columns, data):
    cell = data.draw(st.integers(0, rows - 1)), data.draw(st.integers(0, columns - 1))
    assert seen_from(np.ones((rows, columns), dtype=bool), cell).all()


def test_nothing_is_seen_through_a_wall_but_through_its_gap():
    room = np.ones((21, 41), dtype=bool)
    room[:, 20] = False
    assert not seen_from(room, (10, 5))[:, 20:].any()
    room[10, 20] = True
    seen = seen_from(room, (10, 5))
    assert seen[10].all()
    assert not seen[:7, 21:].any()
    assert not seen[14:, 21:].any()


@given(st.integers(2, 12), st.integers(2, 12), st.randoms(use_true_random=False))
def test_only_open_cells_that_can_be_reached_are_seen(rows, columns, random):
    room = np.array([[random.random() < 0.7 for _ in range(columns)] for _ in range(rows)])
    room[0, 0] = True
    seen = seen_from(room, (0, 0))
    assert seen[0, 0]
    assert not (seen & ~room).any()


@given(st.integers(1, 12), st.integers(1, 12), st.data())
def test_a_line_crosses_the_cells_that_lie_on_it(rows, columns, data):
    room = np.ones((rows, columns), dtype=bool)
    ends = [(data.draw(st.integers(0, rows - 1)), data.draw(st.integers(0, columns - 1))) for _ in range(2)]
    assert sees(room, *ends)
    middle = round((ends[0][0] + ends[1][0]) / 2 + 1e-9), round((ends[0][1] + ends[1][1]) / 2 + 1e-9)
    exact = all((one + other) % 2 == 0 for one, other in zip(*ends, strict=True))
    if exact:
        room[middle] = False
        assert not sees(room, *ends)
        assert not sees(room, *ends[::-1])
