"""What the demo draws on a terminal, as a terminal of another project shows it."""

from __future__ import annotations

import asyncio
import fcntl
import io
import math
import os
import re
import select
import signal
import struct
import subprocess
import sys
import termios
from contextlib import redirect_stdout, suppress
from importlib import import_module

import pyte
import pytest
from places import EXAMPLES, ROOT

import mdm
from mdm.maps.picture import contrast
from mdm.views.palette import Palette

MODULES = ("building", "display", "panel", "terminal")
SECONDS = 20
BEGINS = b"\x1b[?2026h"
SIZES, SMALL = [(80, 24), (200, 50)], [(40, 15), (20, 8), (139, 24), (140, 12)]
SHOWN = [(*size, 1 << 24) for size in SIZES] + [(80, 24, 256), *((*size, 0) for size in [(80, 24), *SMALL])]
BLACK, WHITE = (0, 0, 0), (255, 255, 255)


class Frame:
    """A screen as it is seen, and where the robot had been until then."""

    def __init__(self, screen, trail, marks):
        self.lines, self.trail, self.marks = list(screen.display), trail, marks
        self.cells = [[screen.buffer[row][column] for column in range(screen.columns)] for row in range(screen.lines)]

    def text(self):
        return "\n".join(line.rstrip() for line in self.lines)


@pytest.fixture(scope="module")
def shown():
    """Return the frames of a run in virtual time, and its display, of a size and with so many colours."""
    path = [*sys.path]
    sys.path.insert(0, str(EXAMPLES / "patrol"))
    frames, display = run()
    yield lambda *which: (frames[which], display)
    sys.path[:] = path
    forget()


def forget():
    for name in MODULES:
        sys.modules.pop(name, None)


def run():
    """Run once, and draw each frame on screens of all sizes and with all numbers of colours."""
    forget()
    example = import_module("display")
    written = io.StringIO()
    screens = {which: pyte.Screen(*which[:2]) for which in SHOWN}
    streams = {which: pyte.Stream(screen) for which, screen in screens.items()}
    frames = {which: [] for which in SHOWN}

    class Seen(example.Display):
        def draw(self):
            if self.seconds() % 4 >= 0.2:
                return
            marks = [(mark.x, mark.y, mark.sign or mark.arrow) for mark in self.marks()]
            for which in SHOWN:
                columns, rows, colours = which
                self.palette = Palette(colours)
                patch.setenv("COLUMNS", str(columns))
                patch.setenv("LINES", str(rows))
                super().draw()
                streams[which].feed(written.getvalue().replace("\n", "\r\n"))
                frames[which].append(Frame(screens[which], [*self.trail], marks))
                written.truncate(written.seek(0))

    async def main():
        system = mdm.load_system(EXAMPLES / "patrol" / "patrol.toml")
        display = Seen(system, moving=True, palette=Palette(0), film=None)
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(display)
            await runtime.start(system)
            await asyncio.sleep(SECONDS)
        return display

    with pytest.MonkeyPatch.context() as patch, redirect_stdout(written):
        display = mdm.run(main, virtual=True)
    return frames, display


@pytest.mark.parametrize(("columns", "rows"), SMALL)
def test_no_line_is_longer_than_the_terminal(shown, columns, rows):
    """What does not fit is cut where terminals do so; here nothing has to be."""
    frames, display = shown(columns, rows, 0)
    for frame in frames:
        assert not frame.lines[-1].strip()
    for row in display.panel():
        for wide in (20, 40, 62, 80):
            lines = row.lines(wide, 2, Palette(0))
            assert len(lines) <= 2
            assert max(map(len, lines)) <= wide


@pytest.mark.parametrize(("columns", "rows"), SIZES)
def test_the_floor_is_as_wide_as_there_is_room_and_its_panel_has_four_rows(shown, columns, rows):
    frames, _ = shown(columns, rows, 1 << 24)
    assert len(frames) >= SECONDS // 4
    for frame in frames[1:]:
        labels = re.findall(r"(observes|top decides|patrol decides| does)  (?=\S)", frame.text())
        assert [label.strip() for label in labels] == ["observes", "top decides", "patrol decides", "does"]
        assert not frame.lines[-1].strip()
        wide = columns if columns < 140 else columns - 64
        across = [
            column
            for line in frame.cells[: 14 if columns == 80 else 49]
            for column, cell in enumerate(line[:wide])
            if cell.bg != "default" or cell.fg != "default"
        ]
        assert max(across) - min(across) >= 0.9 * wide
    everything = " ".join(frame.text() for frame in frames)
    assert "since person is yes, was no" in everything
    assert "the policy's" in everything
    assert "drives to " in everything


