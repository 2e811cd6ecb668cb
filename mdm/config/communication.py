"""The communication policy of a file: one of the library's by its name, or a function that makes one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from mdm.config.tables import Table
from mdm.errors import ConfigError
from mdm.logic import similar
from mdm.team import Always, Budget, Never, OnChange, ValueOfCommunication

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.config.functions import Functions
    from mdm.config.problems import Problems
    from mdm.team import CommunicationPolicy

__all__ = ["read_communication"]

_KINDS: dict[str, tuple[Any, tuple[str, ...], tuple[str, ...]]] = {
    "always": (Always, (), ()),
    "never": (Never, (), ()),
    "on_change": (OnChange, (), ()),
    "budget": (Budget, ("messages_per_second",), ("of", "burst")),
    "value_of_communication": (ValueOfCommunication, ("threshold",), ()),
}
"""What makes each of them, and the keys that it needs and takes."""


class CommunicationTable(Table, frozen=True):
    """A communication policy; short form: its name.

    Attributes:
        policy: ``always``, ``never``, ``on_change``, ``budget`` or ``value_of_communication``.
    """

    policy: str
    messages_per_second: float | None = None
    burst: int | None = None
    of: str | None = None
    threshold: float | None = None


def read_communication(
    given: object, functions: Functions, problems: Problems, *, key: str = "team.communication"
) -> CommunicationPolicy | None:
    """Return a communication policy; None where there is none, or it has problems, which are noted.

    Args:
        given: A name, a function ``module:name`` that returns a policy, or a table of a name and its settings.
        functions: Finds the function.
        problems: Where problems are noted.
        key: Where it stands in the file.
    """
    if given is None:
        return None
    if isinstance(given, str) and ":" in given:
        make = functions.find(given, key)
        with problems.collecting(key):
            return None if make is None else _made(make, given)
        return None
    written = {"policy": given} if isinstance(given, str) else given
    table: CommunicationTable | None = problems.convert(written, CommunicationTable, key)
    if table is not None:
        with problems.collecting(key):
            return _policy(table, functions, problems, key)
    return None


def _made(make: Callable[[], Any], name: str) -> CommunicationPolicy | None:
    try:
        return make()  # type: ignore[no-any-return]
    except Exception as error:
        raise ConfigError(f"{name!r} makes no communication policy: {type(error).__name__}: {error}") from None


def _policy(table: CommunicationTable, functions: Functions, problems: Problems, key: str) -> CommunicationPolicy:
    if table.policy not in _KINDS:
        hint = (
            similar(table.policy, _KINDS) or f"; there are {', '.join(_KINDS)}, and 'module:name' for one of your own"
        )
        raise ConfigError(f"there is no communication policy {table.policy!r}{hint}")
    kind, needed, taken = _KINDS[table.policy]
    settings = {name: value for name, value in msgspec.structs.asdict(table).items() if value is not None}
    del settings["policy"]
    for name in settings:
        if name not in {*needed, *taken}:
            raise ConfigError(f"{name!r} means nothing for the communication policy {table.policy!r}")
    for name in needed:
        if name not in settings:
            raise ConfigError(f"the communication policy {table.policy!r} needs {name!r}")
    if "of" in settings:
        settings["of"] = read_communication(settings["of"], functions, problems, key=f"{key}.of")
    policy: CommunicationPolicy = kind(**settings)
    return policy
