"""Pictures of bounds over time."""

from __future__ import annotations

import pytest
from drawn import history

from mdm import FormatError
from mdm.views.figures import bounds_figure

pytest.importorskip("matplotlib")


def test_bounds_of_several_runs(tmp_path):
    paths = [history(tmp_path / "a.json"), history(tmp_path / "b.json", solver="other")]
    figure = bounds_figure([str(path) for path in paths])
    assert [text.get_text() for text in figure.axes[0].get_legend().get_texts()] == ["a (some)", "b (other)"]
    lower, upper = figure.axes[0].lines[:2]
    assert list(lower.get_ydata()) == [-1 / (i + 1) for i in range(9)]
    assert len(upper.get_ydata()) == 8


def test_bounds_that_are_never_known_are_not_drawn(tmp_path):
    (tmp_path / "a.json").write_text('{"solver": "s", "history": [{"seconds": 1, "lower": 2.5, "upper": null}]}')
    axes = bounds_figure([str(tmp_path / "a.json")]).axes[0]
    (line,) = axes.lines
    assert (list(line.get_xdata()), list(line.get_ydata()), line.get_marker()) == ([1], [2.5], ".")
    low, high = axes.get_ylim()
    assert low < 2.5 < high


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"solver": "s", "history": []}', "the history is empty"),
        ('{"solver": "s"}', "a history written by mdm solve --history was expected"),
        ("states: 2", "a history written by mdm solve --history was expected"),
    ],
)
def test_what_is_no_history_is_refused(tmp_path, text, words):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(FormatError, match=words) as caught:
        bounds_figure([str(tmp_path / "a.json")])
    assert caught.value.file == str(tmp_path / "a.json")
