"""Pictures of maps: what is drawn where, by the colours of pixels."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
import scipy
from floor_file import write_floor
from matplotlib.colors import to_rgb
from sentences import refused

from mdm.cli.map.floor import floor_picture
from mdm.errors import MapError
from mdm.maps import Edge, Frame, Graph, Grid, Labels, Node, Pose, load_map
from mdm.maps.files.load import Parts
from mdm.maps.paths import passages
from mdm.maps.picture import Picture, around, colour, contrast

WHOLE = (0, 0, 40, 40)


@pytest.fixture
def floor(tmp_path):
    grid, labels, graph = write_floor(tmp_path)
    return load_map(graph, grid=grid, labels=labels)


def pixels(picture, title=""):
    return np.asarray(picture.finished(title)).astype(int)


def like(pixel, ink, tolerance=12):
    return bool((abs(np.array(pixel) - np.array(ink)) <= tolerance).all())


def test_places_are_tinted_and_walls_dark(floor):
    drawn = pixels(Picture(floor.labels, floor.grid, WHOLE, size=400))
    assert drawn.shape == (400, 400, 3)
    hall, office, wall = drawn[305, 55], drawn[55, 55], drawn[5, 5]
    assert like(wall, (58, 62, 72))
    assert like(hall, 0.58 * np.array((252, 252, 250)) + 0.42 * np.array(colour(0)))
    assert like(office, 0.58 * np.array((252, 252, 250)) + 0.42 * np.array(colour(1)))
    without = pixels(Picture(floor.labels, None, WHOLE, size=400))
    assert like(without[305, 55], hall)
    assert like(without[5, 5], (226, 227, 230))


@pytest.mark.parametrize(
    ("one", "other", "known"),
    [
        ("#000000", "#ffffff", 21.0),
        ("#767676", "#ffffff", 4.54),
        ("#ff0000", "#ffffff", 4.0),
        ("#abcdef", "#abcdef", 1),
    ],
)
def test_contrasts_are_those_of_the_recommendation(one, other, known):
    inks = [tuple(round(255 * part) for part in to_rgb(name)) for name in (one, other)]
    assert contrast(*inks) == contrast(*reversed(inks)) == pytest.approx(known, abs=0.005)


@pytest.mark.parametrize("index", range(12))
def test_names_can_be_read_on_the_colour_of_their_place(index):
    names = [*"abcdefghijk", "MMMMM"]
    names[index], names[-1] = names[-1], names[index]
    labels = Labels(Frame(40, 40, 0.1), np.full((40, 40), index + 1, dtype=np.uint16), names)
    plain, picture = Picture(labels, None, WHOLE, size=400), Picture(labels, None, WHOLE, size=400)
    picture.name(Node("MMMMM", Pose(2.0, 2.0)))
    drawn = pixels(picture)
    rows, columns = np.nonzero((drawn != pixels(plain)).any(axis=2))
    plate = drawn[rows.min() + 4 : rows.max() - 3, columns.min() + 4 : columns.max() - 3].reshape(-1, 3).tolist()
    assert any(like(pixel, colour(index), 2) for pixel in plate)
    assert max(contrast(pixel, colour(index)) for pixel in plate) >= 4.5


def test_goals_ways_passages_and_titles_change_the_picture(floor):
    plain = pixels(Picture(floor.labels, floor.grid, WHOLE, size=800))
    found = passages(floor.labels, floor.grid)

    def drawn(draw):
        picture = Picture(floor.labels, floor.grid, WHOLE, size=800)
        draw(picture)
        return (pixels(picture) != plain).any(axis=2)

    routes = {frozenset(("hall", "office")): [(29, 10), (20, 9), (9, 10)]}
    graph = drawn(lambda picture: picture.graph(floor.graph, routes))
    for node in floor.graph.nodes:
        row, column = floor.labels.frame.locate(node.goal.x, node.goal.y)
        assert graph[round(20 * row) + 10, round(20 * column) + 10], node.name
    assert graph[20 * 20 : 20 * 21, 20 * 8 : 20 * 12].any()  # ways lead through the door
    border = drawn(lambda picture: picture.passage(found[1]))
    assert border[20 * 20 + 5, 20 * 8 + 5]
    assert border.sum() < 0.05 * border.size
    shaded = drawn(lambda picture: picture.shade([(3, 4)]))
    assert shaded[20 * 3 + 10, 20 * 4 + 10]
    assert drawn(lambda picture: picture.ring([(10, 10)])).any()
    assert drawn(lambda picture: picture.circle(Pose(0, 3), 0.3)).any()
    assert drawn(lambda picture: picture.scale())[700:].any()
    titled = Picture(floor.labels, floor.grid, WHOLE, size=800).finished("a sentence " * 30)
    assert titled.width == 800
    assert titled.height > 840


@pytest.mark.parametrize("turned", [False, True])
def test_lines_of_coordinates_lie_at_round_metres(turned):
    frame = Frame(80, 80, 0.1, -1.3, 2.2, math.pi / 2 if turned else 0.0)
    labels = Labels(frame, np.zeros(frame.shape, dtype=np.uint16), ())
    plain, picture = (Picture(labels, None, (0, 0, 80, 80), size=800) for _ in range(2))
    picture.coordinates()
    changed = (pixels(picture) != pixels(plain)).any(axis=2)
    rows, columns = changed[:, 40:-40].mean(axis=1) > 0.9, changed[40:-40].mean(axis=0) > 0.9
    found = {axis: np.flatnonzero(lines) for axis, lines in ((0, rows), (1, columns))}
    for axis, lines in found.items():
        row, column = np.where(axis == 0, lines, 400), np.where(axis == 1, lines, 400)
        cells = zip((row + 0.5) / 10 - 0.5, (column + 0.5) / 10 - 0.5, strict=True)
        xs, ys = np.array([frame.centre(*cell) for cell in cells]).T
        metres = ys if (axis == 0) is not turned else xs
        assert len({round(number) for number in metres}) == 8
        assert abs(metres - metres.round()).max() < 0.03


def test_narrow_gaps_are_not_written_all_over_a_map(tmp_path):
    """Between two places the widest passage is told, and none that no robot fits through."""
    raster = np.ones((40, 120), dtype=np.uint16)
    raster[:, 60:] = 2
    free = np.ones(raster.shape, dtype=bool)
    free[:, 60] = False
    free[2:40:3, 60] = True
    free[12:19, 60] = free[24:33, 60] = True
    frame = Frame(*raster.shape, 0.1)
    labels, grid = Labels(frame, raster, ("a", "b")), Grid(frame, free, ~free)
    graph = Graph((Node("a", Pose(3, 2)), Node("b", Pose(9, 2))), (Edge("a", "b", "to b"),))
    drawn = np.asarray(floor_picture(Parts(labels, graph, grid, None, ()), 0.25)).astype(int)
    plates = np.all(abs(drawn - (255, 243, 196)) <= 2, axis=2)
    _, count = scipy.ndimage.label(scipy.ndimage.binary_dilation(plates, iterations=4))
    assert count == 1


def test_a_text_of_what_lies_outside_is_not_drawn(floor):
    window = (0, 20, 20, 40)
    plain = pixels(Picture(floor.labels, floor.grid, window, size=400))
    picture = Picture(floor.labels, floor.grid, window, size=400)
    picture.graph(Graph((Node("hall", Pose(0, 3)),), ()), {})
    assert np.array_equal(pixels(picture), plain)


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2, -2.0])
def test_an_arrow_looks_where_the_goal_looks_in_a_turned_map_too(yaw):
    frame = Frame(21, 21, 0.1, 0.0, 0.0, yaw)
    labels = Labels(frame, np.ones((21, 21), dtype=np.uint16), ("a",))
    x, y = frame.centre(10, 10)

    def shape(turn):
        picture = Picture(labels, None, (0, 0, 21, 21), size=420)
        picture.graph(Graph((Node("a", Pose(x, y, yaw + turn)),), ()), {})
        near = pixels(picture)[190:231, 190:231]
        parts, _ = scipy.ndimage.label([[like(pixel, colour(0), 30) for pixel in row] for row in near])
        ink = np.argwhere(parts == parts[20, 20])  # not the name, which has the same colour
        return ink.max(axis=0) - 20, ink.min(axis=0) - 20  # how far down and right, up and left

    (down, right), (up, left) = shape(0.0)  # along the rows of the raster
    assert right > -left + 2
    assert abs(down + up) <= 2
    (down, right), (up, left) = shape(math.pi / 2)
    assert abs(right + left) <= 2


def test_windows_hold_what_they_are_about_and_stay_in_the_raster():
    frame = Frame(40, 50, 0.1)
    assert around(frame, [(10, 10), (20, 30)], 0.5) == (5, 5, 26, 36)
    assert around(frame, [(0, 0)], 0.5) == (0, 0, 6, 6)
    assert around(frame, [(39, 49)], 0.5) == (34, 44, 40, 50)
    assert around(frame, [], 0.0) == (0, 0, 40, 50)


def test_colours_of_places_differ():
    inks = [colour(index) for index in range(12)]
    assert min(math.dist(one, other) for one in inks for other in inks if one != other) > 20
    assert len(set(inks)) == 12


def test_without_pillow_it_is_told(floor, monkeypatch):
    monkeypatch.setitem(sys.modules, "PIL", None)
    with refused(MapError):
        Picture(floor.labels, floor.grid, WHOLE)
