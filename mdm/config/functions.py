"""Lookup of functions that a TOML file names as ``module:name``, in modules that are imported or in their source."""

from __future__ import annotations

import ast
import asyncio
import importlib
import importlib.machinery
import inspect
import math
import re
import sys
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from mdm.actors.actions.binding import Binding
from mdm.errors import ConfigError, Error
from mdm.logic import similar
from mdm.policies import BeliefPolicy, StatePolicy
from mdm.runtime.supervision import describe

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from mdm.actors import ObservationFactor, StateFactor
    from mdm.config.tables import Problems
    from mdm.models import MDP
    from mdm.policies import Policy


class Functions:
    """Finds the functions that a file names, and notes problems.

    Args:
        folder: The file's folder, whose modules take precedence.
        problems: Where problems are noted.
        callbacks: Whether functions are imported; otherwise each is one that does nothing, for as long as somebody says
            where the source of its module says that it is async.
        look: Whether functions that are not imported are looked for in the source of their modules; each is then one
            of that name, kind and arguments, or an `Unseen` one where the source does not tell.

    Attributes:
        imported: Whether the functions found are those that the file names, and not stand-ins that do nothing.
        looks: Whether no module is to be run at all.
        made: Stand-ins for objects that a record does not hold, by their references.
    """

    def __init__(self, folder: Path, problems: Problems, *, callbacks: bool, look: bool = False) -> None:
        self.made: Mapping[str, Any] = {}
        self._folder = folder
        self._problems = problems
        self.imported = callbacks
        self.looks = look

    def make(self, reference: str, key: str, model: MDP | None) -> Any:
        """Return the result of the class or function ``module:name``; None where there is none, or no module is run."""
        return (
            self.made[reference]
            if reference in self.made
            else self._problems.attempt(key, self._made, reference, model)
        )

    def _made(self, reference: str, model: MDP | None) -> Any:
        if not self.looks:
            return made(find_function(reference, self._folder), reference, model)
        look_for(reference, self._folder)
        return None

    def find(self, reference: str, key: str) -> Callable[..., Any] | None:
        """Return the function named ``module:name``; None where there is none, which is noted with its key."""
        return self._problems.attempt(key, self._found, reference)

    def find_action(self, reference: str, key: str, model: Callable[[], MDP | None]) -> Any:
        """Return a function or `Binding` of that name, or the binding that a function so annotated makes, as `find`."""
        return self._problems.attempt(key, self._action, reference, model)

    def _action(self, reference: str, model: Callable[[], MDP | None]) -> Any:
        found: Any = find_function(reference, self._folder, Binding) if self.imported else self._found(reference)
        returns = getattr(found, "__annotations__", {}).get("return")
        if returns is not Binding and not (isinstance(returns, str) and returns.rpartition(".")[2] == "Binding"):
            return found
        binding = made(found, reference, model())
        if not isinstance(binding, Binding):
            raise ConfigError(f"{reference!r} returned {binding!r} in place of a Binding")
        return binding

    def _found(self, reference: str) -> Callable[..., Any]:
        if self.imported:
            return find_function(reference, self._folder)
        if self.looks:
            return look_for(reference, self._folder) or Unseen(reference)
        lasts = False
        with suppress(ConfigError):  # nothing need be there
            lasts = inspect.iscoroutinefunction(look_for(reference, self._folder))
        return Lasting() if lasts else nothing


def find_function(reference: str, folder: Path, *kinds: type) -> Callable[..., Any]:
    """Return the function ``module:name`` or ``module:object.name``; modules beside the file take precedence.

    Objects of further kinds may stand there.

    Raises:
        ConfigError: If there is no such module or function, the module cannot be imported, or another module of that
            name is already loaded.
    """
    module_name, attribute = named_in(reference)
    place = str(folder.resolve())
    if place not in sys.path:
        sys.path.insert(0, place)
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        missing = repr(error.name) if error.name == module_name else f"{error.name!r}, which {module_name!r} imports"
        raise ConfigError(f"there is no module {missing}; the file's folder is searched first") from None
    except (Exception, SystemExit) as error:
        raise ConfigError(f"module {module_name!r} cannot be imported: {type(error).__name__}: {error}") from None
    refuse_shadowed(module_name.partition(".")[0], folder.resolve())
    function: Any = module
    for part in attribute.split("."):
        names = [name for name in dir(function) if not name.startswith("_")]
        function = getattr(function, part, None)
        if function is None:
            raise ConfigError(f"module {module_name!r} has no {attribute!r}{similar(part, names)}")
    if not callable(function) and not isinstance(function, kinds):
        raise ConfigError(f"{reference!r} is a {type(function).__name__}, not a function")
    return cast("Callable[..., Any]", function)


