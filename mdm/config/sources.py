"""Lookup of functions in the source of their modules, which are not imported and so not run."""

from __future__ import annotations

import ast
import importlib.machinery
import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from mdm.errors import ConfigError
from mdm.logic import similar

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["look_for", "named_in", "refuse_shadowed"]

_LIBRARIES = sys.stdlib_module_names | {"mdm", "anyio", "msgspec", "numpy"}
"""What is loaded in each process that runs robots; other modules are looked at without regard to those of this one."""
_Definition = ast.FunctionDef | ast.AsyncFunctionDef
_YIELDS = ast.parse("yield").body
_ANY = cast("_Definition", ast.parse("def any(*_, **__): ...").body[0]).args


def look_for(reference: str, folder: Path) -> Callable[..., Any] | None:
    """Check that there seems to be a function ``module:name``, as far as the source tells.

    Returns:
        A function that does nothing, of the same kind (async, a generator's) and with the same arguments; None where
        the source does not tell these, as of what is imported or decorated.

    Raises:
        ConfigError: If there is no such module, its source is not Python, it defines no such name, or another module
            of that name is already loaded.
    """
    module, attribute = named_in(reference)
    source = _source(module, folder)
    name = module.partition(".")[0]
    if name in _LIBRARIES:
        refuse_shadowed(name, folder.resolve())
    if source is None:
        return None
    try:
        tree = ast.parse(source.read_bytes(), source)
    except (SyntaxError, ValueError) as error:
        raise ConfigError(f"module {module!r} cannot be imported: {type(error).__name__}: {error}") from None
    names = _names(tree)
    name = attribute.partition(".")[0]
    if names is not None and name not in names:
        raise ConfigError(f"module {module!r} has no {name!r}{similar(name, names)}")
    defined = [node for node in tree.body if isinstance(node, _Definition) and node.name == attribute]
    if len(defined) == 1 and names is not None and names[name] == 1 and not defined[0].decorator_list:
        return _stand_in(defined[0], defined[0].args, module)
    lasting = next((each for each in defined if isinstance(each, ast.AsyncFunctionDef) and not _yields(each)), None)
    return None if lasting is None else _stand_in(lasting, _ANY, module)


def named_in(reference: str) -> tuple[str, str]:
    """Return the module and the name in it of ``module:name``; refuse any other text."""
    module, colon, attribute = reference.partition(":")
    if not colon or not module or not attribute:
        raise ConfigError(f"a function must be given as 'module:name', not {reference!r}")
    if module.endswith(".py"):
        raise ConfigError(f"a module is given without its suffix: '{module.removesuffix('.py')}:{attribute}'")
    return module, attribute


def refuse_shadowed(name: str, folder: Path) -> None:
    """Refuse a loaded module from elsewhere if the file's folder has one of the same name.

    Raises:
        ConfigError: If it has.
    """
    beside = (folder / f"{name}.py", folder / name / "__init__.py")
    if name not in sys.modules or not any(path.exists() for path in beside):
        return
    origin = getattr(sys.modules[name], "__file__", None)
    if origin is None or Path(origin).resolve() not in beside:
        place = "Python itself" if origin is None else origin
        raise ConfigError(f"another module {name!r} is already loaded, from {place}: rename the one beside the file")


def _stand_in(definition: _Definition, arguments: ast.arguments, module: str) -> Callable[..., Any]:
    """Return a function of the same kind that does nothing: of the source no more than the arguments' names is run."""
    nothing = ast.Constant(None)
    bare = ast.arguments(
        posonlyargs=[ast.arg(each.arg) for each in arguments.posonlyargs],
        args=[ast.arg(each.arg) for each in arguments.args],
        vararg=None if arguments.vararg is None else ast.arg(arguments.vararg.arg),
        kwonlyargs=[ast.arg(each.arg) for each in arguments.kwonlyargs],
        kw_defaults=[None if each is None else nothing for each in arguments.kw_defaults],
        kwarg=None if arguments.kwarg is None else ast.arg(arguments.kwarg.arg),
        defaults=[nothing for _ in arguments.defaults],
    )
    body: list[ast.stmt] = [*_YIELDS] if _yields(definition) else [ast.Pass()]
    options: dict[str, Any] = {"type_params": []} if "type_params" in definition._fields else {}
    node = type(definition)(definition.name, bare, body, [], **options)
    names: dict[str, Any] = {"__name__": module}
    exec(compile(ast.fix_missing_locations(ast.Module([node], [])), module, "exec"), names)  # noqa: S102 - see above
    return cast("Callable[..., Any]", names[definition.name])


def _yields(definition: _Definition) -> bool:
    """Whether a function is a generator's, by a ``yield`` of its own."""
    waiting: list[ast.AST] = [*definition.body]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Yield | ast.YieldFrom):
            return True
        if not isinstance(node, _Definition | ast.Lambda | ast.ClassDef):
            waiting += ast.iter_child_nodes(node)
    return False


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


def _names(tree: ast.Module) -> Counter[str] | None:
    """Return how often a module defines each name at its top, in any branch; None where that cannot be known."""
    names: Counter[str] = Counter()
    waiting: list[ast.AST] = [*tree.body]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names[node.name] += 1
            continue
        if isinstance(node, ast.Import | ast.ImportFrom):
            names.update((alias.asname or alias.name).partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names[node.id] += 1
        elif isinstance(node, ast.Name) and node.id in {"globals", "setattr", "exec", "vars"}:
            return None
        waiting += ast.iter_child_nodes(node)
    return None if {"*", "__getattr__"} & names.keys() else names
