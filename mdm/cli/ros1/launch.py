"""Launch files of ROS 1: the nodes, with their arguments, parameters and remappings, as far as they can be known."""

from __future__ import annotations

import re
import shlex
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from mdm.errors import Error
from mdm.formats.markup import stream
from mdm.formats.source import Inventory, Source

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mdm.formats.markup import Element

_SUBSTITUTION = re.compile(r"\$\(\s*(\w+)\s*([^)]*)\)")
_MOST_INCLUDES = 1000
_LONGEST = 100_000
_TRUE, _FALSE = {"true", "1", "True"}, {"false", "0", "False"}


@dataclass
class Node:
    """A program that is started.

    Args:
        package: Whose program it is.
        type: The program.
        name: Its name.
        namespace: Where it runs, such as ``/agent/100``.
        arguments: Of its command line, without the program; None where they could not be known.
        remappings: From a topic to another one.
        parameters: Its private parameters.
        place: ``file:line``.
    """

    package: str
    type: str
    name: str
    namespace: str
    arguments: list[str] | None
    remappings: dict[str, str]
    parameters: dict[str, str]
    place: str

    def topic(self, name: str) -> str:
        """Return the full name of a topic or service that the program calls so."""
        full = self.remappings.get(name, name)
        return full if full.startswith("/") else f"{self.namespace.rstrip('/')}/{full}"


@dataclass
class Launch:
    """The programs that a launch file starts, with those that it includes.

    Args:
        nodes: The programs.
        parameters: Of namespaces, by full name.
        files: Files of parameters that are loaded: the namespace in which, and the path.
        notes: Unknown things that were left out, with their places.
    """

    nodes: list[Node] = field(default_factory=list)
    parameters: dict[str, str] = field(default_factory=dict)
    files: list[tuple[str, Path]] = field(default_factory=list)
    notes: Inventory = field(default_factory=Inventory)


class _Unknown(Exception):
    """A substitution that cannot be known here."""


def name_of(package: Path) -> str:
    """Return the name of a package: that of its ``package.xml``, else that of its folder."""
    file = package / "package.xml"
    if file.is_file():
        for element in stream(Source(file), {"name"}):
            if element.tag == "name" and element.text.strip():
                return element.text.strip()
    return package.name


def roots(package: Path) -> list[Path]:
    """Return the launch files of a package that can begin: no other one includes them, and they need no argument.

    Raises:
        Error: If there is no launch file.
    """
    files = sorted(package.rglob("*.launch"))
    if not files:
        raise Error(f"{package}: there is no launch file in this folder; name the folder of a package")
    texts = {path: path.read_text(encoding="utf-8", errors="replace") for path in files}
    included = set(re.findall(r"<include[^>]*file\s*=\s*[\"'][^\"']*?([\w.-]+\.launch)[\"']", "".join(texts.values())))
    needing = re.compile(r"<launch>\s*(?:<arg[^>]*>\s*)*<arg\s+name\s*=\s*\S+\s*/>")
    begins = [path for path in files if not needing.search(texts[path])] or files
    return [path for path in begins if path.name not in included] or begins


def read_launch(path: Path, package: Path) -> Launch:
    """Read a launch file and those that it includes.

    Args:
        path: The file.
        package: The folder of its package, for which ``$(find NAME)`` of that name stands.

    Raises:
        FormatError: If a file is malformed, or a program that makes layers depends on unknown values.
    """
    reader = _Reader(package)
    reader.read(path, {}, "")
    return reader.launch


