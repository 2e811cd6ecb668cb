"""The `mdm` command as a user sees it: output, exit status, wrong input."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from patience import PATIENCE
from places import EXAMPLES, TIGER, TIGER_VECTORS
from sentences import refused

from mdm import FormatError
from mdm.cli import main
from mdm.compilation import COMPILE_TIME

TRACED = ["--model", str(TIGER), "--policy", str(TIGER_VECTORS)]
VERBS = ("run", "check", "info", "show", "convert", "trace", "simulate", "solve", "evaluate", "compare", "plot")
VERBS += ("record",)


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help_with_an_example(mdm, verb):
    status, output, _ = mdm(verb, "--help")
    assert status == 0
    assert any(line.startswith("example: ") for line in output)


@pytest.mark.parametrize(
    "arguments",
    [
        ["fly"],
        ["run"],
        ["team"],
        ["plot"],
        ["record"],
        ["record", "export", "x.mcap"],
        ["--nope"],
        ["info", "--nope", "x"],
        ["run", "x.toml", "--epochs", "0"],
        ["simulate"],
        ["trace"],
        ["solve", "x.pomdp", "--discount", "2"],
        ["solve", "x.pomdp", "--gap", "-1"],
        ["solve", "x.pomdp", "--solver", "magic"],
        ["convert", "x.pomdp", "y.pomdp", "--discount", "0"],
        ["plot", "bounds", "x.json", "-o", "x.png", "--nope"],
    ],
)
def test_wrong_usage_is_2(mdm, arguments):
    status, output, errors = mdm(*arguments)
    assert status == 2
    assert not output
    assert "usage:" in errors


def test_a_terminal_that_lacks_a_character_is_no_failure():
    floor = EXAMPLES / "patrol"
    command = [
        sys.executable,
        "-m",
        "mdm",
        "map",
        "show",
        floor / "floor.yaml",
        floor / "labels.png",
        floor / "floor.xml",
    ]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=PATIENCE, env={**os.environ, "PYTHONIOENCODING": "ascii"}
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert " m\\xb2 " in done.stdout


def test_without_arguments_there_is_help(mdm):
    assert mdm() == mdm("--help")
    status, output, errors = mdm()
    assert (status, errors) == (0, "")
    assert output[0].startswith("usage: mdm ")
    assert any(line.startswith("exit status: 0 ") for line in output)


def test_an_unknown_argument_is_told_with_its_verb(mdm):
    _, _, errors = mdm("plot", "bounds", "x.json", "-o", "x.png", "--nope")
    assert errors.startswith("usage: mdm plot bounds ")
    assert errors.endswith("mdm plot: error: there is no argument --nope\n")


def test_pictures_take_debug(mdm, tmp_path):
    with refused(FormatError):
        mdm("plot", "bounds", tmp_path / "x.json", "-o", tmp_path / "x.png", "--debug")


def test_version(mdm):
    assert mdm("--version")[1][0].startswith("mdm ")


@pytest.mark.parametrize("verb", ["run", "check", "info", "simulate", "trace"])
@pytest.mark.parametrize(
    ("name", "content"),
    [("missing.toml", None), ("empty.toml", b""), ("binary.toml", b"\0\1\2"), ("cut.toml", b"[ensembles.a\n")],
)
def test_broken_files_give_a_sentence_and_1(mdm, tmp_path, verb, name, content):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    status, output, errors = mdm(verb, path)
    assert status == 1
    assert not output
    assert errors.startswith(f"mdm {verb}: ")
    assert name in errors
    assert "Traceback" not in errors


@pytest.mark.parametrize("way", ["itself", "a path", "a link", "a hard link"])
@pytest.mark.parametrize(
    ("arguments", "read"),
    [
        (["solve", "tiger.pomdp", "-o", "OUT"], "tiger.pomdp"),
        (["solve", "tiger.pomdp", "--history", "OUT"], "tiger.pomdp"),
        (["convert", "tiger.pomdp", "OUT"], "tiger.pomdp"),
        (["convert", "tiger.vf", "OUT"], "tiger.vf"),
        (["convert", "tiger.vf", "OUT", "--model", "tiger.pomdp"], "tiger.pomdp"),
        (["plot", "policy", "tiger.pomdp", "tiger.vf", "-o", "OUT"], "tiger.pomdp"),
        (["plot", "belief", "tiger.pomdp", "tiger.vf", "-o", "OUT"], "tiger.vf"),
        (["plot", "bounds", "tiger.vf", "tiger.pomdp", "-o", "OUT"], "tiger.pomdp"),
        (["show", "tiger.pomdp", "network", "--picture", "OUT"], "tiger.pomdp"),
    ],
)
def test_output_never_destroys_input(mdm, tmp_path, monkeypatch, arguments, read, way):
    monkeypatch.chdir(tmp_path)
    for name in ("tiger.pomdp", "tiger.vf"):
        shutil.copy(EXAMPLES / name, tmp_path)
    suffixes = {"solve": ".npz", "convert": ".npz", "plot": ".png", "show": ".png"}
    suffix = ".json" if "--history" in arguments else suffixes[arguments[0]]
    out = {"itself": read, "a path": f"../{tmp_path.name}/{read}"}.get(way, f"out{suffix}")
    if way == "a link":
        Path(out).symlink_to(read)
    elif way == "a hard link":
        Path(out).hardlink_to(read)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    status, output, errors = mdm(*[out if word == "OUT" else word for word in arguments])
    assert (status, output) == (1, [])
    assert errors == f"mdm {arguments[0]}: {out}: this file is an input and would be overwritten: write to another\n"
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert Path(out).is_symlink() == (way == "a link")


@pytest.mark.parametrize("verb", ["check", "info"])
def test_broken_models_and_folders(mdm, tmp_path, verb):
    for name, content, words in (
        ("a.pomdp", b"", "empty"),
        ("b.pomdp", b"discount: 2\n", "states"),
        ("c.policy", b"[2](0", "before the brackets"),
        ("d", b"\0\0", "binary"),
        ("e", b"hello", "'hello'"),
    ):
        path = tmp_path / name
        path.write_bytes(content)
        status, _, errors = mdm(verb, path)
        assert (status, words in errors) == (1, True), errors
    assert mdm(verb, tmp_path)[0] == 1


@pytest.mark.parametrize("unbuffered", [{}, {"PYTHONUNBUFFERED": "1"}])
@pytest.mark.parametrize(
    ("arguments", "status"),
    [(["--help"], 0), (["info", str(EXAMPLES / "tiger.pomdp")], 1), (["trace", *TRACED], 1)],
)
def test_a_reader_that_has_gone_is_no_reason_to_complain(arguments, status, unbuffered):
    """The pipe's other end is closed before anything is written, and there is more to write than one buffer holds."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"} | unbuffered
    environment["MDM_COMPILE"] = "0"  # that something waits for the compiler is told as well
    ours, theirs = os.pipe()
    os.close(ours)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "mdm", *arguments],
            stdout=theirs,
            stderr=subprocess.PIPE,
            input='{"observation": 0}\n' * 500,
            text=True,
            env=environment,
            timeout=PATIENCE,
        )
    finally:
        os.close(theirs)
    assert (done.returncode, done.stderr) == (status, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device that is always full is Linux's")
@pytest.mark.parametrize("arguments", [["check", str(EXAMPLES / "tiger.toml")], ["trace", *TRACED]])
def test_output_that_cannot_be_written_is_told(arguments):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "mdm", *arguments],
            stdout=full,
            stderr=subprocess.PIPE,
            input="",
            text=True,
            timeout=PATIENCE,
        )
    assert (done.returncode, done.stderr) == (1, f"mdm {arguments[0]}: No space left on device\n")


