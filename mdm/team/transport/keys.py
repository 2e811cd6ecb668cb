"""Keys: the names under which the messages of a team are put, ``mdm/<team>/<agent>/<ensemble>/<channel>``.

The third chunk names the owner, who alone puts there. In an expression ``*`` stands for one chunk and ``**`` for any
number of them. Neither stands for a chunk that begins with ``@``: those are the team's own, such as ``@live``.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING

from mdm.errors import ConfigError, Error

if TYPE_CHECKING:
    from collections.abc import Sequence

ROOT = "mdm"

_FORBIDDEN = frozenset("/*$#?@")
_LONGEST_NAME = 64


def check_name(name: object, kind: str, *, key: str | None = None) -> str:
    """Return a name that can be part of a key: of a team, an agent, an ensemble or a channel.

    Args:
        name: The name that was given.
        kind: The kind of thing that it names, for the error.
        key: Where it was given.

    Raises:
        ConfigError: If it is no text, is empty, longer than 64 characters, or has one of ``/ * $ # ? @`` or a
            character that cannot be printed.
    """
    if not isinstance(name, str) or not 0 < len(name) <= _LONGEST_NAME:
        raise ConfigError(f"the name of {kind} is a text of 1 to {_LONGEST_NAME} characters, not {name!r}", key=key)
    wrong = next((c for c in name if c in _FORBIDDEN or not c.isprintable()), None)
    if wrong is not None:
        raise ConfigError(f"the name of {kind} has {wrong!r}, which means something else in keys: {name!r}", key=key)
    return name


def join(team: str, agent: str, *rest: str) -> str:
    """Return the key of an agent, or the expression with ``*`` in place of names.

    Example::

        join("rescue", "robot1", "patrol", "state")  # mdm/rescue/robot1/patrol/state
        join("rescue", "*", "patrol", "state")  # the same of every agent
    """
    return "/".join((ROOT, team, agent, *rest))


def team_of(key: str) -> str:
    """Return the name of the team under whose keys one is."""
    return key.partition("/")[2].partition("/")[0]


def owner_of(key: str, team: str) -> str | None:
    """Return the agent who alone puts under a key; None if it is no key of this team's agents."""
    chunks = key.split("/", 3)
    if len(chunks) < 4 or chunks[0] != ROOT or chunks[1] != team or not chunks[2]:
        return None
    return chunks[2]


def check_key(key: str) -> str:
    """Return a key.

    Raises:
        Error: If it is an expression, or malformed.
    """
    if not _well_formed(key) or "*" in key:
        raise Error(f"a key is names joined by '/', such as mdm/rescue/robot1/patrol/state, not {key!r}")
    return key


def check_expression(expression: str) -> str:
    """Return an expression of keys.

    Raises:
        Error: If it is malformed: a ``*`` stands for a whole chunk.
    """
    chunks = expression.split("/")
    if not _well_formed(expression) or any("*" in chunk and chunk not in {"*", "**"} for chunk in chunks):
        raise Error(
            f"an expression of keys is names joined by '/', where * stands for one name and ** for any number, "
            f"not {expression!r}"
        )
    if any(a == "**" and b in {"*", "**"} for a, b in pairwise(chunks)):
        raise Error(f"in {expression!r} write * before **, and ** once")
    return expression


def _well_formed(expression: str) -> bool:
    return bool(expression) and all(expression.split("/")) and not any(c in expression for c in "$#?")


@lru_cache(maxsize=4096)
def _chunks(expression: str) -> tuple[str, ...]:
    return tuple(expression.split("/"))


def matches(expression: str, key: str) -> bool:
    """Whether a key is one of those that an expression stands for."""
    return _includes(_chunks(expression), key.split("/"))


def includes(expression: str, other: str) -> bool:
    """Whether all keys of the other expression are keys of the first."""
    return _includes(_chunks(expression), other.split("/"))


def _includes(wide: Sequence[str], narrow: Sequence[str]) -> bool:
    # reached: the positions in `wide` at which the chunks of `narrow` so far may have led; `**` stands for none, too.
    reached = _past_any({0}, wide)
    for chunk in narrow:
        verbatim = chunk.startswith("@")
        following = set()
        for place in reached:
            if place == len(wide):
                continue
            pattern = wide[place]
            if pattern == "**":
                if not verbatim:
                    following.add(place)
            elif pattern == chunk or (pattern == "*" and chunk != "**" and not verbatim):
                following.add(place + 1)
        reached = _past_any(following, wide)
        if not reached:
            return False
    return len(wide) in reached


def _past_any(places: set[int], wide: Sequence[str]) -> set[int]:
    for place in tuple(places):
        following = place
        while following < len(wide) and wide[following] == "**":
            following += 1
            places.add(following)
    return places
