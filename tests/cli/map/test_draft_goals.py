"""``mdm map goals``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from PIL import Image as Pillow

from mdm.maps import load_graph


def test_a_proposal_is_told_as_a_table_and_taken_by_the_other_verbs(mdm, floor, tmp_path):
    """From the map alone to a policy, by nothing but commands."""
    graph, labels = tmp_path / "graph.xml", tmp_path / "labels.png"
    options = ("--radius", "0.12", "--least", "2", "--picture", tmp_path / "rooms.png")
    status, output, errors = mdm("map", "goals", floor[0], "-o", graph, *options)
    assert (status, errors) == (0, "")
    assert output[0].split() == ["place", "free", "goal", "ways", "to"]
    assert [line.split()[0] for line in output[1:4]] == ["Room1", "Room2", "Room3"]
    assert output[1].endswith("Room3")  # the office, from which a door leads to the hall
    assert output[-1] == f"{graph}: a proposal; correct it in an editor, then mdm map draft"
    with Pillow.open(tmp_path / "rooms.png") as picture:
        assert picture.size == (960, 960)
    assert len(load_graph(graph).edges) == 4
    assert mdm("map", "draft", floor[0], graph, "-o", labels)[0] == 0
    assert mdm("map", "check", floor[0], labels, graph, "--radius", "0.12")[0] == 0
    model = (tmp_path / "model.npz", "--reward", "Room1=1")
    assert mdm("map", "model", floor[0], labels, graph, "-o", *model)[0] == 0
    assert mdm("solve", tmp_path / "model.npz", "-o", tmp_path / "policy.npz")[0] == 0


def test_as_json(mdm, floor, tmp_path):
    command = ("map", "goals", floor[0], "-o", tmp_path / "graph.xml", "--least", "2", "--radius", "0.12", "--json")
    status, output, _ = mdm(*command)
    facts = json.loads(output[0])
    assert status == 0
    assert facts["graph"] == str(tmp_path / "graph.xml")
    assert [place["name"] for place in facts["places"]] == ["Room1", "Room2", "Room3"]
    assert sum(place["area"] for place in facts["places"]) == pytest.approx(13.97)
    assert facts["left_out"] == 0


def test_a_floor_that_nothing_divides(mdm, floor, tmp_path):
    status, output, _ = mdm("map", "goals", floor[0], "-o", tmp_path / "graph.xml", "--least", "100")
    assert status == 0
    assert any(line.startswith("note: nothing divides this floor") for line in output)


def test_no_input_is_overwritten_and_nothing_is_written_where_it_fails(mdm, floor, tmp_path):
    grid = Path(floor[0]).rename(tmp_path / "floor" / "map.xml")
    before = grid.read_bytes()
    status, told, errors = mdm("map", "goals", grid, "-o", grid)
    assert (status, told) == (1, [])
    assert "this file is an input and would be overwritten" in errors
    assert grid.read_bytes() == before
    status, told, errors = mdm("map", "goals", grid, "-o", tmp_path / "graph.xml", "--radius", "9")
    assert (status, told) == (1, [])
    assert errors == "mdm map goals: a robot with a radius of 9 m fits nowhere on this map\n"
    assert not (tmp_path / "graph.xml").exists()
    assert mdm("map", "goals", grid, "-o", tmp_path / "graph.xml", "--picture", tmp_path / "x.gif")[0] == 1
