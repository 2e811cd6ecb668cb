"""A building's file."""

from __future__ import annotations

import pytest
from building_file import BUILDING, write_building
from floor_file import GRAPH
from sentences import refused

from mdm.errors import FormatError, MapError
from mdm.maps import Lift, Pose, load_floors
from mdm.maps.files.building import load_building


def test_floors_and_lifts_are_read(tmp_path):
    floors = load_floors(write_building(tmp_path))
    assert list(floors.maps) == ["ground", "upper"]
    assert floors.lifts == (Lift("lift", ("ground.store", "upper.store"), 12.0),)
    assert floors.start == "ground.hall"
    assert floors.graph.node("upper.store").goal == Pose(2.0, 3.5, -1.0, floor="upper")


def test_all_files_that_are_read_are_named(tmp_path):
    building = load_building(write_building(tmp_path))
    names = {path.relative_to(tmp_path).as_posix() for path in building.files}
    each = {f"{floor}/{file}" for floor in ("ground", "upper") for file in ("map.yaml", "map.pgm", "graph.xml")}
    assert names == {"building.toml", *each, "ground/labels.ppm", "upper/labels.ppm"}


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ('start = "ground.hall"', "start = ground", "building.toml:2:9: this is no TOML: "),
        ('start = "ground.hall"', 'start = "hall"', "building.toml:2: there is no place 'hall'"),
        ('start = "ground.hall"', "start = 3", "building.toml:2: start: a text was expected, not 3"),
        ('start = "ground.hall"', 'strat = "hall"', "building.toml:2: the file has a key 'strat', which is none; the"),
        ('labels = "ground/labels.ppm"', 'lables = "x"', "building.toml:7: [floors.ground] has a key 'lables'"),
        ('map = "upper/map.yaml"', "", "building.toml:9: [floors.upper] has no key 'map', which is needed"),
        ('graph = "upper/graph.xml"', "graph = 4", "building.toml:11: floors.upper.graph: a text was expected, not 4"),
        ('graph = "upper/graph.xml"', 'graph = ""', "building.toml:11: the path of a file was expected, not ''"),
        ('graph = "upper/graph.xml"', 'graph = "no.xml"', "no.xml: there is no such file"),
        ('labels = "upper/labels.ppm"', "reach = -1.0", "building.toml:9: places that reach -1 m from their goals"),
        ("[floors.upper]", '[floors."up.per"]', "building.toml:4: a floor is called 'up.per'"),
        ('"upper.store"', '"upper.loft"', "building.toml:15: 'lift' stops at 'upper.loft', and there is no such place"),
        ('"upper.store"', '"roof.loft"', "building.toml:15: 'lift' stops at 'roof.loft', and there is no such floor"),
        ('"upper.store"', '"ground.hall"', "building.toml:15: 'lift' stops twice on the floor 'ground'"),
        ("12.0", "0", "building.toml:16: 'lift' takes 0.0 s: give seconds above 0"),
        ("12.0", '"long"', "building.toml:16: lifts.lift.seconds: a number was expected, not 'long'"),
        ("seconds = 12.0", "", "building.toml:14: [lifts.lift] has no key 'seconds'"),
        (BUILDING, "[floors]", "building.toml:1: there are no floors"),
        (BUILDING, "floors = 3", "building.toml:1: floors: a table was expected, not 3"),
        (BUILDING, "[lifts]", "building.toml: the file has no key 'floors', which is needed"),
    ],
)
def test_wrong_files_are_told_with_their_line(tmp_path, before, after, words):
    with pytest.raises(FormatError) as caught:
        load_floors(write_building(tmp_path, BUILDING.replace(before, after)))
    assert words in str(caught.value)


def test_what_stands_in_a_line_of_its_own_or_not_has_a_line(tmp_path):
    text = BUILDING[: BUILDING.index("[lifts")] + '[lifts]\n"a b" = { stops = ["ground.hall"], seconds = 1 }\n'
    with refused(FormatError):
        load_floors(write_building(tmp_path, text))


def test_files_of_a_floor_that_do_not_fit_are_told_with_the_floor(tmp_path):
    graph = GRAPH.replace('"office"', '"attic"').replace(">office<", ">attic<").replace("0.0 5.0", "0.0 -50.0")
    path = write_building(tmp_path, graphs={"upper": graph})
    with refused(MapError):
        load_floors(path)
    assert load_building(path).floors["upper"].problems
