"""`mdm show`: rows by names, networks, and pictures of them."""

from __future__ import annotations

import json
import sys

import pytest
from places import MODELS, TIGER


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["T", "listen", "tiger-left"], ["T: from 'tiger-left' by 'listen' to", "  1  tiger-left"]),
        (
            ["O", "0", "1"],
            ["O: after 'listen' has led to 'tiger-right'", "  0.15  hear-left", "  0.85  hear-right"],
        ),
        (["R", "open-left"], ["R: for 'open-left' in", "  -100  tiger-left", "    10  tiger-right"]),
        (["R", "listen", "tiger-left"], ["R: for 'listen' in 'tiger-left'", "  -1"]),
        (["start"], ["the initial belief", "  0.5  tiger-left", "  0.5  tiger-right"]),
    ],
)
def test_show_rows_by_names(mdm, arguments, expected):
    status, output, errors = mdm("show", TIGER, *arguments)
    assert (status, errors) == (0, "")
    assert output == expected


def test_show_of_events_and_networks(mdm, tmp_path):
    guard = MODELS / "guard.pgmx"
    status, output, _ = mdm("show", guard, "T", "wait left", "wide open")
    assert (status, output) == (0, ["T: from 'wide open' by 'wait left' to", "  1  wide open"])
    status, output, _ = mdm("show", guard, "O", "wait left", "wide open", "--from", "shut", "--json")
    entries = json.loads(output[0])["entries"]
    assert entries == [{"symbol": "nothing", "value": 0.5}, {"symbol": "bang", "value": 0.5}]
    status, _, errors = mdm("show", guard, "O", "wait left", "shut")
    assert status == 2
    assert "--from" in errors
    status, output, _ = mdm("show", guard)
    assert "door' (2 values) <- guard, door" in output
    assert "reward 1 <- door', camera" in output
    status, output, _ = mdm("show", TIGER)
    assert output[0].startswith("(the model is not factored")


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["T", "listen"], 2, "T needs 2 symbols, not 1"),
        (["R"], 2, "R needs 1 to 4 symbols"),
        (["T", "listen", "tiger-lef"], 1, "'tiger-left'"),
        (["T", "7", "0"], 1, "its 3 symbols count from 0"),
        (["T", "0", "0", "--picture", "x.png"], 2, "--picture draws the network"),
        (["T", "0", "0", "--from", "0"], 2, "--from is for O"),
        (["Z"], 2, "invalid choice"),
    ],
)
def test_show_with_wrong_symbols(mdm, arguments, status, words):
    found, output, errors = mdm("show", TIGER, *arguments)
    assert (found, output) == (status, [])
    assert words in errors


def test_show_draws_a_picture(mdm, tmp_path):
    pytest.importorskip("matplotlib")
    path = tmp_path / "guard.png"
    status, output, errors = mdm("show", MODELS / "guard.pgmx", "--picture", path)
    assert (status, errors) == (0, "")
    assert output[-1] == f"{path}: drawn"
    assert path.read_bytes().startswith(b"\x89PNG")
    status, _, errors = mdm("show", MODELS / "guard.pgmx", "--picture", tmp_path / "missing" / "guard.png")
    assert status == 1
    assert "cannot be written" in errors


def test_show_without_matplotlib_says_what_to_install(mdm, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    status, _, errors = mdm("show", MODELS / "guard.pgmx", "--picture", tmp_path / "guard.png")
    assert status == 1
    assert "pip install matplotlib" in errors
