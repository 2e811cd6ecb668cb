"""``mdm map check``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from building_file import BUILDING, write_building
from floor_file import GRAPH, NUMBERS, rooms, write_floor
from PIL import Image as Pillow


def size(path):
    with Pillow.open(path) as picture:
        return picture.size


def test_a_map_without_problems(mdm, floor):
    status, output, errors = mdm("map", "check", *floor, "--radius", "0.1")
    assert (status, errors) == (0, "")
    assert output == [
        f"note: the colour {200 * 0x010101} is no place's: the background, of 203 cells",
        "3 places, no problems",
    ]


def test_problems_are_grouped_and_drawn(mdm, floor, tmp_path):
    graph = tmp_path / "wrong.xml"
    graph.write_text(GRAPH.replace("0.0 3.0 0", "-0.85 3.0 0").replace('"Left">hall', '"Left">store'))
    pictures = tmp_path / "new" / "pictures"
    status, output, errors = mdm("map", "check", *floor[:2], graph, "--radius", "0.1", "--pictures", pictures)
    assert (status, errors) == (1, "")
    assert [line for line in output if not line.startswith((" ", "note"))] == ["goals", "ways", "3 places, 3 problems"]
    assert output[1].startswith("  the goal of 'hall', (-0.85, 3), is 0.10 m from what is not free")
    drawn = sorted(path.name for path in pictures.iterdir())
    assert drawn == ["01-goals.png", "02-ways.png", "03-ways.png"]
    assert f"[{pictures / '01-goals.png'}]" in output[1]
    for name in drawn:
        assert size(pictures / name)[0] > 100


def test_as_json(mdm, floor, tmp_path):
    graph = tmp_path / "wrong.xml"
    graph.write_text(GRAPH.replace('"Left">hall', '"Left">store'))
    status, output, _ = mdm("map", "check", *floor[:2], graph, "--radius", "0.1", "--json")
    facts = json.loads(output[0])
    assert status == 1
    assert facts["places"] == ["hall", "office", "store"]
    assert facts["background"] == {str(200 * 0x010101): 203}
    assert [problem["kind"] for problem in facts["problems"]] == ["ways", "ways"]
    assert facts["problems"][0]["places"] == ["store"]


def test_two_names_of_one_colour_and_all_else_at_once(mdm, floor, tmp_path):
    names = tmp_path / "names.yaml"
    names.write_text("hall: 255\noffice: 255\nstore: 7\nattic: 9\n")
    status, output, _ = mdm("map", "check", *floor, "--names", names, "--radius", "0.1")
    assert status == 1
    text = "\n".join(output)
    for words in (
        "'hall' and 'office' have the same colour, 255",
        "no pixel has the colour of 'store', 7",
        "'attic' has a colour, and is no place",
        "the goal of 'hall', (0, 3), lies in no place",
    ):
        assert words in text


def test_many_problems_of_a_kind_are_counted(mdm, floor, tmp_path):
    labels = Pillow.open(floor[1])
    for index in range(30):
        labels.putpixel((35, 3 + index), (index, 77, 77))
    labels.save(tmp_path / "labels.png")
    status, output, _ = mdm("map", "check", floor[0], tmp_path / "labels.png", floor[2], "--radius", "0.1")
    assert status == 1
    assert output[0] == "colours"
    assert output[11] == "  and 20 more"


def test_a_threshold_that_makes_what_is_unknown_free(mdm, floor):
    """Nav2's map_saver proposes 0.25, and writes 205 for what is unknown: a darkness of 0.196."""
    grid = Path(floor[0])
    with Pillow.open(grid.parent / "map.pgm") as picture:
        before = picture.convert("L")
    before.paste(205, (30, 0, 40, 40))
    before.save(grid.parent / "map.pgm")
    lines = [line for line in grid.read_text().splitlines() if not line.startswith(("free", "occupied"))]
    for free, told in ((0.25, True), (0.195, False)):
        grid.write_text("\n".join([*lines, "occupied_thresh: 0.65", f"free_thresh: {free}", ""]))
        output = mdm("map", "check", *floor, "--radius", "0.1")[1]
        words = (
            "  free_thresh, 0.25, makes all 400 cells of the grey 205 free, and there are brighter ones: is that what"
        )
        assert any(line.startswith(words) for line in output) is told
        if told:
            assert output[0] == "greys"
            assert output[1].endswith("Then give a smaller one: 0.196")


