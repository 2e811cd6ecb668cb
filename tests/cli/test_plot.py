"""`mdm plot`: pictures that show what they should, and what cannot be drawn."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
from places import ROOT

from mdm import load_model, load_policy, save_model, save_policy
from mdm.models import MDP, Factor, Space
from mdm.policies import DeterministicPolicy
from mdm.solvers import exact_values

pytest.importorskip("matplotlib")

TIGER, VECTORS = ROOT / "examples" / "tiger.pomdp", ROOT / "examples" / "tiger.vf"


def history(path, *, solver="some"):
    entries = [{"seconds": 0.1 * (i + 1), "lower": -1 / (i + 1), "upper": None if i == 0 else 1 / i} for i in range(9)]
    path.write_text(json.dumps({"solver": solver, "history": entries}))
    return path


def grid(tmp_path):
    random = np.random.default_rng(1)
    space = Space([Factor("row", 3), Factor("door", ["open", "shut"]), Factor("column", 4)])
    model = MDP(
        random.dirichlet(np.ones(24), size=(2, 24)),
        random.normal(size=(24, 2)),
        discount=0.9,
        states=space,
        initial_belief=np.eye(24)[4],
    )
    policy = DeterministicPolicy(random.integers(2, size=24), 2)
    save_model(model, tmp_path / "grid.npz")
    save_policy(policy, tmp_path / "policy.npz", model)
    return model, policy


@pytest.mark.parametrize(
    "arguments",
    [
        ["policy", TIGER, VECTORS],
        ["policy", TIGER, VECTORS, "--states", "tiger-right", "tiger-left"],
        ["policy", TIGER, VECTORS, "--columns", "2"],
        ["belief", TIGER, VECTORS, "--seed", "3", "--steps", "40"],
    ],
)
def test_pictures_are_drawn(mdm, tmp_path, arguments):
    path = tmp_path / "picture.png"
    status, output, errors = mdm("plot", *arguments, "-o", path)
    assert (status, output, errors) == (0, [f"{path}: drawn"], "")
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.stat().st_size > 5000


def test_bounds_of_several_runs(mdm, tmp_path):
    from mdm.views.bounds import bounds_figure

    paths = [history(tmp_path / "a.json"), history(tmp_path / "b.json", solver="other")]
    assert mdm("plot", "bounds", *paths, "-o", tmp_path / "bounds.svg")[0] == 0
    figure = bounds_figure([str(path) for path in paths])
    assert [text.get_text() for text in figure.axes[0].get_legend().get_texts()] == ["a (some)", "b (other)"]
    lower, upper = figure.axes[0].lines[:2]
    assert list(lower.get_ydata()) == [-1 / (i + 1) for i in range(9)]
    assert len(upper.get_ydata()) == 8


def test_a_grid_shows_values_and_actions(tmp_path):
    from mdm.views.grid import grid_figure

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


def test_doubt_is_drawn_where_it_is():
    from mdm.views.belief import doubt_figure

    model = load_model(TIGER)
    policy = load_policy(VECTORS, model)
    axes = doubt_figure(model, policy, None, 0).axes[0]
    shares, values = axes.lines[-1].get_data()
    np.testing.assert_allclose(values, [policy.value(np.array([1 - share, share])) for share in shares])
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["listen", "open-left", "open-right"]


def test_a_belief_is_that_of_its_episode():
    from mdm import BeliefTracker
    from mdm.views.belief import belief_figure

    model = load_model(TIGER)
    policy = load_policy(VECTORS, model)
    axes = belief_figure(model, policy, 12, 5).axes[0]
    shown = np.asarray(axes.images[0].get_array())
    assert shown.shape == (2, 12)
    tracker, before = BeliefTracker(model), None
    for column, label in zip(shown.T, axes.get_xticklabels(), strict=True):
        seen, _, done = label.get_text().partition("→")
        if before is not None:
            tracker.update(before, model.observation_space.index(seen.strip()))
        np.testing.assert_allclose(column, tracker.belief)
        before = model.action_space.index(done.strip())


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        ([], 2, "required"),
        (["policy", TIGER, VECTORS], 2, "-o"),
        (["policy", TIGER, VECTORS, "-o", "x.png", "--states", "0", "1", "--columns", "3"], 2, "different pictures"),
        (["policy", TIGER, VECTORS, "-o", "x.png", "--states", "0", "0"], 1, "two states are needed"),
        (["policy", TIGER, VECTORS, "-o", "x.png", "--axes", "x", "y"], 1, "no factor 'x'"),
        (["bounds", TIGER, "-o", "x.png"], 1, "tiger.pomdp: a history that mdm solve --history wrote was expected"),
        (["bounds", ROOT / "nothing.json", "-o", "x.png"], 1, "nothing.json"),
        (["policy", TIGER, VECTORS, "-o", "x.nothing"], 1, "its file ends in .png, .svg, .pdf"),
        (["policy", TIGER, VECTORS, "-o", "x"], 1, "its file ends in .png, .svg, .pdf"),
        (["policy", TIGER, VECTORS, "-o", "no/x.png"], 1, "cannot be written: No such file or directory"),
    ],
)
def test_what_cannot_be_drawn(mdm, tmp_path, monkeypatch, arguments, status, words):
    monkeypatch.chdir(tmp_path)
    found, output, errors = mdm("plot", *arguments)
    assert (found, output) == (status, [])
    assert words in errors
    assert "Traceback" not in errors


def test_what_sees_the_state_has_no_belief(mdm, tmp_path):
    grid(tmp_path)
    inputs = tmp_path / "grid.npz", tmp_path / "policy.npz"
    status, _, errors = mdm("plot", "belief", *inputs, "-o", tmp_path / "x.png")
    assert status == 1
    assert "there is no belief to draw" in errors
    assert mdm("plot", "policy", *inputs, "-o", tmp_path / "x.png")[0] == 0
    assert mdm("plot", "policy", *inputs, "--states", "0", "1", "-o", tmp_path / "x.png")[0] == 2


def test_without_matplotlib_one_sentence(mdm, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    status, output, errors = mdm("plot", "policy", TIGER, VECTORS, "-o", "x.png")
    assert (status, output) == (1, [])
    assert errors == "mdm plot: pictures need matplotlib: pip install 'markov-decision-making[plot]'\n"


@pytest.mark.parametrize("picture", ["bounds", "policy", "belief"])
def test_every_picture_has_help_with_an_example(mdm, picture):
    status, output, _ = mdm("plot", picture, "--help")
    assert status == 0
    assert any(line.startswith("example: mdm plot") for line in output)
