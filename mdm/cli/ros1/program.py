"""Programs of the original's layers: the literal calls in C++ by which they are made.

Every call of an ``add…`` and every layer or controller that is made is taken or noted. This is no compiler. Calls of a
few names are found with their arguments, and texts are followed through one variable or ``argv``; all other code stays
with the robot, and is told with its place.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path

from mdm.formats.source import Inventory

Text = tuple[str | int, ...]
"""A text as its parts, one after the other: literals, and numbers of words of the command line."""

_NAME = r"[A-Za-z_]\w*"
_STRING = re.compile(r'"((?:[^"\\\n]|\\.)*)"')
_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/|\"(?:[^\"\\\n]|\\.)*\"|'(?:[^'\\\n]|\\.)+'", re.DOTALL)
_PLAIN = re.compile(r"[A-Za-z0-9_.:/]+")
_VARIABLES = 5
_CONNECTIVES = {"And": "and", "Or": "or", "Implies": "implies", "Xor": "xor"}
_KNOWN = {f"Controller{drive}{kind}" for drive in ("Event", "Timed") for kind in ("MDP", "POMDP")}
_CONTROLLER = r"(?:Controller|[A-Z]\w*(?:Controller|Learn)|ControlLayer|Dec(?:PO)?MDP)\w*"
_MADE = r"(new\s+|make_shared\s*<\s*)?\b(?:\w+\s*::\s*)*({})\b(?:\s*>)?\s*([A-Za-z_]\w*)?\s*([;({{{{])"
_ADDED = {"addStateFactor", "addObservationFactor", "addAction", "addPredicate", "addEvent"}
_SOURCES = {".cpp", ".cc", ".cxx", ".h", ".hpp"}


@dataclass
class Routine:
    """A function of the robot.

    Args:
        name: The function or method.
        place: ``file:line`` of its body, or of the call that names it.
        services: The services that its body calls.
    """

    name: str
    place: str
    services: tuple[str, ...] = ()


@dataclass
class Action:
    """An action that an action layer is given.

    Args:
        name: As the call says, or else that of the function.
        place: ``file:line`` of the call.
        way: Whether it is the label of a way of the map.
        routine: The function; None for a way.
    """

    name: str
    place: str
    way: bool = False
    routine: Routine | None = None


@dataclass
class Control:
    """A controller.

    Args:
        kind: The class, such as ``ControllerEventMDP``, or one that is not known, such as a learner.
        arguments: Of each the parts that make its text, see `Text`; None where it cannot be known.
        place: ``file:line``.
    """

    kind: str
    arguments: list[Text | None]
    place: str

    @property
    def is_known(self) -> bool:
        """Whether an ensemble can stand for it."""
        return self.kind in _KNOWN


@dataclass
class Declaration:
    """A predicate or an event.

    Args:
        name: Its name.
        kind: ``place``, ``formula``, ``latch`` or ``sensor``.
        place: ``file:line``.
        event: Whether it is an event.
        formula: In the syntax of a TOML file; empty where there is none.
        turns: Of a latch, the predicates that set and reset it.
        about: The code that tells it, in words; of a sensor.
    """

    name: str
    kind: str
    place: str
    event: bool = False
    formula: str = ""
    turns: tuple[str, str] = ("", "")
    about: str = ""


@dataclass
class Program:
    """The parts that a program makes.

    Args:
        path: Its source.
        states: The predicates of each state factor, with the place of its call.
        observations: The events of each observation factor, with the place of its call.
        controls: Its controllers.
        actions: Its actions.
        declarations: Its predicates and events.
        map: The topological map of its action layer, as `Control.arguments`; None where there is none.
        notes: Unread calls, with their places.
    """

    path: Path
    states: list[tuple[list[str], str]] = field(default_factory=list)
    observations: list[tuple[list[str], str]] = field(default_factory=list)
    controls: list[Control] = field(default_factory=list)
    actions: list[Action] = field(default_factory=list)
    declarations: list[Declaration] = field(default_factory=list)
    map: Text | None = None
    notes: Inventory = field(default_factory=Inventory)


def programs(package: Path) -> dict[str, list[Path]]:
    """Return the sources of each program of a package: those of CMakeLists.txt, or the file of its name."""
    found = {path.stem: [path] for path in sorted(package.rglob("*")) if path.suffix in _SOURCES - {".h", ".hpp"}}
    lists = package / "CMakeLists.txt"
    if lists.is_file():
        text = re.sub(r"#[^\n]*", "", lists.read_text(encoding="utf-8", errors="replace"))
        project = re.search(r"\bproject\s*\(\s*([\w.-]+)", text)
        if project is not None:
            text = text.replace("${PROJECT_NAME}", project[1])
        for name, sources in re.findall(r"\b(?:rosbuild_)?add_executable\s*\(\s*([\w.-]+)([^)]*)\)", text):
            paths = [package / word for word in sources.split() if Path(word).suffix in _SOURCES]
            if paths and all(path.is_file() for path in paths):
                found[name] = paths
    return found


def read_program(paths: list[Path], package: Path) -> Program:
    """Read the sources of a program, and the headers of its package that they include."""
    return _Reader(paths, package).program


def _blank(match: re.Match[str]) -> str:
    """Return a text as it is, and blanks in place of a comment."""
    return match[0] if match[0].startswith(('"', "'")) else re.sub(r"[^\n]", " ", match[0])


def _closed(code: str, start: int, pair: str = "()") -> int:
    """Return where the bracket that opens at a place is closed; the end of the code where it is not."""
    depth, position = 0, start
    while position < len(code):
        text = _STRING.match(code, position)
        if text is not None:
            position = text.end()
            continue
        depth += (code[position] == pair[0]) - (code[position] == pair[1])
        if depth == 0:
            return position
        position += 1
    return len(code)


def _split(arguments: str, at: str = ",") -> list[str]:
    """Return the arguments of a call, or the parts of a sum."""
    parts, begin, position = [], 0, 0
    while position < len(arguments):
        text = _STRING.match(arguments, position)
        if text is not None:
            position = text.end()
        elif arguments[position] in "({":
            position = _closed(arguments, position, "()" if arguments[position] == "(" else "{}") + 1
        elif arguments[position] == at:
            parts.append(arguments[begin:position].strip())
            position = begin = position + 1
        else:
            position += 1
    last = arguments[begin:].strip()
    return [*parts, last] if last else parts


def _added(code: str) -> list[str]:
    """Return the arguments of all calls of `add` in code; the number of a predicate manager may come before it."""
    calls = re.finditer(r"\.\s*add\s*\(", code)
    return ["".join(_split(code[call.end() : _closed(code, call.end() - 1)])[-1:]) for call in calls]


def _text(expression: str) -> str | None:
    """Return the text that an expression is; None where it is none."""
    inner = re.fullmatch(r"(?:std\s*::\s*)?string\s*\((.*)\)", expression.strip(), re.DOTALL)
    literals = re.fullmatch(r'(?:"(?:[^"\\\n]|\\.)*"\s*)+', (inner[1] if inner else expression).strip())
    return None if literals is None else "".join(_STRING.findall(literals[0]))


class _Reader:
    """Reads the code of a program, whose files are one text without comments."""

    def __init__(self, paths: list[Path], package: Path) -> None:
        self.code = ""
        self._files: dict[Path, int] = {}
        queue = list(paths)
        while queue:
            path = queue.pop(0)
            if path in self._files:
                continue
            code = path.read_text(encoding="utf-8", errors="replace")
            self._files[path] = len(self.code)
            self.code += _COMMENT.sub(_blank, code) + "\n"
            for name in re.findall(r'#\s*include\s*["<]([^">]+)[">]', code):
                queue += [one for one in (path.parent / name, package / "include" / name) if one.is_file()]
        self.program = Program(paths[0])
        self._read: set[int] = set()
        made = rf"\b(StateLayer|ObservationLayer|\w*ActionLayer|PredicateManager)\s+({_NAME})\s*[;({{]"
        self._layers = {name: kind for kind, name in re.findall(made, self.code)}
        self._clients = dict(
            re.findall(rf'({_NAME})\s*(?:=|\()\s*(?:\w+\s*\.\s*)?serviceClient\s*<[^>]*>\s*\(\s*"([^"]+)"', self.code)
        )
        self._factors("addStateFactor", self.program.states)
        self._factors("addObservationFactor", self.program.observations)
        self._controls()
        self._actions()
        self._predicates()
        # The calls and layers that are not read.
        for match in re.finditer(r"\b(add[A-Z]\w*)\s*\(", self.code):
            if match.start() not in self._read:
                why = "its layer is not known" if match[1] in _ADDED else "this call is not known"
                self.program.notes.leave(f"{match[1]} (…)", self._place(match.start()), why)
        for match in re.finditer(_MADE.format(r"[A-Z]\w*(?:Layer|Manager)"), self.code):
            known = match[2] in {"StateLayer", "ObservationLayer", "PredicateManager"} or match[2].endswith(
                "ActionLayer"
            )
            if (match[1] or match[3]) and not known and match.start(2) not in self._read:
                self.program.notes.leave(match[2], self._place(match.start(2)), "this layer is not known")

    def _place(self, position: int) -> str:
        """Return the file and the line of a place in the code."""
        path, start = [each for each in self._files.items() if each[1] <= position][-1]
        lines = list(accumulate((len(line) for line in self.code[start:].splitlines(keepends=True)), initial=0))
        return f"{path}:{bisect_right(lines, position - start)}"

    def _calls(self, name: str) -> list[tuple[str, list[str], int]]:
        """Return the calls of a method: the object, the arguments, and the place of each."""
        found = []
        for match in re.finditer(rf"\b({_NAME})\s*(?:\(\s*\)\s*)?(?:\.|->)\s*({name})\s*\(", self.code):
            end = _closed(self.code, match.end() - 1)
            self._read.add(match.start(2))
            found.append((match[1], _split(self.code[match.end() : end]), match.start()))
        return found

    def _value(self, expression: str, depth: int = 0) -> Text | None:
        """Return the parts of a text: literals, and words of the command line; through a few variables."""
        parts = _split(expression, "+")
        if len(parts) > 1:
            values = [self._value(part, depth) for part in parts]
            return None if None in values else tuple(each for value in values if value for each in value)
        text = _text(expression)
        if text is not None:
            return (text,)
        word = re.fullmatch(r"(?:(?:std\s*::\s*)?string\s*\(\s*)?argv\s*\[\s*(\d+)\s*\]\s*\)?", expression.strip())
        if word is not None:
            return (int(word[1]),)
        if not re.fullmatch(_NAME, expression.strip()) or depth == _VARIABLES:
            return None
        name = re.escape(expression.strip())
        given = re.search(rf"\b{name}\s*=\s*([^;]+);", self.code) or re.search(
            rf"\bstring\s+{name}\s*\(([^;]*)\)\s*;", self.code
        )
        return None if given is None else self._value(given[1], depth + 1)

    def _literal(self, expression: str) -> str | None:
        """Return the text of an expression; None where it is not known from the program alone."""
        value = self._value(expression)
        if value is None or not all(isinstance(part, str) for part in value):
            return None
        return "".join(map(str, value))

    def _factors(self, call: str, into: list[tuple[list[str], str]]) -> None:
        for _, arguments, start in self._calls(call):
            place = self._place(start)
            added = _added(", ".join(arguments))
            if not added and arguments and re.fullmatch(_NAME, arguments[0]):
                of = rf"\b(?:{arguments[0]}\s*\.|{arguments[0]}\s*=|Dep\s+{arguments[0]}\b)[^;]*;"
                added = [each for statement in re.findall(of, self.code) for each in _added(statement)]
            names = [name for each in added if (name := self._literal(each)) is not None]
            if names and len(names) == len(added):
                into.append((names, place))
            else:
                self.program.notes.leave(f"{call} ({', '.join(arguments)})", place, "its names are not literal")

    def _controls(self) -> None:
        for match in re.finditer(_MADE.format(_CONTROLLER), self.code):
            self._read.add(match.start(2))
            if not match[1] and not match[3]:
                continue  # its class, or a function
            end = _closed(self.code, match.end() - 1, "()" if match[4] == "(" else "{}")
            given = "" if match[4] == ";" else self.code[match.end() : end]
            control = Control(match[2], [self._value(each) for each in _split(given)], self._place(match.start(2)))
            self.program.controls.append(control)
            if not control.is_known:
                why = "this controller is not known; what is beside it is taken"
                self.program.notes.leave(control.kind, control.place, why)

    def _actions(self) -> None:
        navigators = {name for name, kind in self._layers.items() if "Topological" in kind}
        for name, kind in self._layers.items():
            if "Topological" in kind:
                made = re.search(rf"\b{kind}\s+{name}\s*\(", self.code)
                if made is not None:
                    given = _split(self.code[made.end() : _closed(self.code, made.end() - 1)])
                    self.program.map = self._value(given[0]) if given else None
        for layer, arguments, start in self._calls("addAction"):
            place = self._place(start)
            first = next((text for each in arguments if (text := _text(each)) is not None), None)
            if layer in navigators and first is not None and len(arguments) == 1:
                self.program.actions.append(Action(first, place, way=True))
                continue
            callback = next((each for each in arguments if _text(each) is None), "")
            target = re.search(
                rf"&?\s*((?:{_NAME}\s*::\s*)*{_NAME})", re.sub(r"^.*?bind\s*(?:<[^>]*>)?\s*\(", "", callback)
            )
            if target is None:
                self.program.notes.leave(f"addAction ({', '.join(arguments)})", place, "it names no function")
                name = first or f"action{len(self.program.actions)}"  # actions count by their order
                self.program.actions.append(Action(name, place, routine=Routine(name, place)))
                continue
            name = re.sub(r"\s", "", target[1]).rpartition("::")[2]
            routine = self._routine(name, place)
            self.program.actions.append(Action(first or name, place, routine=routine))

    def _routine(self, name: str, place: str) -> Routine:
        """Return a function of the robot, with the services that its body calls."""
        for match in re.finditer(rf"\b{re.escape(name)}\s*\(", self.code):
            end = _closed(self.code, match.end() - 1)
            body = re.match(r"\)\s*(?:const\s*)?\{", self.code[end:])
            if body is None:
                continue
            begin = end + body.end() - 1
            inner = self.code[begin : _closed(self.code, begin, "{}")]
            called = [
                self._clients[client]
                for client in re.findall(rf"\b({_NAME})\s*\.\s*call\s*\(", inner)
                if client in self._clients
            ]
            called += re.findall(r'service\s*::\s*call\s*\(\s*"([^"]+)"', inner)
            return Routine(name, self._place(match.start()), tuple(called))
        return Routine(name, place)

    def _predicates(self) -> None:
        classes = self._classes()
        for call, event in (("addPredicate", False), ("addEvent", True)):
            for _, arguments, start in self._calls(call):
                place = self._place(start)
                variable = (arguments[0] if arguments else "").strip("*& ")
                declared = self._declaration(variable, classes, event=event)
                if declared is None:
                    self.program.notes.leave(f"{call} ({', '.join(arguments)})", place, "what it adds is not known")
                else:
                    self.program.declarations.append(declared)

    def _declaration(self, variable: str, classes: dict[str, Declaration], *, event: bool) -> Declaration | None:
        made = re.search(rf"\b({_NAME})\s+{re.escape(variable)}\s*([;(])", self.code) if variable else None
        if made is None:
            return None
        place = self._place(made.start())
        arguments = _split(self.code[made.end() : _closed(self.code, made.end() - 1)]) if made[2] == "(" else []
        kind = made[1]
        if kind == "TopologicalPredicate":
            names = [value for value in map(self._literal, arguments) if value is not None]
            return Declaration(names[-1], "place", place) if names else None
        if kind in {"PropLogicPredicate", "PropLogicEvent"} and len(arguments) == 2:
            name = self._literal(arguments[0])
            formula = self._formula(arguments[1])
            if name is None:
                return None
            if formula is None:
                return Declaration(name, "sensor", place, event, about=f"{kind} ({arguments[1]})")
            return Declaration(name, "formula", place, event, formula)
        found = classes.get(kind)
        if found is None:
            return None
        first = self._literal(arguments[0]) if arguments else None
        if not found.name and first is not None:
            return Declaration(first, found.kind, found.place, event, turns=found.turns, about=found.about)
        return found if found.name else None

    def _classes(self) -> dict[str, Declaration]:
        """Return the classes of predicates and events that the program derives."""
        found = {}
        for match in re.finditer(
            rf"\bclass\s+({_NAME})\s*:\s*public\s+(?:{_NAME}\s*::\s*)*(Predicate|Event)\b", self.code
        ):
            begin = self.code.find("{", match.end())
            body = self.code[begin : _closed(self.code, begin, "{}")]
            named = re.search(
                rf"\b{match[2]}\s*\(\s*(?:{_NAME}\s*,\s*)?(?:std\s*::\s*string\s*\(\s*)?\"([^\"]+)\"", body
            )
            latch = re.search(
                r"if\(getValue\(\)\)\{?if\(getDependencyValue\(\"([^\"]+)\"\)\)\{?setValue\(false\);\}*"
                r"else\{?if\(getDependencyValue\(\"([^\"]+)\"\)\)\{?setValue\(true\);",
                re.sub(r"\s", "", body),
            )
            place = self._place(match.start())
            about = f"class {match[1]}"
            needs = re.findall(r'\.\s*add\s*\(\s*"([^"]+)"\s*\)', body)
            if needs:
                about += f", which depends on {', '.join(needs)}"
            found[match[1]] = Declaration(
                named[1] if named else "",
                "latch" if latch else "sensor",
                place,
                match[2] == "Event",
                turns=(latch[2], latch[1]) if latch else ("", ""),
                about=about,
            )
        return found

    def _formula(self, expression: str) -> str | None:
        """Return a formula in the syntax of a TOML file; None where it is not made of literal parts."""
        name = _text(expression)
        if name is not None:
            return name if _PLAIN.fullmatch(name) else f"'{name}'"
        call = re.match(rf"(?:{_NAME}\s*::\s*)*({_NAME})\s*\(", expression)
        if call is None or _closed(expression, call.end() - 1) != len(expression) - 1:
            return None
        arguments = _split(expression[call.end() : -1])
        parts = [self._formula(each) for each in arguments]
        if call[1] == "PV" and len(parts) == 1:
            return parts[0]
        if not parts or None in parts:
            return None
        if call[1] == "Not" and len(parts) == 1:
            return f"not {parts[0]}"
        if call[1] in _CONNECTIVES and len(parts) > 1:
            return f"({f' {_CONNECTIVES[call[1]]} '.join(map(str, parts))})"
        return None