def test_a_free_colour_that_is_no_place_s(mdm, floor, tmp_path):
    """Such as a place whose goal lies on a slip of the brush."""
    labels = Pillow.open(floor[1])
    labels.putpixel((30, 24), (1, 2, 3))
    labels.save(tmp_path / "labels.png")
    arguments = (floor[0], tmp_path / "labels.png", floor[2], "--radius", "0.1", "--pictures", tmp_path / "pictures")
    status, output, _ = mdm("map", "check", *arguments)
    assert status == 1
    assert "  the colour 16711680 is no place's, and 721 of its 721 cells are free: a place is missing?" in output[1]
    assert not any("16711680 is no place's: the background" in line for line in output)


def test_what_is_free_around_a_building_is_no_place(mdm, floor):
    """Simulators' maps are free outside, where nothing leads to."""
    grid = Path(floor[0])
    with Pillow.open(grid.parent / "map.pgm") as picture:
        inside = picture.convert("L")
    with Pillow.open(floor[1]) as picture:
        labels = picture.copy()
    wide = Pillow.new("L", (inside.width + 120, inside.height), 254)
    wide.paste(inside, (0, 0))
    wide.save(grid.parent / "map.pgm")
    around = Pillow.new(labels.mode, wide.size, 0)
    around.paste(labels, (0, 0))
    around.save(floor[1])
    assert mdm("map", "check", *floor, "--radius", "0.1")[0] == 0
    wide.paste(254, (inside.width - 12, 5, inside.width, 12))  # a hole in the wall
    wide.save(grid.parent / "map.pgm")
    status, output, _ = mdm("map", "check", *floor, "--radius", "0.1")
    assert status == 1
    assert output[1].startswith("  the colour 0 is no place's, and ")


def test_zones_in_place_of_an_image(mdm, floor, tmp_path):
    graph = {
        "nodes": [
            {
                "node": {
                    "name": name,
                    "pose": {
                        "position": {"x": x, "y": 3.0},
                        "orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0},
                    },
                    "verts": [{"x": a, "y": b} for a, b in ((-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9))],
                    "edges": [{"edge_id": "e", "node": other}],
                }
            }
            for name, other, x in (("A", "B", 0.0), ("B", "A", 2.0))
        ]
    }
    (tmp_path / "graph.tmap2").write_text(yaml.safe_dump(graph))
    status, output, errors = mdm("map", "check", floor[0], tmp_path / "graph.tmap2", "--radius", "0.1")
    assert (status, output, errors) == (0, ["2 places, no problems"], "")


def test_pictures_need_a_folder(mdm, floor, tmp_path):
    (tmp_path / "file").write_text("")
    for place, words in (
        (tmp_path / "file", "this is a file: give a folder for --pictures"),
        (tmp_path / "file" / "in", "the folder for --pictures cannot be made: Not a directory"),
    ):
        status, output, errors = mdm("map", "check", *floor, "--pictures", place)
        assert (status, output, errors) == (1, [], f"mdm map check: {place}: {words}\n")


@pytest.mark.parametrize("reach", ["1e308", "0"])
def test_a_reach_that_no_place_has(mdm, floor, reach):
    status, output, errors = mdm("map", "show", floor[0], floor[2], "--reach", reach)
    assert (status, output) == (1, [])
    assert "from their goals: give metres above 0, at most 1,000,000" in errors


