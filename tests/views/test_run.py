"""The picture of a recorded run: what its axes show is what the record says."""

from __future__ import annotations

import numpy as np
import pytest
from records import Writing, decision, tiger, written
from sentences import refused

pytest.importorskip("matplotlib")

from mdm.errors import Error
from mdm.messages import ActionLife, Cause, Mode, State
from mdm.recording.reader import Record
from mdm.views.canvas import pyplot
from mdm.views.run import run_figure


@pytest.fixture(autouse=True)
def _close():
    yield
    pyplot().close("all")


def bars(axes):
    """Return the bars by their place from below: begin, and end."""
    found = {}
    for collection in axes.collections:
        for path in collection.get_paths():
            box = path.get_extents()
            found.setdefault(round(float(box.y0), 2), []).append((round(float(box.x0), 6), round(float(box.x1), 6)))
    return {place: sorted(each) for place, each in found.items()}


def test_beliefs_and_rewards_are_those_of_the_decisions(tmp_path):
    record = Record(tiger(tmp_path / "run.mcap"))
    decisions = [each.message for each in record.messages(["decisions"])]
    lives, belief, rewards = run_figure(record).axes
    assert lives.get_title(loc="left") == "tiger"
    assert {text.get_text() for text in lives.get_legend().get_texts()} == {
        "listen",
        "open-left",
        "open-right",
        "deciding",
        "stopped",
    }
    assert [text.get_text() for text in belief.get_legend().get_texts()] == ["tiger-left", "tiger-right"]
    line = rewards.lines[0]
    total = np.cumsum([each.reward for each in decisions])
    _, last = record.span
    np.testing.assert_allclose(line.get_ydata(), [*total, total[-1]])
    np.testing.assert_allclose(line.get_xdata(), [*(each.time / 1e9 for each in decisions), last / 1e9])
    lower = belief.collections[0].get_paths()[0].vertices
    for each in decisions[:-1]:
        at = lower[np.isclose(lower[:, 0], each.time / 1e9 + 0.0)]
        assert np.isclose(at[:, 1], each.belief[0]).any()


def test_lives_and_modes_are_bars_of_their_length(tmp_path):
    record = Writing(tmp_path / "run.mcap")
    second = 10**9
    for topic, message in (
        ("modes", Mode(0, "patrol", "deciding", 0)),
        ("lives", ActionLife(1 * second, "patrol", 1, "Go", "running")),
        ("lives", ActionLife(3 * second, "patrol", 1, "Go", "failed")),
        ("modes", Mode(3 * second, "patrol", "safe", 3 * second, (Cause("failed_action", "", 3 * second),))),
        ("lives", ActionLife(4 * second, "patrol", 2, "Stop", "running")),
        ("modes", Mode(6 * second, "patrol", "deciding", 6 * second)),
        ("faults", State(8 * second, 0, (0,))),
    ):
        record.write(topic, message)
    (axes,) = run_figure(Record(record.close())).axes
    found = bars(axes)
    assert found[1.1] == [(0, 3), (3, 6), (6, 8)]
    assert found[0.1] == [(1, 3), (1, 3), (4, 8)]  # what failed is hatched by a second bar; what lives goes on
    assert axes.get_xlim() == (0, 8)


def test_unlikely_states_are_drawn_as_one(tmp_path):
    belief = np.arange(1, 41) / np.arange(1, 41).sum()
    path = written(tmp_path / "run.mcap", [("decisions", decision(number, belief=belief)) for number in range(3)])
    axes = run_figure(Record(path)).axes[1]
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == [*(f"state {state}" for state in range(34, 40)), "34 others"]


def test_ensembles_are_chosen(tmp_path):
    pairs = [("decisions", decision(number, ensemble=name, reward=None)) for number, name in enumerate("abcdefghij")]
    record = Record(written(tmp_path / "run.mcap", pairs))
    assert [axes.get_title(loc="left") for axes in run_figure(record).axes] == [*"abcdefgh"]
    assert [axes.get_title(loc="left") for axes in run_figure(record, ["j", "b"]).axes] == [*"jb"]
    with refused(Error):
        run_figure(record, ["k"])


def test_there_may_be_nothing_to_draw(tmp_path):
    with refused(Error):
        run_figure(Record(written(tmp_path / "run.mcap", [])))
    with refused(Error):
        run_figure(Record(written(tmp_path / "run.mcap", [("a/state", State(1, 0, (0,)))])))


def test_a_run_of_one_moment_is_drawn(tmp_path):
    figure = run_figure(Record(written(tmp_path / "run.mcap", [("decisions", decision(1))])))
    figure.savefig(tmp_path / "run.png")
