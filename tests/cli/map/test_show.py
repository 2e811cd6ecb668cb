"""``mdm map show``."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from building_file import write_building
from floor_file import GRAPH, write_floor
from PIL import Image as Pillow


def size(path):
    with Pillow.open(path) as picture:
        return picture.size


def test_places_and_passages_as_a_table(mdm, floor):
    status, output, errors = mdm("map", "show", *floor)
    assert (status, errors) == (0, "")
    assert output == [
        "40 x 40 cells of 0.1 m, the lower left corner at (-1, 2)",
        "",
        "place     free  goal                ways",
        "hall    3.3 m²  (0.00, 3.00, 0°)    Up: office (0.40 m), Right: store (0.60 m)",
        "office  3.4 m²  (0.00, 5.00, 90°)   Down: hall (0.40 m)",
        "store   7.2 m²  (2.00, 3.50, -57°)  Left: hall (0.60 m)",
        "",
        "passages",
        "  hall - store: 0.60 m",
        "  hall - office: 0.40 m",
    ]


def test_a_picture(mdm, floor, tmp_path):
    status, output, errors = mdm("map", "show", *floor, "-o", tmp_path / "floor.png")
    assert (status, errors) == (0, "")
    assert output[-1] == f"{tmp_path / 'floor.png'}: drawn"
    assert size(tmp_path / "floor.png") == (960, 960)


def test_as_json(mdm, floor):
    status, output, _ = mdm("map", "show", *floor, "--json", "--radius", "0.25")
    facts = json.loads(output[0])
    assert status == 0
    assert [place["name"] for place in facts["places"]] == ["hall", "office", "store"]
    assert facts["places"][0]["ways"][0] == {"label": "Up", "to": "office", "width": None}  # too narrow
    assert facts["passages"] == [{"between": ["hall", "store"], "width": pytest.approx(0.6)}]


def test_places_without_colour_are_shown_as_such(mdm, floor):
    Path(floor[2]).write_text(GRAPH.replace("0.0 5.0 1.5707963", "0.0 3.2 0"))
    status, output, _ = mdm("map", "show", *floor)
    assert status == 0
    assert any(line.startswith("office       -") for line in output)
    assert output[-1].startswith("note: the goal of 'office', (0, 3.2), and that of 'hall' lie on the same colour")


def test_a_way_is_told_with_its_end_unless_its_name_says_it(mdm, floor):
    graph = Path(floor[2])
    graph.write_text(GRAPH.replace('"Up"', '"backoffice"').replace('"Down"', '"to hall"'))
    _, output, _ = mdm("map", "show", *floor)
    assert output[3].endswith("backoffice: office (0.40 m), Right: store (0.60 m)")
    assert output[4].endswith("  to hall (0.40 m)")


def test_a_map_without_a_graph(mdm, floor, tmp_path):
    """So that goals can be chosen: it is drawn with lines of coordinates."""
    status, output, errors = mdm("map", "show", floor[0], "-o", tmp_path / "floor.png")
    assert (status, errors) == (0, "")
    assert output == [
        "40 x 40 cells of 0.1 m, the lower left corner at (-1, 2)",
        "14.0 m² free, 2.0 m² occupied, 0.0 m² unknown",
        f"{tmp_path / 'floor.png'}: drawn",
    ]
    assert size(tmp_path / "floor.png") == (960, 960)
    assert json.loads(mdm("map", "show", floor[0], "--json")[1][0])["free"] == pytest.approx(13.97)
    status, _, errors = mdm("map", "show", floor[0], "--radius", "0.2")
    assert (status, "--radius is for the places of a graph, and there is none" in errors) == (2, True)
    assert mdm("map", "show", *floor, "--coordinates", "-o", tmp_path / "other.png")[0] == 0
    assert (tmp_path / "other.png").read_bytes() != (tmp_path / "floor.png").read_bytes()


def test_ways_are_drawn_along_paths(mdm, tmp_path):
    """Around a shelf, not through it, though the straight line and the middle of the passage lie behind it."""
    raster = np.full((60, 60), "hall", dtype="U8")
    raster[:, 30:] = "store"
    raster[:, [0, -1]] = raster[[0, -1]] = ""
    raster[10:59, 22:38] = ""
    graph = GRAPH.replace("0.0 3.0 0", "0.0 3.0 0").replace("2.0 3.5", "4.0 3.0").replace("0.0 5.0", "0.0 4.0")
    graph = graph.replace('<Connection label="Up">office</Connection>', "")
    graph = re.sub(r'<Node name="office">.*?</Node>', "", graph, flags=re.DOTALL)
    files = write_floor(tmp_path / "shelf", raster=raster, graph=graph)
    assert mdm("map", "show", *files, "-o", tmp_path / "shelf.png")[0] == 0
    with Pillow.open(tmp_path / "shelf.png") as picture:
        drawn = np.asarray(picture).astype(int)
    side = drawn.shape[0] / 60
    inside = drawn[round(14 * side) : round(56 * side), round(23 * side) : round(37 * side)]
    assert (abs(inside - (58, 62, 72)).max(axis=2) <= 12).mean() > 0.999


def test_pictures_never_destroy_input_and_are_png(mdm, floor, tmp_path):
    labels = tmp_path / "labels.png"
    Pillow.open(floor[1]).save(labels)
    before = labels.read_bytes()
    status, output, errors = mdm("map", "show", floor[0], labels, floor[2], "-o", labels)
    assert (status, output) == (1, [])
    assert "this file is an input and would be overwritten" in errors
    assert labels.read_bytes() == before
    status, _, errors = mdm("map", "show", *floor, "-o", tmp_path / "floor.gif")
    assert status == 1
    assert "its file ends in .png" in errors
    assert mdm("map", "show", *floor, "-o", tmp_path / "nowhere" / "floor.png")[0] == 1


@pytest.mark.foreign("topology/ISR_label_map.png")
def test_the_map_of_the_original(mdm, original, tmp_path):
    """The passages are those that the original's graph has, and no other."""
    status, output, _ = mdm("map", "show", *original, "--json")
    facts = json.loads(output[0])
    assert status == 0
    ways = {frozenset((place["name"], way["to"])) for place in facts["places"] for way in place["ways"]}
    assert {frozenset(passage["between"]) for passage in facts["passages"]} == ways
    assert len(ways) == 5
    assert all(way["width"] > 1.2 for place in facts["places"] for way in place["ways"])
    assert mdm("map", "show", *original, "-o", tmp_path / "floor.png")[0] == 0
    assert size(tmp_path / "floor.png")[0] > 1000


