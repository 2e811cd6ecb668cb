"""`mdm plot`: pictures that show what they should, and what cannot be drawn."""

from __future__ import annotations

import re
import shutil
import sys
from xml.etree import ElementTree as ET

import pytest
from drawn import grid
from places import ROOT, TIGER, TIGER_VECTORS
from records import tiger

pytest.importorskip("matplotlib")

POLICY = ["policy", TIGER, TIGER_VECTORS]


def test_a_recorded_run_is_drawn(mdm, tmp_path):
    record, path = tiger(tmp_path / "run.mcap"), tmp_path / "run.png"
    assert mdm("plot", "run", record, "-o", path) == (0, [f"{path}: drawn"], "")
    assert path.read_bytes().startswith(b"\x89PNG")
    assert mdm("plot", "run", record, "-o", path, "--since", 2, "--until", 4) == (0, [f"{path}: drawn"], "")
    errors = mdm("plot", "run", record, "-o", path, "--since", 20)[2]
    assert "there is nothing to draw from second 20 on: the record lasts 9.5 s" in errors
    status, _, errors = mdm("plot", "run", record, "-o", path, "--ensemble", "robot")
    assert status == 1
    assert "there is no ensemble 'robot'; there are tiger" in errors
    assert "would be overwritten" in mdm("plot", "run", record, "-o", record)[2]


@pytest.mark.parametrize(
    "arguments",
    [
        POLICY,
        [*POLICY, "--states", "tiger-right", "tiger-left"],
        [*POLICY, "--columns", "2"],
        [*POLICY, "--columns", str(10**30)],
        ["belief", TIGER, TIGER_VECTORS, "--seed", "3", "--steps", "40"],
    ],
)
def test_pictures_are_drawn(mdm, tmp_path, arguments):
    path = tmp_path / "picture.png"
    status, output, errors = mdm("plot", *arguments, "-o", path)
    assert (status, output, errors) == (0, [f"{path}: drawn"], "")
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.stat().st_size > 5000


def test_a_sweep_is_drawn_by_its_journal(mdm, tmp_path):
    (tmp_path / "sweep.toml").write_text('problem = "forest"\n[vary]\nages = [3, 4]\nfire = [0.1, 0.2]\n')
    assert mdm("sweep", tmp_path / "sweep.toml", "-o", tmp_path / "r.csv")[0] == 0
    path = tmp_path / "r.svg"
    assert mdm("plot", "sweep", tmp_path / "r.csv", "-x", "ages", "--by", "fire", "-o", path) == (
        0,
        [f"{path}: drawn"],
        "",
    )
    assert "<svg" in path.read_text()
    journal = (tmp_path / "r.jsonl").read_bytes()
    (tmp_path / "r.jsonl").write_bytes(journal[:-10])  # of a sweep that goes on
    assert mdm("plot", "sweep", tmp_path / "r.csv", "-x", "fire", "-y", "lower", "-o", path)[0] == 0
    assert "the result has no column 'age'" in mdm("plot", "sweep", tmp_path / "r.csv", "-x", "age", "-o", path)[2]


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        ([], 2, "required"),
        (POLICY, 2, "-o"),
        (
            [*POLICY, "-o", "x.png", "--states", "0", "1", "--columns", "3"],
            2,
            "different pictures",
        ),
        ([*POLICY, "-o", "x.png", "--states", "0", "0"], 1, "two states are needed"),
        ([*POLICY, "-o", "x.png", "--axes", "x", "y"], 1, "no factor 'x'"),
        (["bounds", TIGER, "-o", "x.png"], 1, "tiger.pomdp: a history written by mdm solve --history was expected"),
        (["bounds", ROOT / "nothing.json", "-o", "x.png"], 1, "nothing.json"),
        (["sweep", ROOT / "nothing.csv", "-x", "size", "-o", "x.png"], 1, "nothing.jsonl: there is no such file"),
        (["sweep", ROOT / "nothing.csv", "-o", "x.png"], 2, "-x"),
        ([*POLICY, "-o", "x.nothing"], 1, "its file ends in .png, .svg, .pdf"),
        ([*POLICY, "-o", "x"], 1, "its file ends in .png, .svg, .pdf"),
        ([*POLICY, "-o", "no/x.png"], 1, "cannot be written: No such file or directory"),
    ],
)
def test_what_cannot_be_drawn(mdm, tmp_path, monkeypatch, arguments, status, words):
    monkeypatch.chdir(tmp_path)
    found, output, errors = mdm("plot", *arguments)
    assert (found, output) == (status, [])
    assert words in errors
    assert "Traceback" not in errors