@pytest.mark.parametrize(("error", "told"), [(BrokenPipeError(), ""), (OSError(28, "No space"), "mdm: No space\n")])
def test_what_an_option_prints_may_have_nowhere_to_go(mdm, monkeypatch, error, told):
    def print_nothing(*_, **__):
        raise error

    monkeypatch.setattr("mdm.cli.policies.print", print_nothing, raising=False)
    assert mdm("solve", "--solver", "help") == (1, [], told)


@pytest.mark.parametrize("verb", ["check", "info", "show", "convert"])
@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("missing.pomdpx", None, "there is no such file"),
        ("empty.pgmx", b"", "the file is empty"),
        ("binary.dpomdp", b"\0\1\2\3", "binary"),
        ("binary.npz", b"PK\3\4\0\0", "damaged"),
        ("plain.npz", b"discount: 0.9", "damaged"),
        ("folder", "folder", "folder"),
        ("page.pgmx", b"<html><body/></html>", "ProbModelXML"),
        ("cut.pomdpx", b"<pomdpx><Discount>0.9</Disc", "not well-formed|no well-formed"),
        ("words", b"to be or not to be", "to"),
    ],
)
def test_wrong_files_give_a_sentence_and_1(mdm, tmp_path, verb, name, content, words):
    path = tmp_path / name
    if content == "folder":
        path.mkdir()
    elif content is not None:
        path.write_bytes(content)
    status, output, errors = mdm(verb, path, *([tmp_path / "out.npz"] if verb == "convert" else []))
    assert status == 1
    assert not output
    assert name in errors
    assert any(word in errors for word in words.split("|"))
    assert "Traceback" not in errors
    assert not (tmp_path / "out.npz").exists()


def test_who_waits_for_a_compiler_is_told_in_a_line(monkeypatch, capsys):
    now = [0.0]

    def compile_slowly(_parsed):
        for _ in range(3):
            COMPILE_TIME.begin()
            now[0] += 5
            COMPILE_TIME.go_on()
            COMPILE_TIME.end()
        return 0

    monkeypatch.setattr(COMPILE_TIME, "_clock", lambda: now[0])
    monkeypatch.setattr(COMPILE_TIME, "_compiling", 0.0)
    monkeypatch.setattr("mdm.cli.files.info.run", compile_slowly)
    assert main(["info", "x.pomdp"]) == 0
    assert capsys.readouterr().err == "mdm info: compiling, once on this machine; it takes some seconds\n"
