"""Occupancy grids, against the rules of Nav2's map_server as its source states them."""

from __future__ import annotations

import math
import shutil

import numpy as np
import pytest
from floor_file import YAML, free, write_floor, write_pgm
from hypothesis import given, strategies as st
from PIL import Image as Pillow
from sentences import refused

from mdm.errors import FormatError, MapError, MapWarning
from mdm.maps import load_grid
from mdm.maps.files.occupancy import image_of

BASE = "image: map.png\nresolution: 0.5\norigin: [1, 2, 0]\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


def grid(tmp_path, pixels, more="", base=BASE):
    Pillow.fromarray(np.array(pixels, dtype=np.uint8)).save(tmp_path / "map.png")
    (tmp_path / "map.yaml").write_text(base + more)
    return load_grid(tmp_path / "map.yaml")


def told(loaded):
    """Return f, o or u for each cell."""
    return [
        "".join("f" if f else "o" if o else "u" for f, o in zip(*rows, strict=True))
        for rows in zip(loaded.free, loaded.occupied, strict=True)
    ]


def test_the_grid_of_a_floor(tmp_path):
    loaded = load_grid(write_floor(tmp_path)[0])
    assert np.array_equal(loaded.free, free())
    assert np.array_equal(loaded.occupied, ~free())
    assert (loaded.frame.resolution, loaded.frame.x, loaded.frame.y) == (0.1, -1, 2)


def test_the_image_is_known_without_reading_it(tmp_path):
    (tmp_path / "map.yaml").write_text("image: elsewhere/plan.png\n")
    assert image_of(tmp_path / "map.yaml") == tmp_path / "elsewhere" / "plan.png"


def test_the_image_is_relative_to_the_file(tmp_path):
    (tmp_path / "maps").mkdir()
    (tmp_path / "config").mkdir()
    write_pgm(tmp_path / "maps" / "floor.pgm", free() * 254)
    (tmp_path / "config" / "map.yaml").write_text(YAML.format(image="../maps/floor.pgm", yaw=0))
    assert load_grid(tmp_path / "config" / "map.yaml").free.sum() == free().sum()
    (tmp_path / "config" / "map.yaml").write_text(YAML.format(image=tmp_path / "maps" / "floor.pgm", yaw=0))
    assert load_grid(tmp_path / "config" / "map.yaml").free.sum() == free().sum()


@given(st.lists(st.integers(0, 255), min_size=1, max_size=9), st.booleans())
def test_thresholds_tell_free_occupied_and_unknown_apart(tmp_path_factory, pixels, negate):
    loaded = grid(tmp_path_factory.mktemp("map"), [pixels], f"negate: {int(negate)}\n")
    for cell, value in enumerate(pixels):
        darkness = value / 255 if negate else (255 - value) / 255
        assert loaded.free[0, cell] == (darkness <= 0.196)
        assert loaded.occupied[0, cell] == (darkness >= 0.65)


@pytest.mark.parametrize("mode", ["trinary", "scale"])
@pytest.mark.parametrize("value", [0, 1, 51, 127, 204, 254, 255])
def test_a_threshold_that_is_met_exactly_counts(tmp_path, mode, value):
    """Nav2 has ``>=`` and ``<=``, and lets free win where both hold."""
    base = BASE.replace("0.65", f"{(255 - value) / 255}").replace("0.196", "0.0")
    others = [number for number in (value - 1, value, value + 1) if 0 <= number < 255]
    expected = "".join("o" if number <= value else "u" for number in others)
    assert told(grid(tmp_path, [others, others], f"mode: {mode}\n", base)) == [expected] * 2
    base = BASE.replace("0.65", "1").replace("0.196", f"{(255 - value) / 255}")
    others = [number for number in (value - 1, value, value + 1) if 0 < number <= 255]
    expected = "".join("f" if number >= value else "u" for number in others)
    assert told(grid(tmp_path, [others, others], f"mode: {mode}\n", base)) == [expected] * 2


def test_a_mask_of_speeds_has_free_and_occupied_cells(tmp_path):
    """Its thresholds are the ends of the scale: white is free, black occupied, and greys are for planners."""
    base = BASE.replace("0.65", "1.0").replace("0.196", "0.0")
    assert told(grid(tmp_path, [[255, 254, 100, 1, 0]], "mode: scale\n", base)) == ["fuuuo"]


def test_the_usual_grey_of_the_unknown_is_unknown(tmp_path):
    assert told(grid(tmp_path, [[254, 205, 0]])) == ["fuo"]


@pytest.mark.parametrize("mode", ["", "mode: trinary\n", "mode: scale\n"])
def test_only_what_is_opaque_is_known(tmp_path, mode):
    pixels = [[[255, 255, 255, 255], [0, 0, 0, 255], [128, 128, 128, 255], [255, 255, 255, 254], [0, 0, 0, 0]]]
    assert told(grid(tmp_path, pixels, mode)) == ["fouuu"]


def test_raw_numbers_are_hundredths_of_occupancy(tmp_path):
    assert told(grid(tmp_path, [[0, 19, 20, 65, 66, 100, 101, 255]], "mode: raw\n")) == ["ffuooouu"]
    with refused(FormatError):
        grid(tmp_path, [[0]], "mode: raw\nnegate: 1\n")


