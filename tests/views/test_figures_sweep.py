"""The picture of a sweep: what it shows of its rows, and what cannot be drawn."""

from __future__ import annotations

import pytest
from sentences import refused

from mdm import Error
from mdm.views.canvas import pyplot
from mdm.views.figures import sweep_figure

pytest.importorskip("matplotlib")

ROWS = [
    {"size": size, "rocks": rocks, "value": size + rocks if rocks < 3 else None, "standard_error": 0.5, "solver": "x"}
    for size in (7, 4)
    for rocks in (1, 2, 2, 3)
]


def lines(axes):
    return [(line.get_label(), line.get_xydata().tolist()) for line in axes.get_lines() if line.get_label()[:1] != "_"]


def test_a_line_goes_through_the_means_of_each_place():
    axes = sweep_figure(ROWS, "size").axes[0]
    assert axes.get_lines()[0].get_xydata().tolist() == [[4, (5 + 6 + 6) / 3], [7, (8 + 9 + 9) / 3]]
    assert axes.get_legend() is None
    (bars,) = axes.containers
    segments = bars.lines[2][0].get_segments()
    assert len(segments) == 6
    assert segments[0][:, 1].tolist() == pytest.approx([5 - 0.98, 5 + 0.98])
    pyplot().close("all")


def test_each_value_of_another_column_has_a_line():
    axes = sweep_figure(ROWS, "size", by="rocks").axes[0]
    assert dict(lines(axes)) == {"rocks 1": [[4, 5], [7, 8]], "rocks 2": [[4, 6], [7, 9]]}
    assert axes.get_xlabel() == "size"
    assert sweep_figure(ROWS, "solver", "rocks").axes[0].get_ylabel() == "rocks"
    mixed = [{**row, "goal": goal} for row, goal in zip(ROWS[:3], (2, True, "far"), strict=True)]
    assert [text.get_text() for text in sweep_figure(mixed, "goal").axes[0].get_xticklabels()] == ["2", "True", "far"]
    pyplot().close("all")


@pytest.mark.parametrize(("x", "y", "by"), [("sise", "value", None), ("size", "solver", None), ("size", "value", "a")])
def test_what_cannot_be_drawn_is_refused(x, y, by):
    with refused(Error):
        sweep_figure(ROWS, x, y, by)
    with refused(Error):
        sweep_figure([], x, y, by)
