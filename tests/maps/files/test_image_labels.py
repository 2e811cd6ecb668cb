"""Images of labels are read as they were written."""

from __future__ import annotations

import builtins

import numpy as np
from maps.floors import flat
from sentences import refused

from mdm.errors import FormatError, MapError
from mdm.maps import Frame, Labels, load_map
from mdm.maps.files.image import read_image, save_labels


def test_what_is_written_is_read_again_by_the_goals(tmp_path):
    floor = flat()
    save_labels(floor.labels, tmp_path / "labels.png")
    read = load_map(floor.graph(), grid=floor.grid, labels=tmp_path / "labels.png")
    for name in floor.labels.names:
        assert read.labels.cells(name).tolist() == floor.labels.cells(name).tolist()


def test_a_thousand_places_have_a_thousand_colours(tmp_path):
    names = tuple(f"place {number}" for number in range(1000))
    raster = np.arange(1001, dtype=np.uint16).reshape(7, 143)
    save_labels(Labels(Frame(7, 143, 1.0), raster, names), tmp_path / "labels.png")
    numbers = read_image(tmp_path / "labels.png").numbers
    assert len(np.unique(numbers)) == 1001
    assert numbers[0, 0] == 0


def test_only_png_is_written(tmp_path):
    with refused(FormatError):
        save_labels(flat().labels, tmp_path / "labels.jpg")
    assert list(tmp_path.iterdir()) == []


def test_without_pillow_there_is_one_sentence(tmp_path, monkeypatch):
    real = builtins.__import__

    def without(name, *rest):
        if name == "PIL":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with refused(MapError):
        save_labels(flat().labels, tmp_path / "labels.png")
