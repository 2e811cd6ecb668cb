"""Floors as text and as pictures."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from maps.floors import flat, offices

from mdm.maps import Graph, Labels, Map, Node
from mdm.views.floor import FloorView, Mark
from mdm.views.palette import Palette

PLAIN = Palette(0)


def test_a_robot_is_an_arrow_where_it_is_and_others_are_letters():
    floor = flat().map()
    view = FloorView(floor)
    goal = floor.graph.node("study").goal
    at = {}
    for yaw, arrow in ((0.0, "→"), (math.pi / 2, "↑"), (-math.pi / 2, "↓"), (math.pi, "←"), (2.4, "↖"), (0.7, "↗")):
        lines = view.text([Mark(goal.x, goal.y, yaw=yaw)], columns=60, rows=24, palette=PLAIN).splitlines()
        (at[arrow],) = [(row, line.index(arrow)) for row, line in enumerate(lines) if arrow in line]
    assert len(set(at.values())) == 1
    lines = view.text([Mark(goal.x, goal.y, "F")], columns=60, rows=24, palette=PLAIN).splitlines()
    row, column = at["→"]
    assert lines[row][column] == "F"
    lower = view.text([Mark(goal.x, goal.y - 2.0, "F")], columns=60, rows=24, palette=PLAIN).splitlines()
    assert lower[row + 1 :] != lines[row + 1 :]


@pytest.mark.parametrize(("columns", "rows"), [(80, 24), (40, 60), (200, 50), (10, 3)])
def test_text_fits_in_the_terminal_and_shows_walls_and_doors(columns, rows):
    floor = offices().map()
    plain = FloorView(floor).text(columns=columns, rows=rows, palette=PLAIN)
    lines = plain.splitlines()
    assert len(lines) <= rows
    assert max(map(len, lines)) <= columns
    coloured = FloorView(floor).text(columns=columns, rows=rows)
    bare = re.sub(r"\x1b\[[0-9;]*m", "", coloured).splitlines()
    assert len(bare) == len(lines)
    if columns >= 80:
        assert {name for name in floor.labels.names if name in plain} == set(floor.labels.names)
        assert plain.count("#") > 3 * len(lines)


@pytest.mark.parametrize("drawn", [flat, offices])
@pytest.mark.parametrize(("columns", "rows", "stretch"), [(80, 15, 2.5), (80, 24, 1.0), (30, 12, 1.0), (200, 48, 1.5)])
def test_names_and_trails_cross_no_wall(drawn, columns, rows, stretch):
    floor = drawn().map()
    view, names = FloorView(floor), floor.labels.names
    size = {"columns": columns, "rows": rows, "stretch": stretch, "palette": PLAIN}
    trail = [(node.goal.x, node.goal.y) for node in floor.graph.nodes]
    walls, lines = (view.text(**size, trail=points).splitlines() for points in ((), trail))
    short = dict(zip(names, "abcdefghij", strict=False))
    letters = Graph(tuple(Node(short[node.name], node.goal) for node in floor.graph.nodes), ())
    bare = Map(Labels(floor.labels.frame, floor.labels.raster, [short[name] for name in names]), letters, floor.grid)
    empty = FloorView(bare).text(**size).splitlines()
    for plain, written, dotted in zip(empty, walls, lines, strict=True):
        assert [at for at, sign in enumerate(plain) if sign == "#"] == [
            at for at, sign in enumerate(written) if sign == "#"
        ]
        assert [sign for sign in dotted if sign not in "• "] == [sign for sign in written if sign != " "]
    assert "".join(lines).count("•") <= len(names)
    text = "\n".join(walls)
    assert sum(name in text for name in names) >= (len(names) if columns >= 80 else 1)


@pytest.mark.parametrize("drawn", [flat, offices])
@pytest.mark.parametrize(("columns", "rows", "stretch"), [(80, 15, 2.5), (80, 15, 1.0), (72, 24, 1.0), (31, 40, 1.0)])
def test_walls_are_all_around(drawn, columns, rows, stretch):
    view = FloorView(drawn().map())
    lines = view.text(columns=columns, rows=rows, stretch=stretch, palette=PLAIN).splitlines()
    assert len(lines) <= rows
    assert max(map(len, lines)) <= columns
    edges = [line.strip() for line in lines if line.strip()]
    assert {edge[0] + edge[-1] for edge in edges} == {"##"}
    assert set(edges[-1]) <= {"#", " "}


def test_thin_walls_are_drawn_wherever_they_lie():
    """Where two places are side by side on the screen there is a door: they touch in the cells that are drawn there."""
    floor = flat().map()
    view, raster = FloorView(floor), np.pad(floor.labels.raster.astype(int), 8)
    scale = view._scaled(80, 15, 1.0)
    drawn = view._sampled(scale)
    top, left = (edge + 8 for edge in view._window[:2])
    without_door = beside = 0
    for down, right in ((1, 0), (0, 1)):
        for row in range(drawn.shape[0] - down):
            for column in range(drawn.shape[1] - right):
                one, other = sorted((drawn[row, column], drawn[row + down, column + right]))
                if one > 0 and one != other:
                    first = int(top + row * scale.down), int(left + column * scale.side)
                    last = int(top + (row + 1 + down) * scale.down), int(left + (column + 1 + right) * scale.side)
                    cells = raster[first[0] : last[0], first[1] : last[1]]
                    sides = (cells[1:], cells[:-1]) if down else (cells[:, 1:], cells[:, :-1])
                    without_door += not ((np.minimum(*sides) == one) & (np.maximum(*sides) == other)).any()
                    beside += 1
    assert beside > 5
    assert without_door == 0


def test_a_floor_may_be_drawn_wider_than_it_is():
    view = FloorView(offices().map())
    true, wide = (view.text(columns=80, rows=12, stretch=by, palette=PLAIN).splitlines() for by in (1.0, 3.0))
    assert len(true) == len(wide) <= 12
    assert max(map(len, true)) < 60 < max(map(len, wide)) <= 80


def test_colours_are_those_of_places():
    floor = offices().map()
    coloured = FloorView(floor).text(columns=80, rows=30)
    backs = set(re.findall(r"\x1b\[48;2;(\d+;\d+;\d+)m", coloured))
    assert len(backs) == len(floor.labels.names) + 1  # and walls


def test_names_are_shortened_where_their_place_has_no_room():
    """And a code for colours is there where they change alone."""
    floor = offices().map()
    names = {"east": "east-of-the-offices"}
    goals = Graph(tuple(Node(names.get(node.name, node.name), node.goal) for node in floor.graph.nodes), ())
    named = Map(Labels(floor.labels.frame, floor.labels.raster, goals.names), goals, floor.grid)
    coloured = FloorView(named).text(columns=47, rows=60)
    bare = re.sub(r"\x1b\[[0-9;]*m", "", coloured)
    assert "east-of-the-off…" in bare
    assert "east-of-the-offices" in re.sub(r"\x1b\[[0-9;]*m", "", FloorView(named).text(columns=80, rows=60))
    assert coloured.count("\x1b[48") < len(bare) / 4


def test_marks_off_the_floor_are_left_out():
    view = FloorView(flat().map())
    assert view.text([Mark(1e6, 0.0, "X")], palette=PLAIN) == view.text(palette=PLAIN)


def test_a_picture_shows_a_trail_and_the_lines_of_its_title():
    floor = flat().map()
    view = FloorView(floor)
    ends = [(node.goal.x, node.goal.y) for node in floor.graph.nodes[:2]]
    without, drawn = (np.asarray(view.image(trail=trail, title="one")) for trail in ((), ends))
    rows, columns = (without != drawn).any(axis=2).nonzero()
    assert 50 < len(rows) < 0.05 * without.shape[0] * without.shape[1]
    assert max(np.ptp(rows), np.ptp(columns)) > 50
    assert np.asarray(view.image(title="one\ntwo\nthree")).shape[0] > without.shape[0] + 20


def test_a_picture_shows_marks_above_names():
    floor = flat().map()
    view = FloorView(floor)
    goal = floor.graph.node("living").goal
    without, marked = (np.asarray(view.image(marks)) for marks in ([], [Mark(goal.x, goal.y, ink=(1, 2, 250))]))
    changed = np.argwhere((without != marked).any(axis=2))
    assert 50 < len(changed) < 5000
    row, column = changed.mean(axis=0).round().astype(int)
    assert (np.abs(changed - (row, column)) < 60).all()
    assert (marked == (1, 2, 250)).all(axis=2).any()
