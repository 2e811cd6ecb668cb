"""Maps from their files."""

from __future__ import annotations

import math
import shutil

import numpy as np
import pytest
from floor_file import COLOURS, GRAPH, NUMBERS, rooms, write_floor
from PIL import Image as Pillow
from sentences import refused

from mdm.errors import FormatError, MapError
from mdm.maps import Graph, Node, Pose, load_grid, load_map


@pytest.fixture
def floor(tmp_path):
    grid, labels, graph = write_floor(tmp_path)
    return {"graph": graph, "grid": grid, "labels": labels}


def png(path, mode, *, colours=COLOURS, background=200):
    """Write the labels of the floor as a PNG, by the modes of Pillow."""
    raster = rooms()
    numbers = {name: index + 1 for index, name in enumerate(colours)}
    if mode in {"P", "L", "I;16"}:
        pixels = np.zeros(raster.shape, dtype=np.uint16 if mode == "I;16" else np.uint8)
        for name, number in numbers.items():
            pixels[raster == name] = number * (1000 if mode == "I;16" else 1)
        picture = Pillow.fromarray(pixels)
        if mode == "P":
            picture = Pillow.fromarray(pixels, mode="P")
            picture.putpalette([0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3])
    else:
        coloured = np.full((*raster.shape, 3), background, dtype=np.uint8)
        for name, colour in colours.items():
            coloured[raster == name] = colour
        picture = Pillow.fromarray(coloured).convert(mode)
    picture.save(path)
    return path


def test_colours_under_goals_name_the_places(floor):
    loaded = load_map(**floor)
    assert loaded.labels.names == ("hall", "office", "store")
    for index, name in enumerate(loaded.labels.names, 1):
        assert np.array_equal(loaded.labels.raster == index, rooms() == name)
    assert loaded.labels.unnamed == {200 * 0x010101: int((rooms() == "").sum())}
    assert loaded.grid is not None


def test_names_may_be_given(floor, tmp_path):
    (tmp_path / "names.yaml").write_text("".join(f"{name}: {number}\n" for name, number in NUMBERS.items()))
    plain = load_map(**floor).labels.raster
    for names in (NUMBERS, tmp_path / "names.yaml"):
        assert np.array_equal(load_map(**floor, names=names).labels.raster, plain)


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "P", "L", "I;16"])
def test_labels_of_every_kind_of_png(floor, tmp_path, mode):
    floor["labels"] = png(tmp_path / "labels.png", mode)
    assert np.array_equal(load_map(**floor).labels.raster > 0, rooms() != "")
    if mode == "RGB":
        names = NUMBERS
    else:
        factor = {"I;16": 1000, "P": 1, "L": 1}.get(mode)
        names = {
            name: NUMBERS[name] | 0xFF000000 if factor is None else factor * index
            for index, name in enumerate(COLOURS, 1)
        }
    assert np.array_equal(load_map(**floor, names=names).labels.raster > 0, rooms() != "")


@pytest.mark.parametrize("turns", range(4))
def test_a_turned_map_is_looked_up_in_its_own_directions(tmp_path, turns):
    """The floor as a whole is turned about its corner: each point with it."""
    yaw = turns * math.pi / 2
    grid, labels, _ = write_floor(tmp_path, yaw=yaw)

    def turned(x, y):
        dx, dy = x + 1, y - 2
        return -1 + dx * math.cos(yaw) - dy * math.sin(yaw), 2 + dx * math.sin(yaw) + dy * math.cos(yaw)

    goals = {"hall": (0.0, 3.0), "office": (0.0, 5.0), "store": (2.0, 3.5)}
    graph = Graph(tuple(Node(name, Pose(*turned(*goal))) for name, goal in goals.items()), ())
    loaded = load_map(graph, grid=grid, labels=labels, names=NUMBERS)
    for name, goal in goals.items():
        assert loaded.labels.name(*turned(*goal)) == name


def test_objects_in_place_of_files(floor):
    graph = Graph((Node("hall", Pose(0, 3)), Node("store", Pose(2, 3))), ())
    loaded = load_map(graph, grid=load_grid(floor["grid"]), labels=floor["labels"])
    assert loaded.labels.names == ("hall", "store")
    assert loaded.labels.name(0, 5) is None


