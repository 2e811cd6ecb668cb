"""Pictures of networks: every variable with its name, and an arrow for each dependency."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import pytest
from places import MODELS

from mdm import load_model
from mdm.problems import rock_sample
from mdm.views import picture
from mdm.views.picture import draw

mpl = pytest.importorskip("matplotlib")


@pytest.mark.parametrize(
    ("name", "labels", "arrows"),
    [
        # door' <- door, guard; heard' <- door, door'; reward 1 <- door', camera
        ("guard.pgmx", {"door", "door'", "guard", "camera", "heard", "reward 1"}, 6),
    ],
)
def test_variables_and_dependencies_are_drawn(tmp_path, monkeypatch, name, labels, arrows):
    monkeypatch.setitem(mpl.rcParams, "svg.fonttype", "none")  # so that texts stand in the file as such
    drawn = []
    monkeypatch.setattr("matplotlib.axes.Axes.annotate", lambda axes, text, **options: drawn.append(options))
    draw(load_model(MODELS / name).network, str(tmp_path / "network.svg"))
    texts = {element.text for element in ET.parse(tmp_path / "network.svg").iter() if element.tag.endswith("}text")}
    assert texts == labels
    assert len(drawn) == arrows


def test_no_arrow_passes_behind_a_box(tmp_path, monkeypatch):
    """What leads over the middle column passes between its boxes, each on a height of its own."""
    passed, kept = [], []
    whole = picture._pass
    monkeypatch.setattr(picture, "_pass", lambda *given: passed.append(given[3]) or whole(*given))
    monkeypatch.setattr(picture, "keep", lambda figure, path: kept.append(figure))
    draw(rock_sample(4, 3).network, "network.svg")
    (axes,) = kept[0].axes
    inverse = axes.transData.inverted()
    boxes = [text.get_bbox_patch().get_window_extent().transformed(inverse) for text in axes.texts if text.get_text()]
    middle = [box for box in boxes if box.x0 < 5 < box.x1]
    assert len(middle) == 4
    assert len(set(passed)) == len(passed) == 6
    assert not any(box.y0 < height < box.y1 for box in middle for height in passed)