def test_what_sees_the_state_has_no_belief(mdm, tmp_path):
    grid(tmp_path)
    inputs = tmp_path / "grid.npz", tmp_path / "policy.npz"
    status, _, errors = mdm("plot", "belief", *inputs, "-o", tmp_path / "x.png")
    assert status == 1
    assert "there is no belief to draw" in errors
    assert mdm("plot", "policy", *inputs, "-o", tmp_path / "x.png")[0] == 0
    assert mdm("plot", "policy", *inputs, "--states", "0", "1", "-o", tmp_path / "x.png")[0] == 2


def test_without_matplotlib_one_sentence(mdm, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    status, output, errors = mdm("plot", "policy", TIGER, TIGER_VECTORS, "-o", "x.png")
    assert (status, output) == (1, [])
    assert errors == "mdm plot: pictures need matplotlib: pip install matplotlib\n"


@pytest.mark.parametrize("picture", ["bounds", "policy", "belief"])
def test_every_picture_has_help_with_an_example(mdm, picture):
    status, output, _ = mdm("plot", picture, "--help")
    assert status == 0
    assert any(line.startswith("example: mdm plot") for line in output)


# -- Graphs ------------------------------------------------------------------------------------------------------------

PATROL = ROOT / "examples" / "patrol"


def test_the_picture_of_how_to_md_is_the_one_that_its_command_draws(mdm, tmp_path, monkeypatch):
    for name in ("patrol.npz", "patrol.policy"):
        shutil.copy(PATROL / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    (line,) = re.findall(r"^mdm (plot policy .* --graph)$", (ROOT / "docs" / "how-to.md").read_text(), re.MULTILINE)
    assert mdm(*line.split()) == (0, ["policy.svg: drawn, decides by halfway, position"], "")
    drawn = (tmp_path / "policy.svg").read_text()
    assert drawn == (ROOT / "docs" / "pictures" / "policy.svg").read_text()
    texts = [each.text for each in ET.fromstring(drawn).iter("{http://www.w3.org/2000/svg}text")]
    assert {"halfway", "position", "Up", "Left", "Down", "Right"} <= set(texts)


def test_a_graph_needs_no_matplotlib_and_says_how_much_is_folded(mdm, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    path = tmp_path / "tiger.svg"
    assert mdm("plot", *POLICY, "--graph", "-o", path) == (0, [f"{path}: drawn, actions over beliefs in 2 states"], "")
    assert "listen" in path.read_text()


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["-o", "x.png"], 1, "x.png: a graph is written as SVG: give its file the suffix .svg"),
        (["-o", "x.svg", "--columns", "3"], 2, "--graph and --columns ask for different pictures"),
        (["-o", "x.svg", "--seed", "0"], 2, "--graph and --seed ask for different pictures"),
        (["-o", TIGER], 1, "would be overwritten"),
        (["-o", "missing/x.svg"], 1, "missing"),
    ],
)
def test_a_graph_that_cannot_be_drawn_says_why(mdm, tmp_path, monkeypatch, arguments, status, words):
    monkeypatch.chdir(tmp_path)
    found, _, errors = mdm("plot", *POLICY, "--graph", *arguments)
    assert found == status
    assert words in errors
