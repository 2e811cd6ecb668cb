"""The text of a plain or gzipped file, its words, and their lines and columns; and the rest that a reader left."""

from __future__ import annotations

import gzip
import io
import re
import warnings
import zlib
from bisect import bisect_right
from itertools import accumulate
from pathlib import Path
from typing import NoReturn

from mdm.errors import FormatError
from mdm.progress import report_share

LARGEST = 10_000_000
"""The most states, actions or observations that a file may have."""
_COMMENT = re.compile(r"#[^\n]*")
_LARGEST = 500_000_000
"""Bytes of a compressed text; a file of 500 kB could hold as many."""
_SPLIT = 0.45
"""The share of the time for a large text that it takes to split it into words, by measurement."""
_SIGNED = re.compile(r"[0-9.]")


class Source:
    """A file's text.

    Args:
        path: The file, plain or gzipped.

    Raises:
        FormatError: If it is missing, a folder, empty, truncated, or not text.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.report(0.0)
        self.text = _read(self.path)

    def report(self, share: float) -> None:
        """Report the share of the text that has been read, see `mdm.progress`."""
        report_share(f"reading {self.path.name}", share)

    def fail(self, message: str, *, line: int | None = None, column: int | None = None) -> NoReturn:
        """Raise a `FormatError` at a place in the file."""
        raise FormatError(message, file=self.path, line=line, column=column)

    def place(self, position: int) -> tuple[int, int]:
        """Return line and column, from 1, of a character of the text."""
        line = self.text.count("\n", 0, position) + 1
        return line, position - self.text.rfind("\n", 0, position)


class Words:
    """The words of a text in Cassandra's syntax: without ``#`` comments, with ``:`` and ``*`` as words of their own.

    Lines and columns are computed only for errors, by splitting the lines again.

    Args:
        source: The text.
        skip: The number of lines to skip at the beginning.
    """

    def __init__(self, source: Source, *, skip: int = 0) -> None:
        self._source = source
        self._skip = skip
        text = source.text.split("\n", skip)[skip] if source.text.count("\n") >= skip else ""
        self.words = _split(_COMMENT.sub("", text))
        self.report(0)
        self._lines: list[str] = []
        self._ends: list[int] | None = None

    def report(self, at: int) -> None:
        """Report that the words before this one have been read."""
        self._source.report(_SPLIT + (1 - _SPLIT) * at / max(len(self.words), 1))

    def placed(self, at: int, message: str) -> str:
        """Return a message with the place of a word."""
        try:
            self.fail(at, message)
        except FormatError as error:
            return str(error)

    def fail(self, at: int, message: str) -> NoReturn:
        """Raise a `FormatError` at a word; beyond the end, at the last word."""
        at = min(at, len(self.words) - 1)
        if self._ends is None:  # once, however many errors there are
            self._lines = self._source.text.split("\n")[self._skip :]
            self._ends = list(accumulate(len(_split(_COMMENT.sub("", line))) for line in self._lines))
        place = bisect_right(self._ends, at)
        if place == len(self._ends):
            self._source.fail(message)
        text = self._lines[place]
        words = _split(_COMMENT.sub("", text))
        seen = self._ends[place] - len(words)
        column = 0
        for word in words[: at - seen + 1]:
            column = text.find(word[0] if word[0] in "+-" else word, column) + 1
            start, column = column, column - 1 + len(word)
        self._source.fail(message, line=self._skip + place + 1, column=start)


def _split(text: str) -> list[str]:
    words = text.replace(":", " : ").replace("*", " * ").split()
    if "+" in words or "-" in words:
        joined: list[str] = []
        for word in words:
            if joined and joined[-1] in {"+", "-"} and _SIGNED.match(word):
                joined[-1] += word
            else:
                joined.append(word)
        return joined
    return words


def _read(path: Path) -> str:
    data = content(path)
    if data[:2] == b"\x1f\x8b":
        data = _decompressed(data, path)
    elif path.suffix == ".gz":
        raise FormatError("the file is named .gz, but is not gzipped", file=path)
    if b"\0" in data:
        raise FormatError("this is a binary file; a text was expected", file=path)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if not text.strip():
        raise FormatError("the file is empty", file=path)
    return text


def content(path: Path) -> bytes:
    """Return the bytes of a file.

    Raises:
        FormatError: If they cannot be read, or it is a pipe or a device, which would be waited on.
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        raise FormatError("this is a pipe or a device, not a file: save its content to a file first", file=path)
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise FormatError("there is no such file", file=path) from None
    except IsADirectoryError:
        raise FormatError("this is a folder, not a file", file=path) from None
    except OSError as error:
        raise FormatError(f"the file cannot be read: {error.strerror}", file=path) from None
    except ValueError as error:  # a zero byte in the name, which a file that names another may have
        raise FormatError(f"the file cannot be read: {error}", file=str(path).replace("\0", "\\0")) from None


def _decompressed(data: bytes, path: Path) -> bytes:
    try:
        with gzip.open(io.BytesIO(data)) as file:
            text = file.read(_LARGEST + 1)
    except (EOFError, OSError, zlib.error):
        raise FormatError("the compressed file is truncated or damaged", file=path) from None
    if len(text) > _LARGEST:
        size = f"{_LARGEST // 10**6} MB"
        raise FormatError(f"the compressed file holds more than {size}: decompress it, if that is right", file=path)
    return text


def number(word: str) -> float | None:
    """Parse a word as a number, or return None; ``nan`` and ``inf`` are numbers here, and refused by callers."""
    try:
        return float(word) if "_" not in word else None
    except ValueError:
        return None


def suffixes(path: str | Path) -> str:
    """Return a file's suffix in lower case, without ``.gz``."""
    path = Path(path)
    return (Path(path.stem).suffix if path.suffix.lower() == ".gz" else path.suffix).lower()


# -- The rest of a file ------------------------------------------------------------------------------------------------

_PLACES = 3
"""Places of one thing that are told."""


class Inventory:
    """All that was not carried over, each thing with its places, in the order of the file."""

    def __init__(self) -> None:
        self._left: dict[tuple[str, str], list[str]] = {}

    def leave(self, what: str, place: str, why: str = "") -> None:
        """Note something, with its place, such as ``line 3``, and why, where that is not plain."""
        self._left.setdefault((what, why), []).append(place)

    def add(self, other: Inventory) -> None:
        """Note all that another reader has noted."""
        for (what, why), places in other._left.items():
            self._left.setdefault((what, why), []).extend(places)

    def lines(self) -> list[str]:
        """Return a line for each thing, with its places and the reason."""
        return [
            f"{what}, of {', '.join(places[:_PLACES])}"
            + (f" and {len(places) - _PLACES} more" if len(places) > _PLACES else "")
            + (f": {why}" if why else "")
            for (what, why), places in self._left.items()
        ]

    def warn(self, path: Path, kind: type[Warning]) -> None:
        """Warn once of all that was left of a file; not where that is nothing."""
        if self._left:
            warnings.warn(kind(f"{path}: not carried over: {'; '.join(self.lines())}"), stacklevel=2)