class Lasting:
    """Stands for an async function that is not to be called: it lasts until somebody says how it ends."""

    def __init__(self) -> None:
        self._ends: list[asyncio.Future[None]] = []

    async def __call__(self) -> None:
        """Do nothing until the end."""
        end = asyncio.get_running_loop().create_future()
        self._ends.append(end)
        try:
            await end
        finally:
            self._ends.remove(end)

    def end(self, error: Exception | None = None) -> None:
        """End all that last: they fail with an error, where one is given."""
        for end in self._ends:
            if not end.done() and error is None:
                end.set_result(None)
            elif not end.done() and error is not None:
                end.set_exception(error)


class Unseen:
    """Stands for a function whose kind and arguments are not known without its module being run.

    Args:
        reference: The function, ``module:name``.
    """

    def __init__(self, reference: str) -> None:
        self.__module__, _, self.__qualname__ = reference.partition(":")
        self.__name__ = self.__qualname__.rpartition(".")[2]

    def __call__(self) -> None:
        """Do nothing."""


def nothing() -> None:
    """Do nothing, in place of a function that is not to be called."""


_LIBRARIES = sys.stdlib_module_names | {"mdm", "anyio", "msgspec", "numpy"}
"""What is loaded in each process that runs robots; other modules are looked at without regard to those of this one."""
_Definition = ast.FunctionDef | ast.AsyncFunctionDef
_YIELDS = ast.parse("yield").body
_ANY = cast("_Definition", ast.parse("def any(*_, **__): ...").body[0]).args


def look_for(reference: str, folder: Path) -> Callable[..., Any] | None:
    """Check that there seems to be a function ``module:name``, as far as the source tells.

    Returns:
        A function that does nothing, of the same kind (async, a generator's) and with the same arguments; None where
        the source does not tell these, as of imported or decorated functions.

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
    if len(defined) == 1 and names is not None and names[name] == 1 and not _is_made(defined[0]):
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


def _is_made(definition: _Definition) -> bool:
    """Whether the function at work is another one: a decorator's, or of the binding that it returns."""
    returns = "" if definition.returns is None else ast.unparse(definition.returns).strip("'")
    return bool(definition.decorator_list) or returns.rpartition(".")[2] == "Binding"


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


_REFERENCE = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")


def is_reference(text: object) -> bool:
    """Whether a text is ``module:name``, and no path."""
    return isinstance(text, str) and _REFERENCE.fullmatch(text) is not None


def made(make: Callable[..., Any], reference: str, model: MDP | None) -> Any:
    """Return the result of a class or function, called with the model, or without arguments where it takes none.

    Raises:
        ConfigError: If it raises, or takes other arguments.
    """
    try:
        needed = [
            one
            for one in inspect.signature(make).parameters.values()
            if one.default is one.empty and one.kind not in {one.VAR_POSITIONAL, one.VAR_KEYWORD}
        ]
        arguments = (model,) * len(needed)
        if len(needed) > 1 or any(one.kind is one.KEYWORD_ONLY for one in needed):
            names = ", ".join(one.name for one in needed)
            raise ConfigError(f"{reference!r} is called with the model, or without arguments, but needs {names}")
        return make(*arguments)
    except Error:
        raise
    except Exception as error:
        raise ConfigError(f"{reference!r} has raised {describe(error)}") from None


def unseen_policy(
    reference: str,
    model: MDP | None,
    actions: int,
    states: Sequence[StateFactor],
    observations: Sequence[ObservationFactor],
) -> Policy:
    """Return a stand-in for a policy whose module is not run: of the sizes, and the input, that all else says.

    Args:
        reference: The name of its maker.
        model: Its model, if there is one.
        actions: The number of actions bound.
        states: The factors that the ensemble has.
        observations: Those of its observations.
    """
    over_beliefs = bool(observations) or (not states and model is not None and model.pomdp is not None)
    kind: Any = BeliefPolicy if over_beliefs else StatePolicy
    sizes = {
        "num_states": math.prod(factor.size for factor in states) if model is None else len(model.state_space),
        "num_actions": actions if model is None else len(model.action_space),
        "form": f"made by {reference}",
        "action": _first,
    }
    policy: Policy = type("UnseenPolicy", (kind,), sizes)()
    return policy


def _first(_policy: object, _x: object) -> int:
    return 0
