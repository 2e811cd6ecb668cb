"""The house measured: lines, files, classes, doors, words; `python tests/house.py` writes where they fell.

What a change may not exceed stands in `house.toml`. A feature raises a row by its stated budget and by no more; every
other change leaves a row as it is or lowers it.
"""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

PACKAGE = Path(__file__).resolve().parents[1] / "mdm"
LIMITS = Path(__file__).with_name("house.toml")
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
MANY_ATTRIBUTES, MANY_METHODS = 20, 30


def sources(root: Path = PACKAGE) -> dict[str, str]:
    """Return the text of each module by its path."""
    return {path.relative_to(root).as_posix(): path.read_text(encoding="utf-8") for path in sorted(root.rglob("*.py"))}


def room(path: str) -> str:
    """Return the package that a module is of, ``top`` for those beside the packages."""
    return path.split("/", maxsplit=1)[0] if "/" in path else "top"


def docstrings(nodes: list[ast.AST]) -> list[ast.Expr]:
    """Return the docstrings among the nodes of a module."""
    documented = (node for node in nodes if isinstance(node, (ast.Module, ast.ClassDef, *FUNCTIONS)))
    return [node.body[0] for node in documented if ast.get_docstring(node, clean=False) is not None]


def statements(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield a module or a class, and all statements within it, but for expressions, which are most nodes."""
    yield tree
    for part in ("body", "orelse", "finalbody", "handlers", "cases"):
        inner = getattr(tree, part, ())
        for each in inner if isinstance(inner, list) else ():
            yield from statements(each)


def attributes(node: ast.ClassDef) -> int:
    """Return how many attributes a class sets on itself, in its fields and its methods."""
    fields = {
        item.target.id for item in node.body if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)
    }
    targets: list[ast.expr] = []
    for item in statements(node):
        targets += item.targets if isinstance(item, ast.Assign) else []
        targets += [item.target] if isinstance(item, (ast.AnnAssign, ast.AugAssign, ast.For)) else []
    stored = {
        part.attr
        for target in targets
        for part in ast.walk(target)
        if isinstance(part, ast.Attribute) and isinstance(part.value, ast.Name) and part.value.id == "self"
    }
    return len(fields | stored)


def measured(texts: dict[str, str]) -> dict[str, dict[str, float | int]]:
    """Return the figures of a house, by table and row."""
    found: dict[str, dict[str, float | int]] = {
        name: {} for name in ("lines", "files", "what", "attributes", "methods")
    }
    words: dict[str, list[int]] = {}
    documented = total = 0
    reaching: set[str] = set()
    for path, text in texts.items():
        where, tree, lines = room(path), ast.parse(text), len(text.splitlines())
        total += lines
        found["lines"][where] = found["lines"].get(where, 0) + lines
        found["files"][where] = found["files"].get(where, 0) + 1
        nodes = list(statements(tree))
        if re.search(r"^(?!\s*(?:from|import) ).*\.control\b(?!\s*(?::.*)?=[^=])", text, re.MULTILINE):
            reaching.add(path)
        for node in docstrings(nodes):
            documented += (node.end_lineno or 0) - node.lineno + 1
            spoken = re.findall(r"[A-Za-z]+", node.value.value)
            words.setdefault(where, [0, 0])
            words[where][0] += sum(word.lower() in {"what", "whatever"} for word in spoken)
            words[where][1] += len(spoken)
        for node in nodes:
            if isinstance(node, ast.ClassDef):
                if (count := attributes(node)) > MANY_ATTRIBUTES:
                    found["attributes"][f"{path}:{node.name}"] = count
                if (count := sum(isinstance(item, FUNCTIONS) for item in node.body)) > MANY_METHODS:
                    found["methods"][f"{path}:{node.name}"] = count
    found["what"] = {where: round(1000 * ours / max(of, 1), 1) for where, (ours, of) in words.items()}
    everything = "\n".join(texts.values())
    found["house"] = {
        "lines": total,
        "files": len(texts),
        "docstrings per cent": round(100 * documented / total, 1),
        "noqa": everything.count("# noqa"),
        "type: ignore": everything.count("# type: ignore"),
        "imports of other packages by string": sum(
            package != room(path)
            for path, text in texts.items()
            for package in re.findall(r"import_module\(\s*f?[\"']mdm\.(\w+)", text)
        ),
        "files that reach an ensemble's control": len(reaching),
        "files that set whether control runs": sum(
            bool(re.search(r"\bcontrol\.running\s*=[^=]", text)) for text in texts.values()
        ),
    }
    return found


def excess(found: dict[str, dict[str, float | int]], limits: dict[str, dict[str, float | int]]) -> list[str]:
    """Return what is beyond its limit, or short of it where more is better, in sentences."""
    said = []
    for table, rows in found.items():
        for row, figure in rows.items():
            limit = limits.get(table, {}).get(row)
            if limit is None:
                said.append(f"{table}: {row!r} has {figure} and no limit: it is new")
            elif figure < limit if row.startswith("docstrings") else figure > limit:
                said.append(f"{table}: {row!r} has {figure}, and {limit} is its limit")
    return said


def written(found: dict[str, dict[str, float | int]]) -> str:
    """Return figures as a file of limits."""
    head = "# The limits of the house: no change raises a row but a feature, by the budget that it names.\n"
    tables = (
        "".join([f"\n[{table}]\n", *(f'"{row}" = {figure}\n' for row, figure in sorted(rows.items()))])
        for table, rows in found.items()
    )
    return head + "".join(tables)


def main() -> int:
    """Lower the limits to the figures; print those that they exceed, and leave them."""
    found = measured(sources())
    limits = tomllib.loads(LIMITS.read_text(encoding="utf-8")) if LIMITS.is_file() else found
    beyond = excess(found, limits)
    print("\n".join(beyond))
    if not beyond:
        LIMITS.write_text(written(found), encoding="utf-8")
    return int(bool(beyond))


if __name__ == "__main__":
    sys.exit(main())