@pytest.mark.parametrize("name", ["map.yaml", "labels.ppm", "graph.xml"])
@pytest.mark.parametrize("content", [None, b"", b"\0\1", b"{", b"[", b"<", b"P5 1 1 255\n\0", b"a: &a [*a]\n"])
def test_broken_files_give_a_sentence(mdm, tmp_path, name, content):
    floor = write_floor(tmp_path)
    if content is None:
        (tmp_path / name).unlink()
    else:
        (tmp_path / name).write_bytes(content)
    for verb in ("check", "show"):
        status, output, errors = mdm("map", verb, *floor)
        assert (status, output) == (1, [])
        assert errors.startswith(f"mdm map {verb}: ")
        assert name in errors
        assert errors.count("\n") == 1


def bomb():
    lines = ["a0: &a0 [x, x]"] + [f"a{n}: &a{n} [{f'*a{n - 1}, ' * 9}]" for n in range(1, 30)]
    return "\n".join([*lines, "nodes: *a29"])


GEOJSON = {
    "features": [
        {"properties": {"id": 1}, "geometry": {"type": "Point", "coordinates": [0.0, 3.0]}},
        {"properties": {"id": 2}, "geometry": {"type": "Point", "coordinates": [0.0, 5.0]}},
        {"properties": {"id": 3, "startid": 1, "endid": 2}, "geometry": {"type": "LineString", "coordinates": []}},
    ]
}


@pytest.mark.parametrize(
    ("graph", "words"),
    [
        (bomb(), "stands for more than 1,000,000 values"),
        (GRAPH.replace("0.0 3.0 0", "nan 3.0 0"), "graph:3:9: x, y and yaw were expected"),
        (GRAPH.replace("0.0 3.0 0", "0.0 3.0 inf"), "graph:3:9: x, y and yaw were expected"),
        (json.dumps(GEOJSON).replace("3.0", "NaN"), "this is not a route graph in GeoJSON"),
    ],
)
def test_bad_graphs_give_a_sentence(mdm, floor, tmp_path, graph, words):
    (tmp_path / "graph").write_text(graph)
    status, output, errors = mdm("map", "check", *floor[:2], tmp_path / "graph")
    assert (status, output) == (1, [])
    assert words in errors
    assert "Traceback" not in errors


def test_geojson_without_names_goes_by_numbers(mdm, floor, tmp_path):
    (tmp_path / "graph.geojson").write_text(json.dumps(GEOJSON))
    status, output, _ = mdm("map", "check", *floor[:2], tmp_path / "graph.geojson", "--radius", "0.1")
    assert status == 1
    assert "  from '2' there is no way back to '1'" in output


def test_labels_of_another_size(mdm, floor, tmp_path):
    Pillow.open(floor[1]).resize((80, 80)).save(tmp_path / "labels.png")
    status, _, errors = mdm("map", "check", floor[0], tmp_path / "labels.png", floor[2])
    assert status == 1
    assert "labels.png: the image of labels has 80 x 80 pixels, the map 40 x 40: they must be the same" in errors


@pytest.mark.parametrize("mode", ["P", "L", "I;16"])
def test_labels_with_a_palette_or_in_grey(mdm, floor, tmp_path, mode):
    from numpy import select, uint8, uint16

    raster = select([rooms() == name for name in NUMBERS], [1, 2, 3]).astype(uint16 if mode == "I;16" else uint8)
    picture = Pillow.fromarray(raster, mode="P") if mode == "P" else Pillow.fromarray(raster)
    if mode == "P":
        picture.putpalette([0, 0, 0, 9, 9, 9, 8, 8, 8, 7, 7, 7])
    picture.save(tmp_path / "labels.png")
    names = tmp_path / "names.yaml"
    names.write_text("".join(f"{name}: {index}\n" for index, name in enumerate(NUMBERS, 1)))
    arguments = (floor[0], tmp_path / "labels.png", floor[2], "--names", names, "--radius", "0.1")
    assert mdm("map", "check", *arguments)[:2] == (
        0,
        ["note: the colour 0 is no place's: the background, of 203 cells", "3 places, no problems"],
    )