def test_the_floors_of_a_building_are_shown_with_its_lifts(mdm, tmp_path):
    building = write_building(tmp_path / "site")
    picture = tmp_path / "site.png"
    status, output, errors = mdm("map", "show", building, "-o", picture, "--radius", "0.12")
    assert (status, errors) == (0, "")
    assert [line for line in output if line.startswith("floor ")] == ["floor ground", "floor upper"]
    assert output[-4:] == [
        "lifts",
        "  lift: ground.store - upper.store, 12 s from one to the next",
        "the robot starts in ground.hall",
        f"{picture}: drawn",
    ]
    alone = tmp_path / "ground.png"
    files = [tmp_path / "site" / "ground" / name for name in ("map.yaml", "labels.ppm", "graph.xml")]
    assert mdm("map", "show", *files, "-o", alone, "--radius", "0.12")[0] == 0
    with Pillow.open(picture) as both, Pillow.open(alone) as one:
        assert both.width == one.width
        assert both.height > 2 * one.height
        again = both.crop((0, 34, one.width, 34 + one.height))
        rows = np.argwhere((np.asarray(again) != np.asarray(one)).any(axis=(1, 2)))
        assert 5 < len(rows) < 60  # where the lift leads is all that is more
    facts = json.loads(mdm("map", "show", building, "--json")[1][0])
    assert [place["name"] for place in facts["floors"]["upper"]["places"]] == ["hall", "office", "store"]
    assert facts["lifts"] == [
        {"name": "lift", "stops": ["ground.store", "upper.store"], "seconds": 12.0, "one_way": False}
    ]


def test_a_building_is_given_alone_and_its_files_are_kept(mdm, floor, tmp_path):
    building = write_building(tmp_path)
    status, _, errors = mdm("map", "show", building, floor[2])
    assert status == 2
    assert "a building's file names maps, graphs and labels itself: give it alone" in errors
    status, _, errors = mdm("map", "show", tmp_path / "no.toml")
    assert (status, errors.count("no.toml: there is no such file")) == (1, 1)


@pytest.mark.parametrize("verb", ["goals -o rooms.xml", "draft graph.xml -o labels.png"])
def test_what_is_for_one_floor_refuses_a_building(mdm, tmp_path, monkeypatch, verb):
    write_building(tmp_path)
    monkeypatch.chdir(tmp_path)
    name, *rest = verb.split()
    status, _, errors = mdm("map", name, "building.toml", *rest)
    assert status == 2
    assert "building.toml: this is of a whole building: give the map of one floor" in errors