def test_zones_and_reaches_in_place_of_labels(floor):
    zone = ((-1.0, 2.0), (1.0, 2.0), (1.0, 4.0), (-1.0, 4.0))
    graph = Graph((Node("hall", Pose(0, 3), zone), Node("store", Pose(2, 3))), ())
    for grid in (floor["grid"], None):
        loaded = load_map(graph, grid=grid, reach=0.5)
        assert (loaded.labels.name(0.9, 3.9), loaded.labels.name(2.4, 3.0)) == ("hall", "store")
        assert (loaded.grid is None) == (grid is None)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"grid": None}, "give the grid, too"),
        ({"labels": None}, "'hall' has no zone: give an image with labels"),
        ({"labels": None, "names": NUMBERS}, "there is none"),
        ({"reach": 1.0}, "leave one of them out"),
        ({"names": NUMBERS | {"hall": 255}}, "'hall' and 'office' have the same colour"),
        ({"names": NUMBERS | {"hall": 7}}, "no pixel has the colour of 'hall', 7"),
        ({"names": {"hall": 255}}, "the names give no colour to 'office', a place of the graph"),
        ({"names": NUMBERS | {"attic": 200 * 0x010101}}, "'attic' has a colour, and is no place of the graph"),
    ],
)
def test_what_does_not_fit_is_told(floor, change, message):
    with pytest.raises(MapError) as caught:
        load_map(**floor | change)
    assert message in str(caught.value)


def test_numbers_without_opacity_for_an_image_with_it_are_told(floor, tmp_path):
    floor["labels"] = png(tmp_path / "labels.png", "RGBA")
    with refused(MapError):
        load_map(**floor, names=NUMBERS)


def test_labels_of_another_size_are_refused(floor, tmp_path):
    Pillow.open(floor["labels"]).crop((0, 0, 39, 40)).save(tmp_path / "labels.png")
    with refused(FormatError):
        load_map(**floor | {"labels": tmp_path / "labels.png"})


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        ("9 9 0", "the goal of 'hall', (9, 9), lies outside the map"),
        ("-0.97 3 0", "the goal of 'hall', (-0.97, 3), is not free in the map"),
        ("0 5 0", "the goal of 'office', (0, 5), and that of 'hall' lie on the same colour, 255"),
    ],
)
def test_a_goal_that_names_no_colour_is_told(tmp_path, goal, message):
    grid, labels, graph = write_floor(tmp_path, graph=GRAPH.replace("0.0 3.0 0", goal))
    with pytest.raises(MapError) as caught:
        load_map(graph, grid=grid, labels=labels)
    assert message in str(caught.value)


def test_a_map_in_place_of_a_graph_is_told(floor):
    with refused(FormatError):
        load_map(floor["grid"], grid=floor["grid"], labels=floor["labels"])
    with refused(FormatError):
        load_map(floor["labels"], grid=floor["grid"], labels=floor["labels"])


@pytest.mark.foreign("topology/ISR_label_map.png")
def test_the_map_of_the_original(corpus, tmp_path):
    """Six labels, three colours of the background, and seven stray ones of 1 to 50 cells."""
    files = corpus / "topology"
    for folder, name in (("config", "ISR_rviz_map.yaml"), ("maps", "ISR_rviz_map.pgm")):
        (tmp_path / folder).mkdir()
        shutil.copy(files / name, tmp_path / folder)
    given = {"grid": tmp_path / "config" / "ISR_rviz_map.yaml", "labels": files / "ISR_label_map.png"}
    loaded = load_map(files / "topological_map.xml", **given, names=files / "predicate_labels.yaml")
    assert len(loaded.labels.names) == 6
    counts = sorted(loaded.labels.unnamed.values())
    assert counts == [1, 1, 2, 13, 21, 39, 50, 5148, 28456, 64131]
    for node in loaded.graph.nodes:
        assert loaded.labels.name(node.goal.x, node.goal.y) == node.name
    unnamed = load_map(files / "topological_map.xml", **given).labels
    for name in unnamed.names:
        assert np.array_equal(unnamed.cells(name), loaded.labels.cells(name))