def test_a_map_that_is_turned_by_a_right_angle(mdm, tmp_path):
    """All goals then lie elsewhere, and are told; in the right file, turned with it, nothing is wrong."""
    floor = write_floor(tmp_path, yaw=1.5707963203948966)
    status, output, _ = mdm("map", "check", *floor)
    assert status == 1
    assert any("outside the map" in line for line in output)
    turned = GRAPH
    for x, y in ((0.0, 3.0), (0.0, 5.0), (2.0, 3.5)):
        turned = turned.replace(f"<Goal>{x} {y} ", f"<Goal>{-1 - (y - 2)} {2 + (x + 1)} ")
    Path(floor[2]).write_text(turned)
    assert mdm("map", "check", *floor, "--radius", "0.1")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "required: MAP.yaml"),
        (["a", "b", "c", "--radius", "-1"], "a number of metres, 0 or more"),
        (["a", "b", "c", "--margin", "nan"], "a number of metres, 0 or more"),
        (["a", "b", "c", "--reach", "far"], "a number of metres, 0 or more"),
    ],
)
def test_wrong_usage_is_2(mdm, arguments, words):
    status, output, errors = mdm("map", "check", *arguments)
    assert (status, output) == (2, [])
    assert words in errors


@pytest.mark.foreign("topology/ISR_label_map.png")
def test_the_map_of_the_original(mdm, corpus, original, tmp_path):
    """Seven stray colours, and one goal that is 0.23 m from what is not free; ways and passages are the same."""
    names = corpus / "topology" / "predicate_labels.yaml"
    status, output, _ = mdm("map", "check", *original, "--names", names, "--pictures", tmp_path / "pictures")
    assert status == 1
    assert [line for line in output if not line.startswith(" ")] == [
        "colours",
        "goals",
        "rooms",
        "note: the colour 0 is no place's: the background, of 5,148 cells",
        "note: the colour 14145495 is no place's: the background, of 28,456 cells",
        "note: the colour 14211288 is no place's: the background, of 64,131 cells",
        "6 places, 9 problems",
    ]
    assert len(list((tmp_path / "pictures").iterdir())) == 9
    assert mdm("map", "check", *original, "--radius", "0.15")[1][-1] == "6 places, 8 problems"


def test_the_floors_of_a_building_are_checked_and_what_joins_them(mdm, tmp_path):
    status, output, errors = mdm("map", "check", write_building(tmp_path), "--radius", "0.1")
    assert (status, errors, output[-1]) == (0, "", "6 places on 2 floors, no problems")
    apart = BUILDING[: BUILDING.index("[lifts")]
    status, output, _ = mdm("map", "check", write_building(tmp_path, apart), "--radius", "0.1")
    assert (status, output[-1]) == (1, "6 places on 2 floors, 1 problem")
    assert "  no ways join 'upper.hall', 'upper.office', 'upper.store' with 'ground.hall'" in output
    graphs = {"upper": GRAPH.replace("2.0 3.5", "0.95 3.5")}
    options = ("--radius", "0.1", "--pictures", tmp_path / "pictures")
    status, output, _ = mdm("map", "check", write_building(tmp_path, graphs=graphs), *options)
    assert status == 1
    text = "\n".join(output)
    assert "upper: the goal of 'store', (0.95, 3.5), is not free in the map" in text
    assert "'lift' stops at 'upper.store', and a robot of 0.2 m cannot drive to its goal" in text
    assert (tmp_path / "pictures" / "01-goals.png").exists()
    facts = json.loads(mdm("map", "check", tmp_path / "building.toml", "--radius", "0.1", "--json")[1][0])
    assert {problem["floor"] for problem in facts["problems"]} == {"upper"}
    assert facts["background"]["ground"] == {str(200 * 0x010101): 203}
