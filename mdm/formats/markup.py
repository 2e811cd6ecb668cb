"""A streaming XML parser that yields small element trees with their line numbers.

Document types are refused: they can define entities that grow without bound or read other files.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, NoReturn
from xml.parsers import expat

from mdm.formats.source import number

if TYPE_CHECKING:
    from collections.abc import Container, Iterator

    from mdm.formats.source import Source

_PIECE = 1 << 16
_DEPTH = 100
"""Limit on nesting, because the tree readers recurse; real models stay far below."""


class Element:
    """An element: tag, attributes, own text (without that of its children), children, line and column."""

    __slots__ = ("attributes", "children", "column", "line", "source", "tag", "text")

    def __init__(self, source: Source, tag: str, attributes: dict[str, str], line: int, column: int) -> None:
        self.source = source
        self.tag = tag
        self.attributes = attributes
        self.text = ""
        self.children: list[Element] = []
        self.line = line
        self.column = column

    def find(self, tag: str) -> Element | None:
        """Return the first child of a tag, or None."""
        return next((child for child in self.children if child.tag == tag), None)

    def all(self, tag: str) -> list[Element]:
        """Return the children of a tag."""
        return [child for child in self.children if child.tag == tag]

    def need(self, tag: str) -> Element:
        """Return the first child of a tag.

        Raises:
            FormatError: If there is none.
        """
        child = self.find(tag)
        return self.fail(f"<{self.tag}> needs a <{tag}>") if child is None else child

    def attribute(self, name: str) -> str:
        """Return an attribute without the blanks around it.

        Raises:
            FormatError: If it is missing.
        """
        value = self.attributes.get(name)
        return self.fail(f"<{self.tag}> needs the attribute {name!r}") if value is None else value.strip()

    def number(self, word: str) -> float:
        """Parse a word of this element as a finite number.

        Raises:
            FormatError: If it is none.
        """
        value = number(word)
        return (
            self.fail(f"{word[:40]!r} is not a finite number") if value is None or not math.isfinite(value) else value
        )

    def fail(self, message: str) -> NoReturn:
        """Raise a `FormatError` at this element."""
        self.source.fail(message, line=self.line, column=self.column)


def stream(source: Source, collect: Container[str]) -> Iterator[Element]:
    """Yield a document's elements in document order.

    An element whose tag is in ``collect`` is yielded at its end tag, with its whole subtree; the elements inside it are
    not yielded again. Any other element is yielded at its start tag, without text and children.

    Raises:
        FormatError: If the text is not well-formed XML, or has a document type.
    """
    parser = _Parser(source, collect)
    text = source.text
    for start in range(0, len(text), _PIECE):
        parser.feed(text[start : start + _PIECE], last=start + _PIECE >= len(text))
        while parser.done:
            yield parser.done.popleft()
        source.report(min((start + _PIECE) / len(text), 1.0))


def escape(text: str) -> str:
    """Escape a text for use as element content; `xml.sax.saxutils` would import half of a web client."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def quoted(text: str) -> str:
    """Quote and escape a text for use as an attribute value."""
    return '"' + escape(text).replace('"', "&quot;") + '"'


class _Parser:
    def __init__(self, source: Source, collect: Container[str]) -> None:
        self.done: deque[Element] = deque()
        self._source = source
        self._collect = collect
        self._open: list[Element] = []  # the collected element and its open descendants
        self._texts: list[list[str]] = []
        self._depth = 0
        self._expat = expat.ParserCreate(encoding="utf-8")
        self._expat.buffer_text = True
        self._expat.StartElementHandler = self._start
        self._expat.EndElementHandler = self._end
        self._expat.CharacterDataHandler = self._characters
        self._expat.StartDoctypeDeclHandler = self._document_type

    def feed(self, piece: str, *, last: bool) -> None:
        try:
            self._expat.Parse(piece.encode("utf-8", "surrogatepass"), last)
        except expat.ExpatError as error:
            self._source.fail(
                f"this is not well-formed XML: {expat.ErrorString(error.code)}",
                line=error.lineno,
                column=error.offset + 1,
            )

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        line, column = self._expat.CurrentLineNumber, self._expat.CurrentColumnNumber + 1
        self._depth += 1
        if self._depth > _DEPTH:
            self._source.fail(f"elements are nested more than {_DEPTH} deep", line=line, column=column)
        tag = tag.rpartition(":")[2]
        element = Element(self._source, tag, attributes, line, column)
        if self._open:
            self._open[-1].children.append(element)
        elif tag not in self._collect:
            self.done.append(element)
            return
        self._open.append(element)
        self._texts.append([])

    def _end(self, _: str) -> None:
        self._depth -= 1
        if self._open:
            element = self._open.pop()
            element.text = "".join(self._texts.pop())
            if not self._open:
                self.done.append(element)

    def _characters(self, text: str) -> None:
        if self._texts:
            self._texts[-1].append(text)

    def _document_type(self, name: str, *_: object) -> None:
        self._source.fail(
            f"the file has a document type (<!DOCTYPE {name[:40]}>), which can hide entities; models need none",
            line=self._expat.CurrentLineNumber,
            column=self._expat.CurrentColumnNumber + 1,
        )
