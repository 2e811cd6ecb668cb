"""``mdm map draft``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from floor_file import GRAPH, free, rooms
from PIL import Image as Pillow

from mdm.maps import load_map


@pytest.fixture
def given(floor):
    return [floor[0], floor[2]]


def test_a_draft_is_told_as_a_table_and_read_again(mdm, floor, given, tmp_path):
    labels = tmp_path / "draft.png"
    status, output, errors = mdm("map", "draft", *given, "-o", labels)
    assert (status, errors) == (0, "")
    assert output[0].split() == ["place", "cells", "area", "neighbours"]
    assert [line.split()[0] for line in output[1:4]] == ["hall", "office", "store"]
    assert output[1].endswith("office (0.40 m), store (0.60 m)")
    assert output[2].endswith("hall (0.40 m)")
    assert output[-1] == f"{labels}: a draft; correct it in a paint program, then mdm map check"
    assert not [line for line in output if line.startswith("note")]
    drawn = load_map(floor[2], grid=floor[0], labels=labels).labels
    agrees = [drawn.names[label - 1] if label else "" for label in drawn.raster[free()]] == rooms()[free()]
    assert agrees.mean() > 0.98
    assert mdm("map", "check", floor[0], labels, floor[2], "--radius", "0.12")[0] == 0


def test_where_the_graph_and_the_draft_differ(mdm, given, tmp_path):
    Path(given[1]).write_text(GRAPH.replace('"Left">hall', '"Left">office').replace('"Right">store', '"Right">office'))
    status, output, _ = mdm("map", "draft", *given, "-o", tmp_path / "draft.png")
    assert status == 0
    assert [line for line in output if line.startswith("note")] == [
        "note: the graph has a way between 'office' and 'store', and in the draft they do not touch",
        "note: 'hall' and 'store' touch in the draft, and the graph has no way between them",
    ]


def test_as_json(mdm, given, tmp_path):
    status, output, _ = mdm("map", "draft", *given, "-o", tmp_path / "draft.png", "--json")
    facts = json.loads(output[0])
    assert status == 0
    assert facts["labels"] == str(tmp_path / "draft.png")
    assert (facts["apart"], facts["touching"]) == ([], [])
    assert sum(place["cells"] for place in facts["places"]) == free().sum()
    assert facts["places"][1]["area"] == pytest.approx(facts["places"][1]["cells"] * 0.01)
    assert facts["places"][2]["neighbours"] == [{"name": "hall", "width": pytest.approx(0.6)}]


def test_no_input_is_overwritten(mdm, floor, tmp_path):
    image = Path(floor[0]).parent / "image.png"
    with Pillow.open(Path(floor[0]).parent / "map.pgm") as picture:
        picture.save(image)
    Path(floor[0]).write_text(Path(floor[0]).read_text().replace("map.pgm", "image.png"))
    graph = Path(floor[2]).rename(tmp_path / "graph.png")
    for output in (image, graph):
        before = output.read_bytes()
        status, told, errors = mdm("map", "draft", floor[0], graph, "-o", output)
        assert (status, told) == (1, [])
        assert "this file is an input and would be overwritten" in errors
        assert output.read_bytes() == before
    before = image.read_bytes()
    assert mdm("map", "show", *floor[:2], graph, "-o", image)[0] == 1
    assert image.read_bytes() == before


@pytest.mark.parametrize("name", ["map.yaml", "map.pgm", "graph.xml"])
@pytest.mark.parametrize("content", [None, b"", b"\0\1", b"{", b"[", b"<", b"P5 1 1 255\n\0", b"a: &a [*a]\n"])
def test_broken_files_give_a_sentence(mdm, given, tmp_path, name, content):
    path = Path(given[0]).parent / name
    if content is None:
        path.unlink()
    else:
        path.write_bytes(content)
    status, output, errors = mdm("map", "draft", *given, "-o", tmp_path / "draft.png")
    assert (status, output) == (1, [])
    assert errors.startswith("mdm map draft: ")
    assert name in errors or content == b"P5 1 1 255\n\0"  # an image of one cell, in which no goal lies
    assert errors.count("\n") == 1
    assert not (tmp_path / "draft.png").exists()


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("0.0 3.0 0", "0.0 300.0 0", "the goal of 'hall': the point 0, 300 lies outside the map"),
        ("0.0 3.0 0", "-0.99 3.0 0", "the goal of 'hall': the point -0.99, 3 lies in a wall"),
        ("0.0 3.0 0", "0.0 5.0 0", "the goals of 'hall' and 'office' are one cell"),
        ("0.0 3.0 0", "nan 3.0 0", "x, y and yaw were expected"),
    ],
)
def test_goals_that_stand_for_no_room(mdm, given, tmp_path, before, after, words):
    Path(given[1]).write_text(GRAPH.replace(before, after))
    status, output, errors = mdm("map", "draft", *given, "-o", tmp_path / "draft.png")
    assert (status, output) == (1, [])
    assert words in errors
    assert "Traceback" not in errors
    assert not (tmp_path / "draft.png").exists()


@pytest.mark.parametrize(
    ("output", "words"),
    [("draft.gif", "its file ends in .png"), ("nowhere/draft.png", "nowhere/draft.png"), ("folder.png", "a folder")],
)
def test_places_where_nothing_can_be_written(mdm, given, tmp_path, output, words):
    (tmp_path / "folder.png").mkdir()
    status, told, errors = mdm("map", "draft", *given, "-o", tmp_path / output)
    assert (status, told) == (1, [])
    assert words in errors


def test_wrong_usage_is_2(mdm, given):
    status, output, errors = mdm("map", "draft", *given)
    assert (status, output) == (2, [])
    assert "-o/--output" in errors


@pytest.mark.foreign("topology/ISR_label_map.png")
def test_the_map_of_the_original_seeded_with_its_own_goals(mdm, original, tmp_path):
    """All five passages are found, and no other."""
    status, output, errors = mdm("map", "draft", original[0], original[2], "-o", tmp_path / "draft.png", "--json")
    facts = json.loads(output[0])
    assert (status, errors) == (0, "")
    assert (facts["apart"], facts["touching"]) == ([], [])
    found = {frozenset((place["name"], other["name"])) for place in facts["places"] for other in place["neighbours"]}
    assert len(found) == 5
