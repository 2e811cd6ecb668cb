"""Pictures of networks: every variable with its name, and an arrow for each dependency."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import pytest
from places import MODELS

from mdm import load_model
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
