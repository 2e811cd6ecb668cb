from __future__ import annotations

import pytest

from mdm import ModelError, solve
from mdm.problems import grid_world


def test_the_textbook_s_values():
    published = {
        "row0": [0.812, 0.868, 0.918, 1.0],
        "row1": [0.762, None, 0.660, -1.0],
        "row2": [0.705, 0.655, 0.611, 0.388],
    }
    model = grid_world()
    solution = solve(model)
    for row, values in published.items():
        for column, value in enumerate(values):
            if value is not None:
                state = model.state_space.index(f"{row}-column{column}")
                assert solution.policy.value(state) == pytest.approx(value, abs=1e-3)


def test_entries():
    model = grid_world()
    assert model.transition("north", "row2-column0", "row1-column0") == 0.8
    assert model.transition("north", "row2-column0", "row2-column1") == pytest.approx(0.1)
    assert model.transition("north", "row2-column0", "row2-column0") == pytest.approx(0.1)
    assert model.transition("east", "row1-column0", "row1-column0") == pytest.approx(0.8)
    assert model.transition("east", "row0-column3", "end") == model.transition("east", "end", "end") == 1
    assert [model.reward("north", state) for state in ("row0-column3", "row1-column3", "row0-column0", "end")] == [
        1,
        -1,
        -0.04,
        0,
    ]
    assert model.initial_belief[model.state_space.index("row2-column0")] == 1


def test_a_straight_way():
    model = grid_world("...+", slip=0, step_reward=-1, goal_reward=10, discount=0.5)
    assert solve(model).policy.value(0) == pytest.approx(-1 - 0.5 - 0.25 + 10 / 8, abs=1e-3)
    assert model.initial_belief.tolist() == pytest.approx([1 / 3, 1 / 3, 1 / 3, 0, 0])


def test_a_large_world_is_sparse():
    model = grid_world("/".join(["." * 60] * 59 + ["." * 59 + "+"]))
    assert len(model.state_space) == 3601
    assert model.is_sparse
    assert model.transition("south", "row58-column59", "row59-column59") == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("layout", "settings", "words"),
    [("..x", {}, "'x'"), ("+-", {}, "to begin in"), (".+", {"slip": 1.5}, "a probability, not 1.5")],
)
def test_wrong_settings(layout, settings, words):
    with pytest.raises(ModelError, match=words):
        grid_world(layout, **settings)
