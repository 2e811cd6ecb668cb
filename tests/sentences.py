"""Sentences of errors: what a test is told is compared with a golden file, of which each folder of tests has one.

A sentence can so be changed in one place, and is read as a whole in review. `make sentences` writes the files anew from
what the tests are told now; the change of the files is then read as any other.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections import defaultdict
from contextlib import contextmanager
from fcntl import LOCK_EX, flock
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

TESTS = Path(__file__).parent
NAME = "sentences.txt"
WRITING = "MDM_SENTENCES"

_FOLDERS = rf"{re.escape(tempfile.gettempdir())}/pytest-of-[^/]+/pytest-\d+(?:/popen-gw\d+)?/[^/'\",:;\s]+"
_CHANGING = (
    (re.compile(_FOLDERS), "TEMPORARY"),
    (re.compile(re.escape(str(TESTS.parent))), "CHECKOUT"),
    (re.compile(r"(CHECKOUT/[\w/]+\.py):\d+"), r"\1:LINE"),
    (re.compile(r"0x[0-9a-f]{6,}"), "0x..."),
)
"""Parts of a sentence that differ from run to run, and what stands for them."""

Told = dict[str, list[str]]
"""The sentences of each test, in their order."""

_told: Told = {}
_golden: dict[Path, Told] = {}
_running: list[str] = []


def golden_file(test: str) -> Path:
    """Return the file with the sentences of a test, which is named as pytest does."""
    return TESTS.parent / Path(test.partition("::")[0]).parent / NAME


def read(path: Path) -> Told:
    """Read a file: a test's name, and its sentences indented by two; lines within a sentence are indented by four."""
    told: Told = {}
    sentences: list[str] = []
    lines = path.read_text(encoding="utf-8").split("\n")[:-1] if path.is_file() else []
    folder = path.parent.relative_to(TESTS.parent)
    for line in lines:
        if line.startswith("    "):
            sentences[-1] += f"\n{line[4:]}"
        elif line.startswith("  "):
            sentences.append(line[2:])
        else:
            sentences = told[f"{folder}/{line}"] = []
    return told


def write(path: Path, told: Told) -> None:
    """Write a file, or remove it where there is nothing to keep."""
    lines = []
    for test in sorted(test for test in told if told[test]):
        lines.append(test.removeprefix(f"{path.parent.relative_to(TESTS.parent)}/"))
        lines += ["  " + sentence.replace("\n", "\n    ") for sentence in told[test]]
    if lines:
        path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    else:
        path.unlink(missing_ok=True)


def same_everywhere(text: str) -> str:
    """Return a sentence without what differs from run to run."""
    for changing, name in _CHANGING:
        text = changing.sub(name, text)
    return text


@contextmanager
def of(test: str) -> Iterator[None]:
    """Compare the sentences that a test is told within, and see that none is missing."""
    _running.append(test)
    _told[test] = []
    try:
        yield
    except BaseException:  # skipped, or failed: it was told less than it might be
        del _told[test]
        raise
    finally:
        _running.pop()
    if WRITING not in os.environ:
        assert len(_kept(test)) == len(_told[test]), f"{golden_file(test)} has more sentences: make sentences"


def _kept(test: str) -> list[str]:
    path = golden_file(test)
    if path not in _golden:
        _golden[path] = read(path)
    return _golden[path].get(test, [])


@contextmanager
def refused(kind: type[BaseException]) -> Iterator[pytest.ExceptionInfo]:
    """Expect an error of a kind, whose sentence is the next one of the running test."""
    with pytest.raises(kind) as raised:
        yield raised
    sentence = same_everywhere(f"{type(raised.value).__name__}: {raised.value}")
    test = _running[-1]
    number = len(_told[test])
    _told[test].append(sentence)
    if WRITING not in os.environ:
        kept = _kept(test)
        assert [sentence] == kept[number : number + 1], f"{golden_file(test)}, sentence {number}: make sentences"


def write_all(collected: Iterable[str]) -> None:
    """Write what tests were told; sentences of tests that were skipped or failed stay, of tests that are gone do not.

    Args:
        collected: The tests of this run.
    """
    folders: dict[Path, set[str]] = defaultdict(set)
    for test in collected:
        folders[golden_file(test)].add(test)
    with (TESTS / f".{NAME}.lock").open("w") as lock:
        flock(lock, LOCK_EX)  # workers end one after the other
        for path, tests in folders.items():
            files = {test.partition("::")[0] for test in tests}
            before = read(path)
            stays = {
                test: told for test, told in before.items() if test in tests or test.partition("::")[0] not in files
            }
            write(path, stays | {test: told for test, told in _told.items() if test in tests})
