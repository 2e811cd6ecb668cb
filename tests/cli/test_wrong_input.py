"""Wrong input for every command: a sentence that names what is wrong, and no traceback."""

from __future__ import annotations

import os
import shutil

import pytest
from floor_file import write_floor
from places import EXAMPLES

COMMANDS = [
    "run FILE.toml",
    "team up FILE.toml",
    "team run FILE.toml --agent a",
    "team status FILE.toml",
    "team start FILE.toml",
    "team stop FILE.toml",
    "team reset FILE.toml",
    "team check FILE.toml",
    "team certificates FILE.toml -o OUT",
    "team decisions FILE.jsonl",
    "check FILE.toml",
    "check FILE.pomdp",
    "check FILE.npz",
    "check tiger.vf --model FILE.pomdp",
    "info FILE.toml",
    "info FILE.dpomdp",
    "info FILE.npz",
    "show FILE.pomdp start",
    "convert FILE.pgmx OUT.npz",
    "convert tiger.vf OUT.npz --model FILE.pomdp",
    "trace FILE.toml",
    "trace --model FILE.pomdp --policy tiger.vf",
    "trace --model tiger.pomdp --policy FILE.vf",
    "simulate FILE.toml",
    "simulate --model FILE.pomdp --policy tiger.vf",
    "simulate --model tiger.pomdp --policy FILE.pg",
    "solve FILE.pomdp",
    "solve FILE.mdp -o OUT.npz",
    "solve tiger.pomdp --durations FILE.npz",
    "evaluate FILE.pomdp tiger.vf",
    "evaluate tiger.pomdp FILE.policy",
    "compare FILE.pomdpx tiger.vf",
    "compare tiger.pomdp tiger.vf FILE.alpha",
    "sweep FILE.toml -o OUT.csv",
    "plot bounds FILE.json -o OUT.png",
    "plot sweep FILE.jsonl -x size -o OUT.png",
    "plot policy FILE.pomdp tiger.vf -o OUT.png",
    "plot policy tiger.pomdp FILE.vf -o OUT.png",
    "plot belief tiger.pomdp FILE.npz -o OUT.png",
    "map goals FILE.yaml -o OUT.xml",
    "map draft FILE.yaml graph.xml -o OUT.png",
    "map draft map.yaml FILE.xml -o OUT.png",
    "map check FILE.yaml labels.ppm graph.xml",
    "map check map.yaml FILE.png graph.xml",
    "map check map.yaml labels.ppm FILE.tmap2",
    "map check map.yaml labels.ppm graph.xml --names FILE.yaml",
    "map show map.yaml FILE.json --reach 1",
    "map show map.yaml FILE.ppm graph.xml -o OUT.png",
    "map model FILE.yaml labels.ppm graph.xml -o OUT.npz",
    "map model map.yaml labels.ppm FILE.xml -o OUT.npz",
]
"""What reads a file, with the suffix that the file has."""

OUTPUTS = [
    "solve tiger.pomdp -o OUT.npz",
    "solve tiger.pomdp --history OUT.json",
    "convert tiger.pomdp OUT.pomdpx",
    "convert tiger.vf OUT.npz",
    "problem tiger -o OUT.pomdp",
    "show tiger.pomdp --picture OUT.png",
    "plot policy tiger.pomdp tiger.vf -o OUT.png",
    "plot belief tiger.pomdp tiger.vf -o OUT.svg",
    "map goals map.yaml -o OUT.xml",
    "map draft map.yaml graph.xml -o OUT.png",
    "map show map.yaml labels.ppm graph.xml -o OUT.png",
    "map model map.yaml labels.ppm graph.xml -o OUT.npz",
]
"""What writes a file."""