def test_colours_are_averaged_and_palettes_seen_through(tmp_path):
    assert told(grid(tmp_path, [[[255, 255, 0], [255, 255, 255], [60, 0, 0]]])) == ["ufo"]
    picture = Pillow.fromarray(np.array([[0, 1]], dtype=np.uint8), mode="P")
    picture.putpalette([255, 255, 255, 0, 0, 0])
    picture.save(tmp_path / "map.png")
    assert told(load_grid(tmp_path / "map.yaml")) == ["fo"]


def test_sixteen_bits_of_grey_are_read_right(tmp_path):
    (tmp_path / "map.yaml").write_text(BASE.replace("png", "pgm"))
    write_pgm(tmp_path / "map.pgm", np.array([[65_000, 52_689, 0]]), most=65_535)
    assert told(load_grid(tmp_path / "map.yaml")) == ["fuo"]


@pytest.mark.parametrize("turns", range(4))
def test_a_map_is_turned_about_its_lower_left_corner_by_its_whole_yaw(tmp_path, turns):
    """The lower left cell lies in the direction of yaw; a reader that takes half the angle, or turns back, fails."""
    yaw = turns * math.pi / 2
    frame = load_grid(write_floor(tmp_path, yaw=yaw)[0]).frame
    x, y = -1 + 2.05 * math.cos(yaw) - 0.05 * math.sin(yaw), 2 + 2.05 * math.sin(yaw) + 0.05 * math.cos(yaw)
    assert frame.cell(x, y) == (39, 20)


def test_the_lowest_row_and_the_upper_borders(tmp_path):
    """The lowest cells are the last row, not one beyond it; the upper and right borders belong to no cell."""
    frame = load_grid(write_floor(tmp_path)[0]).frame
    assert frame.cell(-1, 2) == (39, 0)
    assert frame.cell(-0.95, 5.95) == (0, 0)
    assert frame.cell(-0.95, 6.0) is None
    assert frame.cell(3.0, 2.05) is None
    assert frame.cell(-1.01, 2.05) is None
    assert frame.cell(-0.95, 1.99) is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("resolution: 0.5\n", "", "map.yaml:1: the map: the key 'resolution' is missing"),
        ("image: map.png\n", "", "the key 'image' is missing"),
        ("image: map.png\n", "image: gone.png\n", "gone.png: there is no such file"),
        ("free_thresh: 0.196\n", "", "the key 'free_thresh' is missing"),
        ("0.5", "zero", "map.yaml:2: resolution: a number was expected, not 'zero'"),
        ("0.5", "0", "map.yaml:2: the resolution is 0.0"),
        ("0.5", "-1", "map.yaml:2: the resolution is -1.0"),
        ("[1, 2, 0]", "[1, 2]", "map.yaml:3: origin: x, y and yaw"),
        ("[1, 2, 0]", "[1, .nan, 0]", "map.yaml:3: origin: a number was expected, not '.nan'"),
        ("[1, 2, 0]", "12", "map.yaml:3: origin: a list was expected"),
        ("0.196", "0.9", "map.yaml:5: free_thresh, 0.9, is above occupied_thresh"),
        ("0.65", "65", "map.yaml:4: occupied_thresh: a number from 0 to 1 was expected, not 65"),
        ("0.196", "-1", "map.yaml:5: free_thresh: a number from 0 to 1 was expected, not -1"),
        ("image: map.png", 'image: "a\\0b"', "a\\0b: the file cannot be read: embedded null byte"),
        ("free_thresh", "mode: binary\nfree_thresh", "map.yaml:5: mode: one of trinary, scale, raw"),
        ("free_thresh", "negate: maybe\nfree_thresh", "map.yaml:5: negate: 0 or 1 was expected, not 'maybe'"),
        (BASE, "just words", "map.yaml:1: the map: keys and values were expected, not 'just words'"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(tmp_path, old, new, message):
    with pytest.raises((FormatError, MapError)) as caught:
        grid(tmp_path, [[0]], base=BASE.replace(old, new))
    assert message in str(caught.value)
    assert str(tmp_path) in str(caught.value)


def test_a_key_that_is_not_read_is_told(tmp_path):
    with pytest.warns(MapWarning, match=r"map\.yaml:6: the key 'negat' is not read: did you mean 'negate'\?"):
        grid(tmp_path, [[0]], "negat: 1\n")


@pytest.mark.foreign("topology/ISR_rviz_map.yaml")
def test_the_map_of_the_original(corpus, tmp_path):
    for folder, name in (("config", "ISR_rviz_map.yaml"), ("maps", "ISR_rviz_map.pgm")):
        (tmp_path / folder).mkdir()
        shutil.copy(corpus / "topology" / name, tmp_path / folder)
    loaded = load_grid(tmp_path / "config" / "ISR_rviz_map.yaml")
    assert loaded.frame.shape == (358, 358)
    assert loaded.frame.cell(-18.5, -18.5) == (357, 0)
    pixels = np.array(Pillow.open(corpus / "topology" / "ISR_rviz_map.pgm"))
    assert np.array_equal(loaded.free, (255 - pixels.astype(float)) / 255 < 0.196)
