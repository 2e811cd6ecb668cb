"""The names of an ensemble's joint states, observations and actions, which a recorder keeps in a record's metadata."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from mdm.errors import FormatError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.recording.reader import Record

__all__ = ["Names", "names_of"]

_ENSEMBLE = "ensemble "
"""What the names of metadata begin with that are about an ensemble; its path follows."""


class Names(msgspec.Struct, frozen=True):
    """The names of joint states, observations and actions, by their indices; none where they are not kept."""

    states: tuple[str, ...] = ()
    observations: tuple[str, ...] = ()
    actions: tuple[str, ...] = ()

    def state(self, index: int | None) -> str | None:
        """Return the name of a joint state, None where it has none."""
        return _name(self.states, index)

    def observation(self, given: int | Sequence[int | None] | None) -> str | None:
        """Return the name of a joint observation, None where it has none or some of its components are missing."""
        return _name(self.observations, given if isinstance(given, int) else None)


def _name(names: tuple[str, ...], index: int | None) -> str | None:
    return names[index] if index is not None and 0 <= index < len(names) else None


def names_of(record: Record) -> dict[str, Names]:
    """Return the names of all ensembles of a record, by their paths.

    Raises:
        FormatError: If they are not lists of names.
    """
    found = {}
    for metadata, facts in record.metadata.items():
        if metadata.startswith(_ENSEMBLE):
            try:
                lists = {
                    key: msgspec.json.decode(facts.get(key, "[]"), type=tuple[str, ...])
                    for key in Names.__struct_fields__
                }
            except msgspec.MsgspecError as error:
                raise FormatError(f"the names of {metadata} are no list of names: {error}", file=record.path) from None
            found[metadata.removeprefix(_ENSEMBLE)] = Names(**lists)
    return found
