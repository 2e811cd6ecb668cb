"""Films as animations and as sheets."""

from __future__ import annotations

import pytest
from maps.floors import flat
from PIL import Image
from sentences import refused

from mdm.errors import Error
from mdm.views.floor import Film, FloorView, Mark


def filmed(path, pictures):
    film = Film(FloorView(flat().map()), path, size=300)
    for index in range(pictures):
        film.add([Mark(0.5 + 0.1 * index, 2.0)], f"{index} s")
    assert len(film) == pictures
    film.save(0.25)


def test_an_animation_has_all_pictures_at_their_pace(tmp_path):
    filmed(tmp_path / "film.gif", 5)
    with Image.open(tmp_path / "film.gif") as film:
        assert film.n_frames == 5
        assert film.info["duration"] == 250


@pytest.mark.parametrize("pictures", [1, 5, 40])
def test_a_sheet_has_some_of_them(tmp_path, pictures):
    filmed(tmp_path / "film.png", pictures)
    with Image.open(tmp_path / "film.png") as sheet:
        one = FloorView(flat().map()).image([], title="x", size=300)
        across = {1: 1, 5: 3, 40: 4}[pictures]
        assert across * one.width <= sheet.width <= across * (one.width + 8)
        last = FloorView(flat().map()).image(
            [Mark(0.5 + 0.1 * (pictures - 1), 2.0)], title=f"{pictures - 1} s", size=300
        )
        rows, rest = divmod(min(pictures, 12) - 1, across)
        left, top = rest * (one.width + 8), rows * (one.height + 8)
        corner = sheet.crop((left, top, left + last.width, top + last.height))
        assert corner.tobytes() == last.tobytes()


def test_other_films_are_refused(tmp_path):
    view = FloorView(flat().map())
    with refused(Error):
        Film(view, tmp_path / "film.mp4")
    with refused(Error):
        Film(view, tmp_path / "film.gif").save(0.1)
    with pytest.raises(Error):
        Film(view, tmp_path / "nowhere" / "film.gif")