TWO = [
    ("run tiger.toml --agent a", "--agent"),
    ("check tiger.toml --model tiger.pomdp", "--model"),
    ("check tiger.pomdp --import", "--import"),
    ("check tiger.pomdp --model tiger.pomdp", "--model"),
    ("info tiger.pomdp --import", "--import"),
    ("show tiger.pomdp T listen 0 --picture x.png", "--picture"),
    ("show tiger.pomdp T listen 0 --from 1", "--from"),
    ("show tiger.pomdp T listen", "T needs 2 symbols"),
    ("convert tiger.vf x.npz --normalize", "--normalize"),
    ("convert tiger.vf x.npz --discount 0.5", "--discount"),
    ("convert tiger.pomdp x.npz --model tiger.pomdp", "--model"),
    ("trace tiger.toml --policy tiger.vf", "--policy"),
    ("trace --policy tiger.vf --discount 0.5", "--discount"),
    ("trace --policy tiger.vf --false-negative 0", "--false-negative"),
    ("trace --model tiger.pomdp", "--policy"),
    ("trace --model tiger.pomdp --policy tiger.vf --drive often", "often"),
    ("trace --model tiger.pomdp --policy tiger.vf --drive 0", "--drive"),
    ("trace --model tiger.pomdp --policy tiger.vf --drive nan", "--drive"),
    (f"problem rock_sample --size {10**30} -o x.pomdp", "too large"),
    ("simulate tiger.toml --model tiger.pomdp", "--model"),
    ("simulate tiger.toml --discount 0.5", "--discount"),
    ("simulate --model tiger.pomdp", "--policy"),
    ("solve tiger.pomdp --solver sarsop --horizon 3", "--horizon"),
    ("solve tiger.pomdp --solver perseus --whole", "--whole"),
    ("solve tiger.pomdp --history x.txt", "--history"),
    ("solve tiger.pomdp --durations x.npz --horizon 3", "--horizon"),
    ("solve tiger.pomdp --durations x.npz --solver jesp", "jesp"),
    ("plot policy tiger.pomdp tiger.vf -o x.png --states 0 1 --columns 2", "--columns"),
    ("problem --list tiger", "--list"),
    ("problem tiger tiger", "tiger"),
    ("problem tigre -o x.pomdp", "tigre"),
    ("map goals map.yaml", "--output"),
    ("map goals map.yaml -o x.xml --least -4", "--least"),
    ("map draft map.yaml graph.xml", "--output"),
    ("map check map.yaml graph.xml --radius -1", "--radius"),
    ("map check map.yaml graph.xml --margin nan", "--margin"),
    ("map show map.yaml graph.xml --reach inf", "--reach"),
    ("map show map.yaml graph.xml --radius wide", "--radius"),
    ("map model map.yaml graph.xml -o x.npz --period 1", "--period"),
    ("map model map.yaml graph.xml -o x.npz --speed 1", "--speed"),
    ("map model map.yaml graph.xml -o x.npz --speed 1 --period 1 --success 0.5", "--success"),
    ("map model map.yaml graph.xml -o x.npz --speed 1 --period 1 --durations y.npz", "--durations"),
    ("map model map.yaml graph.xml -o x.npz --speed 1 --durations x.npz", "same file"),
    ("map model map.yaml graph.xml -o x.npz --speed 1 --durations y.npz --discount 1", "--discount"),
    ("map model map.yaml graph.xml -o x.npz --stages 2", "--stages"),
    ("map model map.yaml graph.xml -o x.npz --radius 2", "--radius"),
    ("map model map.yaml graph.xml -o x.npz --latch half=hall", "--latch"),
    ("map model map.yaml graph.xml -o x.npz --reward hall=1 --reward hall=2", "--reward"),
    ("map model map.yaml graph.xml -o x.npz --success 1e9", "--success"),
]
"""What contradicts itself, and what of it is named."""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    for name in ("tiger.pomdp", "tiger.vf", "tiger.toml", "tiger.py"):
        shutil.copy(EXAMPLES / name, tmp_path)
    write_floor(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def assert_told(result, culprit, status=1):
    found, output, errors = result
    assert (found, output) == (status, []), errors
    assert culprit in errors.splitlines()[-1]
    assert "Traceback" not in errors
    assert "unexpected" not in errors
    if status == 1:
        assert len(errors.splitlines()) == 1


def pairs(commands):
    """Return each command with a file that is missing and two others, in turn, so that all are met by many commands."""
    others = ["folder", "empty", "binary", "pipe", "loop"]
    for place, command in enumerate(commands):
        yield command, "missing"
        yield command, others[place % 5]
        yield command, others[(place + 2 + place // 5) % 5]
        if place % 8 == 0:
            yield command, "unreadable"


@pytest.mark.parametrize(("command", "content"), dict.fromkeys(pairs(COMMANDS)))
def test_files_that_cannot_be_read(mdm, folder, command, content):
    words = command.split()
    name = next(word for word in words if word.startswith("FILE"))
    path = folder / name
    if content == "folder":
        path.mkdir()
    elif content == "pipe":
        os.mkfifo(path)
    elif content == "loop":
        path.symlink_to(path)
    elif content != "missing":
        path.write_bytes({"empty": b"", "binary": b"\x93\0\1\2\xff\n\0"}.get(content, b"x"))
    if content == "unreadable":
        path.chmod(0)
        if os.access(path, os.R_OK):
            pytest.skip("this user may read any file")
    before = sorted(folder.iterdir())
    result = mdm(*words)
    if name.endswith((".toml", ".jsonl")) and content == "empty" and words[0] != "check":
        assert result[0] in {1, 2}
        assert name in result[2]
        assert "Traceback" not in result[2]
    else:
        assert_told(result, name)
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize("place", ["folder", "no such folder", "no folder", "no such format", "no rights"])
@pytest.mark.parametrize("command", OUTPUTS)
def test_files_that_cannot_be_written(mdm, folder, command, place):
    words = command.split()
    written = next(word for word in words if word.startswith("OUT"))
    if place == "folder":
        (folder / written).mkdir()
        name = written
    elif place == "no such folder":
        name = f"nowhere/{written}"
    elif place == "no folder":
        name = f"tiger.vf/{written}"
    elif place == "no rights":
        (folder / "closed").mkdir(mode=0o500)
        name = f"/proc/{written}" if os.access(folder / "closed", os.W_OK) else f"closed/{written}"
    else:
        name = "OUT.xyz"
    before = sorted(folder.rglob("*"))
    result = mdm(*[name if word == written else word for word in words])
    status = 2 if place == "no such format" and "--history" in words else 1
    assert_told(result, name if status == 1 else "--history", status)
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize(("command", "culprit"), TWO)
def test_what_contradicts_itself(mdm, folder, command, culprit):
    before = sorted(folder.iterdir())
    assert_told(mdm(*command.split()), culprit, 2)
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize("command", [*COMMANDS, *OUTPUTS])
def test_unknown_options(mdm, command):
    status, output, errors = mdm(*command.split(), "--nope")
    assert (status, output) == (2, [])
    assert "--nope" in errors.splitlines()[-1]
    assert "usage: mdm" in errors
