"""Lookup of functions in the source of their modules, which are not imported and so not run."""

from __future__ import annotations

import ast
import importlib.machinery
import sys
from pathlib import Path

from mdm.errors import ConfigError
from mdm.logic import similar

__all__ = ["look_for"]


def look_for(reference: str, folder: Path) -> bool:
    """Check that there seems to be a function ``module:name``, as far as the source tells.

    Returns:
        Whether the source says that it is an async function, and so takes time.

    Raises:
        ConfigError: If there is no such module, its source is not Python, or it defines no such name.
    """
    module, colon, attribute = reference.partition(":")
    if not colon or not module or not attribute:
        raise ConfigError(f"a function must be given as 'module:name', not {reference!r}")
    source = _source(module, folder)
    if source is None:
        return False
    try:
        tree = ast.parse(source.read_bytes(), source)
    except (SyntaxError, ValueError) as error:
        raise ConfigError(f"module {module!r} cannot be imported: {type(error).__name__}: {error}") from None
    names = _names(tree)
    name = attribute.partition(".")[0]
    if names is not None and name not in names:
        raise ConfigError(f"module {module!r} has no {name!r}{similar(name, names)}")
    return any(isinstance(node, ast.AsyncFunctionDef) and node.name == attribute for node in tree.body)


def _source(module: str, folder: Path) -> Path | None:
    """Return the file of a module; None if it is not written in Python.

    Raises:
        ConfigError: If there is no such module.
    """
    path = [str(folder.resolve()), *sys.path]
    parts = module.split(".")
    origin = None
    for place, part in enumerate(parts):
        if part in sys.builtin_module_names:
            return None
        found = importlib.machinery.PathFinder.find_spec(part, path)
        if found is None:
            name = ".".join(parts[: place + 1])
            raise ConfigError(f"there is no module {name!r}; the file's folder is searched first")
        origin = found.origin
        path = list(found.submodule_search_locations or [])
        if not path and place + 1 < len(parts):
            return None  # such as os.path, which is no file of its own
    return Path(origin) if origin is not None and origin.endswith(".py") else None


def _names(tree: ast.Module) -> set[str] | None:
    """Return the names that a module defines at its top, in any branch; None where that cannot be known."""
    names: set[str] = set()
    waiting: list[ast.AST] = [*tree.body]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.add(node.name)
            continue
        if isinstance(node, ast.Import | ast.ImportFrom):
            names |= {(alias.asname or alias.name).partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.Name) and node.id in {"globals", "setattr", "exec", "vars"}:
            return None
        waiting += ast.iter_child_nodes(node)
    return None if names & {"*", "__getattr__"} else names
