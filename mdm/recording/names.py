"""The names of an ensemble's states and observations, which a record keeps as a file within it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from mdm.errors import FormatError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.recording.reader import Record

__all__ = ["Factor", "Names", "attached", "names_of"]

_FOLDER = "names/"


class Factor(msgspec.Struct, frozen=True):
    """A factor of a joint state or observation: its name, and those of its symbols."""

    name: str
    symbols: tuple[str, ...]


class Names(msgspec.Struct, frozen=True):
    """The factors of an ensemble's joint states and observations; without names there are none."""

    states: tuple[Factor, ...] = ()
    observations: tuple[Factor, ...] = ()

    def state(self, index: int | None) -> str | None:
        """Return the name of a joint state, None where it has none."""
        return _name(self.states, index)

    def observation(self, given: int | Sequence[int | None] | None) -> str | None:
        """Return the name of a joint observation, or of its components, None where it has none."""
        return _name(self.observations, given)


def _name(factors: tuple[Factor, ...], given: int | Sequence[int | None] | None) -> str | None:
    if given is None or not factors:
        return None
    places = _places(factors, given) if isinstance(given, int) else list(given)
    if len(places) != len(factors):
        return None
    words = [
        (factor.name, factor.symbols[place])
        for factor, place in zip(factors, places, strict=True)
        if place is not None and place < len(factor.symbols)
    ]
    return words[0][1] if len(factors) == len(words) == 1 else ", ".join(f"{name}={word}" for name, word in words)


def _places(factors: tuple[Factor, ...], index: int) -> list[int | None]:
    """Return the place in each factor of a joint index, none if it is too large."""
    places: list[int | None] = []
    for factor in reversed(factors):
        index, place = divmod(index, len(factor.symbols))
        places.append(place)
    return [] if index else places[::-1]


def attached(ensemble: str, names: Names) -> tuple[str, str, bytes]:
    """Return what `RecordWriter.attach` takes for the names of an ensemble, which is told by its path."""
    return f"{_FOLDER}{ensemble}.json", "application/json", msgspec.json.encode(names)


def names_of(record: Record) -> dict[str, Names]:
    """Return the names of all ensembles of a record, by their paths.

    Raises:
        FormatError: If names are not as `attached` writes them.
    """
    found = {}
    for each in record.attachments:
        if each.name.startswith(_FOLDER) and each.name.endswith(".json"):
            try:
                names = msgspec.json.decode(each.data, type=Names)
            except msgspec.MsgspecError as error:
                raise FormatError(f"{each.name} has no names of an ensemble: {error}", file=record.path) from None
            if not all(factor.symbols for factor in names.states + names.observations):
                raise FormatError(f"{each.name} has a factor without symbols", file=record.path)
            found[each.name.removeprefix(_FOLDER).removesuffix(".json")] = names
    return found
