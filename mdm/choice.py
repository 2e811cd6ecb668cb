"""Choices that users make: among a few words, yes or no, and the seed of chance."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.errors import ConfigError
from mdm.number import is_whole

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["check_choice", "check_flag", "check_seed"]


def check_choice(given: object, choices: Sequence[str], what: str, *, key: str | None = None) -> None:
    """Refuse what is none of several words.

    Raises:
        ConfigError: If it is none of them.
    """
    if not isinstance(given, str) or given not in choices:
        *most, last = map(repr, choices)
        raise ConfigError(f"{what} is {', '.join(most)} or {last}, not {given!r}", key=key)


def check_flag(given: object, what: str, *, key: str | None = None) -> None:
    """Refuse what is neither True nor False.

    Raises:
        ConfigError: If it is something else, such as the text ``"no"``, which would count as True.
    """
    if not isinstance(given, bool):
        raise ConfigError(f"{what} is True or False, not {given!r}", key=key)


def check_seed(given: object) -> None:
    """Refuse what is no seed of random numbers: neither a whole number from 0 on, nor None.

    Raises:
        ConfigError: If it is something else.
    """
    if given is not None and not (is_whole(given) and given >= 0):
        raise ConfigError(f"a seed is a whole number from 0 on, not {given!r}", key="seed")
