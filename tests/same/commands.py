"""Calls of the command with right and wrong words: exit status, both outputs, and the files that are written."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import random
import re
import shutil
import signal
import tempfile
from functools import cache
from pathlib import Path

from mdm.cli import main

VERBS = ["check", "info", "show", "convert", "problem", "trace", "simulate", "evaluate", "compare", "explain", "replay"]
VERBS += ["statistics", "record info", "record cat", "map check", "map show", "map draft", "new", "examples", "solve"]
VERBS += ["import-ros1", "completion", "team status", "plot"]
WORDS = ["tiger", "listen", "5", "0", "-1", "1e9", "nan", "0.5", "bash", "gone.toml", "here", "json", "é", "", "a=b"]
LONGEST = 10
RIGHT = ["check tiger.toml", "check patrol/patrol.toml", "info tiger.pomdp", "info tiger.vf", "info tiger.toml"]
RIGHT += [
    "info patrol/floor.yaml",
    "show tiger.pomdp",
    "show tiger.pomdp --action listen",
    "convert tiger.pomdp a.pomdpx",
]
RIGHT += [
    "convert team/meeting.vf a.alpha",
    "problem tiger",
    "problem dec-tiger",
    "trace tiger.toml",
    "map check patrol/floor.yaml",
]
RIGHT += [
    "simulate tiger.toml --steps 20",
    "evaluate tiger.pomdp tiger.vf",
    "compare tiger.pomdp tiger.vf tiger.vf",
]
RIGHT += [
    "map show patrol/floor.yaml",
    "new robot",
    "examples",
    "examples tiger",
    "completion bash",
    "solve tiger.pomdp a.vf",
]


class TooLong(BaseException):
    """A call that goes on: it is of no use here."""


def _stop(*_):
    raise TooLong


@cache
def _options(verb):
    """Return the options of a verb, and whether each takes a word, from its help."""
    _, output, _ = called([*verb.split(), "--help"])
    return re.findall(r"^  (?:-\w, )?(--[\w-]+)( [A-Z{]\S*)?", output, re.MULTILINE)


def called(words):
    """Return the exit status of a call, and what it has printed."""
    output, errors = io.StringIO(), io.StringIO()
    signal.signal(signal.SIGALRM, _stop)
    signal.alarm(LONGEST)
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
            status = main(words)
    except SystemExit as ended:
        status = ended.code
    except TooLong:
        return "goes on", "", ""
    except Exception as error:
        status = f"{type(error).__name__}: {error}"
    finally:
        signal.alarm(0)
    return status, output.getvalue(), errors.getvalue()


def drawn(draw, files):
    """Return the words of a call."""
    if draw.random() < 0.5:
        words = draw.choice(RIGHT).split()
        verb = next(verb for verb in VERBS if " ".join(words).startswith(verb))
        return _with_options(draw, words, verb, ["1", "3", "0.5", "a", "json", *files])
    verb = draw.choice(VERBS)
    words = verb.split()
    for _ in range(draw.choice([0, 1, 1, 1, 2, 2, 3])):
        words.append(draw.choice(files) if draw.random() < 0.8 else draw.choice(WORDS))
    return _with_options(draw, words, verb, files + WORDS)


def _with_options(draw, words, verb, values):
    words += ["--seed", "1"] if verb in {"simulate", "evaluate", "compare"} else []
    options = _options(verb)
    for name, value in draw.sample(options, min(len(options), draw.choice([0, 0, 1, 2]))):
        if name not in {"--help", "--time", "--watch"}:
            words += [name, draw.choice(values)] if value and draw.random() < 0.9 else [name]
    return words


def plain(text, folder):
    """Return a text without the folder of the call, and without times that it took, or that kernels took to compile."""
    text = re.sub(r"^.*: compiling, once on this machine.*\n", "", text, flags=re.MULTILINE)
    text = text.replace(str(folder), "FOLDER")
    text = re.sub(r"[\d.e+,]+ steps a second", "SOME steps a second", text)
    return re.sub(r"\d+(\.\d+)? (ms|s|seconds)\b", "SOME s", text)


def seen(seed, tree):
    """Return what the call of a seed does."""
    draw = random.Random(seed)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        shutil.copytree(tree / "examples", folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
        files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
        kinds = (".pomdp", ".toml", ".vf", ".yaml", ".pgm", ".json", ".dpomdp")
        before, chosen = set(files), [file for file in files if file.endswith(kinds)]
        words = drawn(draw, chosen)
        back = Path.cwd()
        os.chdir(folder)
        try:
            status, output, errors = called(words)
        finally:
            os.chdir(back)
        if status == "goes on":
            return [" ".join(words)]
        written = []
        for path in sorted(folder.rglob("*")):
            name = path.relative_to(folder).as_posix()
            if path.is_file() and name not in before and "__pycache__" not in path.parts:
                text = plain(path.read_text("latin-1"), folder)
                written.append(f"{name} {hashlib.sha256(text.encode()).hexdigest()}")
        printed = [*plain(output, folder).splitlines(), "--", *plain(errors, folder).splitlines()]
        return [" ".join(words), str(status), *printed, *written]
