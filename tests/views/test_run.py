"""The picture of a recorded run: what its axes show is what the record says."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from records import Writing, decision, tiger, written
from sentences import refused

pytest.importorskip("matplotlib")

from matplotlib.colors import to_hex

from mdm.errors import Error
from mdm.messages import ActionLife, Cause, Fault, Mode, State
from mdm.recording.reader import Record
from mdm.recording.table import Names
from mdm.views.canvas import pyplot
from mdm.views.palette import ACTIONS
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


def test_an_action_has_the_colour_that_it_has_on_the_page(tmp_path, monkeypatch):
    order = ["open-right", "open-left", "listen"]  # of the model, in another order than they come
    monkeypatch.setattr("mdm.views.run.names_of", lambda _: {"tiger": Names(actions=tuple(order))})
    legend = run_figure(Record(tiger(tmp_path / "run.mcap"))).axes[0].get_legend()
    patches = zip(legend.texts, legend.legend_handles, strict=True)
    colours = {text.get_text(): to_hex(patch.get_facecolor()) for text, patch in patches}
    assert colours.items() >= dict(zip(order, ACTIONS[:3], strict=True)).items()


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
    assert found[1.15] == [(0, 3), (3, 6), (6, 8)]
    assert found[0.1] == [(1, 3), (1, 3), (4, 8)]  # what failed is hatched by a second bar; what lives goes on
    assert axes.get_xlim() == (0, 8)


def lives(path, told, *others):
    """Write lives as actions with their begin and end in seconds, and other messages; return the record."""
    record = Writing(path)
    events = [(begin, number, action, "running") for number, (action, begin, _) in enumerate(told)]
    events += [(end, number, action, "succeeded") for number, (action, _, end) in enumerate(told)]
    for seconds, number, action, status in sorted(events, key=lambda event: event[0]):
        record.write("lives", ActionLife(round(seconds * 1e9), "patrol", number, action, status))
    for topic, message in others:
        record.write(topic, message)
    return Record(record.close())


def test_short_lives_cover_none_that_follow(tmp_path):
    told = [(("Go", "Stop")[number % 2], number / 1000, number / 1000) for number in range(1001)]
    (axes,) = run_figure(lives(tmp_path / "run.mcap", told)).axes
    drawn = bars(axes)[0.1]
    assert len(drawn) == 1001
    assert all(until <= begin + 1e-6 for (_, until), (begin, _) in pairwise(drawn))
    (axes,) = run_figure(lives(tmp_path / "few.mcap", [("Go", 1, 1), ("Stop", 2, 3)])).axes
    begin, until = bars(axes)[0.1][0]
    assert until - begin == pytest.approx((3 - 1) / 200)


def test_actions_at_the_same_time_lie_apart(tmp_path):
    told = [("Go", 0, 4), ("Look", 1, 3), ("Say", 2, 6), ("Look", 4, 5)]
    (axes,) = run_figure(lives(tmp_path / "run.mcap", told)).axes
    assert bars(axes) == {0.1: [(0, 4), (4, 5)], 0.4: [(1, 3)], 0.7: [(2, 6)]}


def test_decisions_and_faults_are_marks(tmp_path):
    second = 10**9
    record = lives(
        tmp_path / "run.mcap",
        [("Go", 0, 10)],
        ("decisions", decision(2000, reward=None)),
        ("decisions", decision(9000, ensemble="patrol/left", reward=None)),
        ("faults", Fault(3 * second, "patrol", "timeout", "Go")),
        ("faults", Fault(4 * second, "patrol/left/sub", "failed_action", "Look")),
        ("faults", Fault(5 * second, "patrolling", "queue", "full")),
    )
    upper, lower = run_figure(record).axes
    assert bars(upper)[1.0] == [(2, 2)]
    assert bars(lower)[1.0] == [(9, 9)]
    assert [list(line.get_xdata()) for axes in (upper, lower) for line in axes.lines] == [[3, 5], [4]]
    assert [text.get_text() for text in upper.texts] == ["timeout", "queue"]


def test_a_part_of_a_run_has_what_goes_on_in_it(tmp_path):
    record = lives(
        tmp_path / "run.mcap",
        [("Go", 0, 4), ("Stop", 4, 8)],
        *(("decisions", decision(1000 * number, reward=1.0)) for number in range(9)),
    )
    upper, rewards = run_figure(record, since=2.5, until=6).axes
    assert upper.get_xlim() == (2.5, 6)
    assert bars(upper)[0.1] == [(0, 4), (4, 6)]
    assert list(rewards.lines[0].get_xdata()) == [3, 4, 5, 6, 6]
    assert list(rewards.lines[0].get_ydata()) == [1, 2, 3, 4, 4]
    for since, until in ((9, None), (3, 3), (0, -1)):
        with refused(Error):
            run_figure(record, since=since, until=until)


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