@pytest.mark.parametrize(("columns", "rows"), SIZES)
def test_names_are_whole_and_within_rooms(shown, columns, rows):
    """A name has one background, that of its room, which no other name has; and so has what stands beside it."""
    frames, display = shown(columns, rows, 1 << 24)
    frame, names, backs = frames[0], display.view.floor.labels.names, {}
    for name in names:
        (row,) = [row for row, line in enumerate(frame.lines[: 15 if columns == 80 else 49]) if name in line[:136]]
        start = frame.lines[row].index(name)
        around = {cell.bg for cell in frame.cells[row][start - 1 : start + len(name) + 1]}
        assert len(around) == 1
        assert "default" not in around
        backs[name] = around.pop()
    assert len(set(backs.values())) == len(names)


@pytest.mark.parametrize(("columns", "rows", "colours"), [which for which in SHOWN if which[2]])
def test_all_text_can_be_read_on_black_and_on_white(shown, columns, rows, colours):
    frames, _ = shown(columns, rows, colours)
    inks = set()
    for frame in frames:
        for line in frame.cells:
            for cell in line:
                if cell.data not in " ▀▄•" and (cell.fg, cell.bg) != ("default", "default"):
                    inks.add((cell.fg, cell.bg))
    assert len(inks) > 8
    for front, back in inks:
        assert front != "default"
        for behind in (BLACK, WHITE) if back == "default" else (parts(back),):
            assert contrast(parts(front), behind) >= 4.5, (front, back)


def parts(colour):
    return tuple(bytes.fromhex({"black": "000000", "white": "ffffff"}.get(colour, colour)))


@pytest.mark.parametrize(("columns", "rows"), SIZES)
def test_the_trail_is_where_the_robot_has_been(shown, columns, rows):
    frames, display = shown(columns, rows, 1 << 24)
    for frame in frames[1:]:
        wide = 136 if columns == 200 else columns
        dots = {
            (row, column)
            for row, line in enumerate(frame.lines[: rows - 1 if columns == 200 else 15])
            for column, sign in enumerate(line[:wide])
            if sign == "•"
        }
        here = [(x, y) for x, y, sign in frame.marks if sign in "→↗↑↖←↙↓↘"]
        (robot,) = here
        assert math.dist(robot, frame.trail[-1]) < 0.6
        high = (rows - 1) if columns == 200 else rows - 9
        scale = display.view._scaled(wide, high, 2.5)
        been = {display.view._at(scale, *point) for point in frame.trail}
        assert dots <= been
        assert len(dots) > 1 or len(been) < 5
        for row, column in been - dots:  # which is below a name or a mark
            assert frame.lines[row][column] not in " ▀▄#"


def test_without_colours_there_is_no_code_for_one_and_walls_are_signs(shown):
    frames, _ = shown(80, 24, 0)
    for frame in frames:
        assert {(cell.fg, cell.bg) for line in frame.cells for cell in line} == {("default", "default")}
        assert frame.text().count("#") > 100


@pytest.mark.timeout(60)
def test_a_terminal_that_changes_its_size_is_followed_and_left_as_it_was():
    here, there = os.openpty()

    def resize(columns, rows):
        fcntl.ioctl(there, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    resize(80, 24)
    process = subprocess.Popen(
        [sys.executable, "-W", "error", str(EXAMPLES / "patrol" / "patrol.py"), "--seconds", "60"],
        stdin=subprocess.DEVNULL,
        stdout=there,
        stderr=subprocess.PIPE,
        env={"PATH": os.environ["PATH"], "PYTHONPATH": str(ROOT), "TERM": "xterm-256color"},
    )
    os.set_blocking(here, False)
    written, seen = b"", []
    for columns, rows in ((80, 24), (150, 40), (50, 20)):
        resize(columns, rows)
        written = b""
        screen = pyte.Screen(columns, rows)
        while not is_drawn(screen, written, columns):
            assert process.poll() is None
            select.select([here], [], [], 1)
            with suppress(BlockingIOError):
                written += os.read(here, 65536)
        seen.append(screen)
    process.send_signal(signal.SIGINT)
    while process.poll() is None:
        select.select([here], [], [], 0.1)
        with suppress(BlockingIOError):
            written += os.read(here, 65536)
    os.close(there)
    os.close(here)
    assert (process.returncode, process.communicate()[1]) == (130, b"")
    assert b"\x1b[?25h" in written
    assert b"\x1b[?1049l" in written  # and what was there before is there again


def is_drawn(screen, written, columns):
    """Return whether the last whole frame that was written has the width of the screen."""
    *_, last = [b"", *written.split(BEGINS)[1:-1]]
    screen.reset()
    pyte.Stream(screen).feed(last.decode().replace("\r\n", "\n").replace("\n", "\r\n"))
    used = [
        column
        for line in screen.buffer.values()
        for column, cell in line.items()
        if cell.bg != "default" or cell.data != " "
    ]
    beside = columns >= 140
    return (
        bool(last) and max(used) >= 0.85 * columns and any("observes" in line for line in screen.display[:5]) is beside
    )
