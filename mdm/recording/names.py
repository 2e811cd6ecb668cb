"""The names of an ensemble's joint states, observations and actions, which a recorder keeps in a record's metadata."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_type_hints

import msgspec

from mdm.errors import FormatError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.recording.reader import Record

__all__ = ["Names", "names_of"]

_ENSEMBLE = "ensemble "
"""What the names of metadata begin with that are about an ensemble; its path follows."""


class Names(msgspec.Struct, frozen=True):
    """The names of joint states, observations and actions, by their indices; none where they are not kept.

    Joint states and observations of several factors have a value of each, by its name.
    """

    states: tuple[str, ...] = ()
    observations: tuple[str, ...] = ()
    actions: tuple[str, ...] = ()
    state_factors: dict[str, tuple[str, ...]] = {}
    observation_factors: dict[str, tuple[str, ...]] = {}

    def state(self, index: int | None) -> str | None:
        """Return the name of a joint state, None where it has none."""
        return _name(self.states, self.state_factors, index)

    def observation(self, given: int | Sequence[int | None] | None) -> str | None:
        """Return the name of a joint observation, or of those of its components that are known; None if it has none."""
        return _name(self.observations, self.observation_factors, given)


def _name(
    names: tuple[str, ...], factors: dict[str, tuple[str, ...]], given: int | Sequence[int | None] | None
) -> str | None:
    if given is None or not factors:
        return names[given] if isinstance(given, int) and 0 <= given < len(names) else None
    places = _places(factors, given) if isinstance(given, int) else list(given)
    if len(places) != len(factors):
        return None
    known = [(factor, place) for factor, place in zip(factors, places, strict=True) if place is not None]
    if not all(0 <= place < len(factors[factor]) for factor, place in known):
        return None
    return ", ".join(f"{factor}={factors[factor][place]}" for factor, place in known) or None


def _places(factors: dict[str, tuple[str, ...]], index: int) -> list[int | None]:
    """Return the place in each factor of a joint index, the last one the least significant; none if it is too large."""
    places: list[int | None] = []
    for symbols in reversed(factors.values()):
        index, place = divmod(index, max(1, len(symbols)))
        places.append(place)
    return [] if index else places[::-1]


_DECODERS: dict[str, msgspec.json.Decoder[Any]] = {
    name: msgspec.json.Decoder(kind) for name, kind in get_type_hints(Names).items()
}


def names_of(record: Record) -> dict[str, Names]:
    """Return the names of all ensembles of a record, by their paths.

    Raises:
        FormatError: If they are not lists of names, by factors or not.
    """
    found = {}
    for metadata, facts in record.metadata.items():
        if metadata.startswith(_ENSEMBLE):
            try:
                kept = {key: decoder.decode(facts[key]) for key, decoder in _DECODERS.items() if key in facts}
            except msgspec.MsgspecError as error:
                raise FormatError(f"the names of {metadata} are no list of names: {error}", file=record.path) from None
            found[metadata.removeprefix(_ENSEMBLE)] = Names(**kept)
    return found
