"""YAML texts as trees whose entries know their lines.

Nothing is constructed but texts, lists and mappings. An alias is the entry that it stands for, and counts with all that
is in it: a few lines of aliases of aliases would otherwise stand for billions of values.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NoReturn

from mdm.errors import MapError
from mdm.formats.source import Source, number

if TYPE_CHECKING:
    from collections.abc import Iterator

_MOST = 1_000_000
"""Values of a text, aliases counted with all that they stand for; the largest maps in use have some 100,000."""
_DEPTH = 50


class Entry:
    """A value of a YAML text.

    Args:
        source: The text.
        line: The line that it begins in, from 1.
        content: A text, a list of entries, or a mapping of texts to entries.
    """

    __slots__ = ("content", "line", "size", "source")

    def __init__(self, source: Source, line: int, content: str | list[Entry] | dict[str, Entry]) -> None:
        self.source = source
        self.line = line
        self.content = content
        self.size = 1

    def fail(self, message: str) -> NoReturn:
        """Raise a `FormatError` at this entry."""
        self.source.fail(message, line=self.line)

    def mapping(self, what: str) -> dict[str, Entry]:
        """Return the content, which must be a mapping; `what` names the entry in the error."""
        if not isinstance(self.content, dict):
            self.fail(f"{what}: keys and values were expected, not {self._told()}")
        return self.content

    def list(self, what: str) -> list[Entry]:
        """Return the content, which must be a list."""
        if not isinstance(self.content, list):
            self.fail(f"{what}: a list was expected, not {self._told()}")
        return self.content

    def string(self, what: str) -> str:
        """Return the content, which must be a text with something in it."""
        if not isinstance(self.content, str) or not self.content:
            self.fail(f"{what}: a text was expected, not {self._told()}")
        return self.content

    def number(self, what: str) -> float:
        """Return the content as a finite number."""
        value = number(self.content) if isinstance(self.content, str) else None
        if value is None or not math.isfinite(value):
            self.fail(f"{what}: a number was expected, not {self._told()}")
        return value

    def get(self, key: str, what: str) -> Entry | None:
        """Return the entry of a key of a mapping, or None."""
        return self.mapping(what).get(key)

    def need(self, key: str, what: str) -> Entry:
        """Return the entry of a key of a mapping, which must be there."""
        entry = self.get(key, what)
        return self.fail(f"{what}: the key {key!r} is missing") if entry is None else entry

    def _told(self) -> str:
        if isinstance(self.content, str):
            return repr(self.content[:40]) if self.content else "nothing"
        return "a list" if isinstance(self.content, list) else "keys and values"


def read_yaml(source: Source) -> Entry:
    """Read a YAML text.

    Raises:
        FormatError: If it is not well-formed, has several documents, tags, merge keys or a key twice, is nested more
            than 50 deep, or stands for more than a million values.
        MapError: If PyYAML is not installed.
    """
    try:
        import yaml  # noqa: PLC0415 - an extra
    except ImportError:
        raise MapError(f"{source.path}: YAML files need PyYAML: pip install pillow pyyaml") from None
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        return _Composer(source, yaml.parse(source.text, Loader=loader)).document()
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "it cannot be parsed"
        source.fail(
            f"this is not well-formed YAML: {problem}",
            line=None if mark is None else mark.line + 1,
            column=None if mark is None else mark.column + 1,
        )


class _Composer:
    """Builds entries from the parser's events, which are flat however deep the text is."""

    def __init__(self, source: Source, events: Iterator[Any]) -> None:
        self._source = source
        self._events = events
        self._anchors: dict[str, Entry | None] = {}  # None while the entry is open
        self._total = 0

    def document(self) -> Entry:
        documents = [self._entry(event, 0) for event in self._events if _kind(event) in _BEGIN]
        if not documents:
            self._source.fail("the text has no content")
        if len(documents) > 1:
            documents[1].fail("the text has a second document")
        return documents[0]

    def _entry(self, event: Any, depth: int) -> Entry:
        kind, line = _kind(event), event.start_mark.line + 1
        if kind == "Alias":
            return self._alias(event.anchor, line)
        if event.tag is not None:
            self._source.fail(f"tags such as {event.tag[:40]!r} are not read", line=line)
        if depth > _DEPTH:
            self._source.fail(f"values are nested more than {_DEPTH} deep", line=line)
        self._count(1, line)
        if event.anchor is not None:
            self._anchors[event.anchor] = None
        if kind == "Scalar":
            entry = Entry(self._source, line, event.value.strip())
        elif kind == "SequenceStart":
            entry = Entry(self._source, line, self._list(depth))
        else:
            entry = Entry(self._source, line, self._mapping(depth))
        children = entry.content.values() if isinstance(entry.content, dict) else entry.content
        entry.size = 1 + (0 if isinstance(children, str) else sum(child.size for child in children))
        if event.anchor is not None:
            self._anchors[event.anchor] = entry
        return entry

    def _list(self, depth: int) -> list[Entry]:
        entries = []
        while _kind(event := next(self._events)) != "SequenceEnd":
            entries.append(self._entry(event, depth + 1))
        return entries

    def _mapping(self, depth: int) -> dict[str, Entry]:
        entries: dict[str, Entry] = {}
        while _kind(event := next(self._events)) != "MappingEnd":
            key = self._entry(event, depth + 1)
            name = key.content
            if not isinstance(name, str):
                key.fail("a key is a list or a mapping; a text was expected")
            if name == "<<":
                key.fail("merge keys (<<) are not read: write the keys out")
            if name in entries:
                key.fail(f"the key {name!r} is given twice, first in line {entries[name].line}")
            entries[name] = self._entry(next(self._events), depth + 1)
        return entries

    def _alias(self, name: str, line: int) -> Entry:
        entry = self._anchors.get(name)
        if entry is None:
            what = "stands for something that it is part of" if name in self._anchors else "has no anchor before it"
            self._source.fail(f"the alias *{name[:40]} {what}", line=line)
        self._count(entry.size, line)
        return entry

    def _count(self, number: int, line: int) -> None:
        self._total += number
        if self._total > _MOST:
            self._source.fail(f"up to here the text stands for more than {_MOST:,} values", line=line)


_BEGIN = ("Scalar", "SequenceStart", "MappingStart", "Alias")


def _kind(event: Any) -> str:
    return type(event).__name__.removesuffix("Event")
