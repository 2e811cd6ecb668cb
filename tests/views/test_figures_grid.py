"""Pictures of policies over states."""

from __future__ import annotations

import numpy as np
import pytest
from drawn import grid
from places import TIGER, TIGER_VECTORS

from mdm import ModelError, load_model, load_policy
from mdm.models import MDP
from mdm.policies import DeterministicPolicy
from mdm.solvers import exact_values
from mdm.views.figures import action_colours, grid_figure

pytest.importorskip("matplotlib")


def test_a_grid_shows_values_and_actions(tmp_path):
    model, policy = grid(tmp_path)
    figure = grid_figure(model, policy, None, None)
    shown = np.asarray(figure.axes[0].images[0].get_array())
    values = exact_values(model, policy).reshape(3, 2, 4)
    np.testing.assert_allclose(shown, values[:, 1])  # the first state has its door shut
    assert figure.get_suptitle() == "where door = shut"
    names = [text.get_text() for text in figure.axes[1].texts]
    assert names == [str(action) for action in np.array(policy.actions).reshape(3, 2, 4)[:, 1].ravel()]
    turned = grid_figure(model, policy, ["column", "door"], None)
    np.testing.assert_allclose(np.asarray(turned.axes[0].images[0].get_array()), values[0].T)
    rows = grid_figure(model, policy, None, 7)
    shown = np.asarray(rows.axes[0].images[0].get_array(), dtype=float)
    np.testing.assert_allclose(shown.ravel()[:24], values.ravel())
    assert shown.shape == (4, 7)


def test_a_policy_over_beliefs_is_shown_where_the_state_is_known():
    model = load_model(TIGER)
    figure = grid_figure(model, load_policy(TIGER_VECTORS, model), None, 2)
    assert [text.get_text() for text in figure.axes[1].get_legend().get_texts()] == ["open-left", "open-right"]
    vectors = load_policy(TIGER_VECTORS).vectors
    np.testing.assert_allclose(np.asarray(figure.axes[0].images[0].get_array()), [vectors.max(axis=0)])


def test_each_action_has_a_colour_of_its_own():
    model = load_model(TIGER)
    colours, handles = action_colours(model, [0, 2])
    assert list(colours) == [0, 2]
    assert colours[0] != colours[2]
    assert [handle.get_label() for handle in handles] == ["listen", "open-right"]


@pytest.mark.parametrize(
    ("axes", "words"),
    [(["row", "window"], "no factor 'window'; there are row, door, column"), (["row", "row"], "not 'row' twice")],
)
def test_axes_that_are_no_two_factors_are_refused(tmp_path, axes, words):
    with pytest.raises(ModelError, match=words):
        grid_figure(*grid(tmp_path), axes, None)


def test_names_of_actions_stand_where_there_is_room():
    def names(width):
        model = MDP([np.eye(2 * width)] * 2, np.ones((2 * width, 2)), discount=0.5, actions=["GoToTheOffice", "up"])
        policy = DeterministicPolicy([0] * width + [1] * width, 2)
        return [text.get_text() for text in grid_figure(model, policy, None, width).axes[1].texts]

    assert names(2) == ["GoToTheOffice"] * 2 + ["↑"] * 2
    assert names(15) == ["↑"] * 15
    assert names(200) == []