class _Reader:
    def __init__(self, package: Path) -> None:
        self.package, self.name = package, name_of(package)
        self.launch = Launch()
        self._within: list[Path] = []
        self._included = 0

    def read(self, path: Path, given: dict[str, str], namespace: str) -> None:
        if path in self._within:
            raise Error(f"{path}: launch files include each other without end")
        self._included += 1
        if self._included > _MOST_INCLUDES:
            raise Error(f"{path}: there are more than {_MOST_INCLUDES:,} includes")
        self._within.append(path)
        elements = [element for element in stream(Source(path), {"launch"}) if element.tag == "launch"]
        if len(elements) != 1:
            raise Error(f"{path}: a <launch> was expected")
        self._walk(elements[0], dict(given), dict(given), namespace, {})
        self._within.pop()

    def _walk(
        self, parent: Element, known: dict[str, str], given: dict[str, str], namespace: str, remappings: dict[str, str]
    ) -> None:
        remappings = dict(remappings)
        for element in parent.children:
            if not self._holds(element, known):
                continue
            if element.tag == "arg":
                self._argument(element, known, given)
            elif element.tag == "group":
                inner = self._inner(element, known, namespace)
                self._walk(element, dict(known), given, inner, remappings)
            elif element.tag == "include":
                self._include(element, known, namespace)
            elif element.tag == "remap":
                remappings |= self._remapping(element, known)
            elif element.tag in {"param", "rosparam"}:
                self._parameter(element, known, namespace)
            elif element.tag == "node":
                self._node(element, known, namespace, remappings)

    def _holds(self, element: Element, known: dict[str, str]) -> bool:
        for name in ("if", "unless"):
            if name not in element.attributes:
                continue
            try:
                value = self._text(element.attributes[name], known).strip()
            except _Unknown as error:
                if element.tag not in {"group", "include"} and not self._matters(element):
                    what = f"<{element.tag}> depends on {name}={element.attributes[name]!r}: {error}"
                    self.launch.notes.leave(what, f"{element.source.path}:{element.line}")
                    return False
                element.fail(f"whether this <{element.tag}> counts cannot be known: {name}: {error}")
            if value not in _TRUE | _FALSE:
                element.fail(f"{name} was expected to be true or false, not {value!r}")
            if (value in _TRUE) is not (name == "if"):
                return False
        return True

    def _matters(self, element: Element) -> bool:
        """Whether an element may be of those that make layers."""
        package = element.attributes.get("pkg", "")
        return element.tag == "node" and (package == self.name or package.startswith("mdm"))

    def _argument(self, element: Element, known: dict[str, str], given: dict[str, str]) -> None:
        name = element.attribute("name")
        text = element.attributes.get("value", element.attributes.get("default"))
        if name in given and "value" not in element.attributes:
            known[name] = given[name]
        elif text is not None:
            with self._noting(element, f"the argument {name!r} is not known"):
                known[name] = self._text(text, known)

    def _inner(self, element: Element, known: dict[str, str], namespace: str) -> str:
        inner = element.attributes.get("ns", "")
        try:
            inner = self._text(inner, known)
        except _Unknown as error:
            element.fail(f"the namespace of this <{element.tag}> cannot be known: {error}")
        return inner if inner.startswith("/") else f"{namespace}/{inner}".rstrip("/")

    def _include(self, element: Element, known: dict[str, str], namespace: str) -> None:
        with self._noting(element, f"<include> of {element.attribute('file')}"):
            path = Path(self._text(element.attribute("file"), known))
            if not path.is_file():
                element.fail(f"there is no file {path}")
            given: dict[str, str] = {}
            for argument in element.all("arg"):
                with self._noting(argument, f"the argument {argument.attribute('name')!r} is not known"):
                    given[argument.attribute("name")] = self._text(argument.attribute("value"), known)
            self.read(path, given, self._inner(element, known, namespace))

    def _remapping(self, element: Element, known: dict[str, str]) -> dict[str, str]:
        found: dict[str, str] = {}
        with self._noting(element, f"<remap> of {element.attribute('from')!r}"):
            found[element.attribute("from")] = self._text(element.attribute("to"), known)
        return found

    def _parameter(self, element: Element, known: dict[str, str], namespace: str) -> None:
        """Note a parameter of a namespace, or a file of them."""
        with self._noting(element, f"<{element.tag}>"):
            if "file" in element.attributes:
                inner = self._inner(element, known, namespace)
                self.launch.files.append((inner, Path(self._text(element.attributes["file"], known))))
            elif "value" in element.attributes:
                name, value = element.attribute("name"), self._text(element.attributes["value"], known)
                self.launch.parameters[f"{namespace}/{name}"] = value

    def _node(self, element: Element, known: dict[str, str], namespace: str, remappings: dict[str, str]) -> None:
        inner = self._inner(element, known, namespace)
        own: dict[str, str] = {}
        for child in element.children:
            if not self._holds(child, known):
                continue
            if child.tag == "remap":
                remappings = remappings | self._remapping(child, known)
            elif child.tag == "param" and "value" in child.attributes:
                with self._noting(child, f"<param> {child.attribute('name')!r}"):
                    own[child.attribute("name")] = self._text(child.attributes["value"], known)
            elif child.tag == "rosparam" and child.text.strip():
                own |= dict(re.findall(r"^\s*([\w/]+)\s*:\s*([^\s#][^#\n]*?)\s*(?:#.*)?$", child.text, re.MULTILINE))
        arguments: list[str] | None
        try:
            arguments = shlex.split(self._text(element.attributes.get("args", ""), known))
        except (_Unknown, ValueError) as error:
            if self._matters(element):
                element.fail(f"the arguments of {element.attribute('type')!r} cannot be known: {error}")
            arguments = None
        package, program, name = (element.attribute(key) for key in ("pkg", "type", "name"))
        place = f"{element.source.path}:{element.line}"
        self.launch.nodes.append(Node(package, program, name, inner, arguments, remappings, own, place))

    def _text(self, text: str, known: dict[str, str]) -> str:
        """Return a text with its substitutions made."""

        def substituted(match: re.Match[str]) -> str:
            kind, rest = match[1], match[2].strip()
            if kind == "find":
                if rest != self.name:
                    raise _Unknown(f"the package {rest!r} is another one")
                return str(self.package)
            if kind == "arg":
                if rest not in known:
                    raise _Unknown(f"the argument {rest!r} has no value")
                return known[rest]
            if kind == "dirname":
                return str(self._within[-1].parent)
            if kind == "optenv" and " " in rest:
                return rest.split(maxsplit=1)[1]
            if kind == "anon":
                return rest
            raise _Unknown(f"{match[0]} is known on the robot alone")

        made = _SUBSTITUTION.sub(substituted, text)
        if len(made) > _LONGEST:
            raise Error(f"{self._within[-1]}: {text[:60]!r} becomes longer than {_LONGEST:,} characters")
        return made

    @contextmanager
    def _noting(self, element: Element, what: str) -> Iterator[None]:
        """Note a substitution of an element that cannot be known, and go on after the block."""
        try:
            yield
        except _Unknown as error:
            self.launch.notes.leave(f"{what}: {error}", f"{element.source.path}:{element.line}")
