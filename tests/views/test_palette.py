"""Colours of actions and of terminals."""

from __future__ import annotations

import re
from pathlib import Path

import pyte
import pytest

from mdm.maps.picture import contrast
from mdm.views import web
from mdm.views.palette import ACTIONS, Palette


@pytest.mark.parametrize(
    ("environment", "colours"),
    [
        ({"TERM": "xterm-256color"}, 256),
        ({"TERM": "xterm"}, 256),
        ({"TERM": "xterm-256color", "COLORTERM": "truecolor"}, 1 << 24),
        ({"TERM": "xterm-256color", "COLORTERM": "truecolor", "NO_COLOR": "1"}, 0),
        ({"TERM": "xterm-256color", "NO_COLOR": ""}, 256),
        ({"TERM": "dumb", "COLORTERM": "truecolor"}, 0),
        ({"TERM": "vt100"}, 0),
        ({}, 0),
    ],
)
def test_a_terminal_is_asked_by_its_environment(environment, colours):
    assert Palette.of(environment) == Palette(colours)
    assert bool(Palette.of(environment)) is (colours > 0)


def test_a_terminal_shows_what_is_asked_for():
    def shown(palette, ink, back):
        screen = pyte.Screen(10, 1)
        pyte.Stream(screen).feed(palette.inked("x", ink, back, bold=True) + "y")
        return screen.buffer[0][0], screen.buffer[0][1]

    for palette, ink, back in (
        (Palette(), (1, 2, 250), (200, 90, 3)),
        (Palette(256), (0, 135, 95), (255, 215, 175)),  # which are among the 256
    ):
        letter, after = shown(palette, ink, back)
        assert (letter.fg, letter.bg, letter.bold) == (bytes(ink).hex(), bytes(back).hex(), True)
        assert (after.fg, after.bg, after.bold) == ("default", "default", False)
    letter, _ = shown(Palette(0), (1, 2, 3), (4, 5, 6))
    assert (letter.fg, letter.bg, letter.bold) == ("default", "default", False)
    assert Palette(0).front((1, 2, 3)) == ""
    assert (Palette().front(None), Palette().back(None)) == ("\x1b[39m", "\x1b[49m")


@pytest.mark.parametrize("ink", [(234, 12, 26), (44, 110, 238), (30, 80, 220), (250, 240, 200), (7, 136, 43)])
def test_what_can_be_read_can_be_with_fewer_colours(ink):
    screen = pyte.Screen(10, 1)
    pyte.Stream(screen).feed(Palette(256).inked("x", ink))
    fewer = tuple(bytes.fromhex(screen.buffer[0][0].fg))
    for behind in ((0, 0, 0), (255, 255, 255)):
        assert contrast(fewer, behind) >= 4.5 or contrast(ink, behind) < 4.5


def test_the_page_has_the_same_colours_of_actions_as_plots_and_text_on_each_can_be_read():
    sheet = (Path(web.__file__).parent / "static" / "page.css").read_text()
    assert tuple(re.findall(r"--a[0-9]+: (#[0-9a-f]{6});", sheet)) == ACTIONS
    (dark,) = set(re.findall(r"--on-action: (#[0-9a-f]{6});", sheet))
    for colour in ACTIONS:
        assert contrast(*(tuple(bytes.fromhex(each[1:])) for each in (colour, dark))) > 7
