"""Naming: the words for the states and observations on which an ensemble decides."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.actors.abstraction.factors import ObservationFactor, StateFactor
    from mdm.models.space import Space
    from mdm.symbols import Symbols

    Given = int | tuple[int | None, ...] | None


class Naming:
    """Names states and observations as the model does, else as the factors that they are made of.

    Args:
        symbols: Those of the controller.
        states: The factors of the state; none where it is not made of factors.
        observations: The factors of the observation.
    """

    def __init__(
        self, symbols: Symbols, states: Sequence[StateFactor] = (), observations: Sequence[ObservationFactor] = ()
    ) -> None:
        self._symbols = symbols
        self._states = states
        self._observations = observations

    def words(self, state: int | None, observation: Given) -> dict[str, object]:
        """Return the names by ``state`` and ``observation``, as far as known; an index without a name is itself."""
        named = _name(self._symbols.state_space, state)
        if isinstance(named, int) and self._states:
            named = _wired(self._states, named)
        given = {"state": named, "observation": self._observed(observation)}
        return {key: word for key, word in given.items() if word is not None}

    def _observed(self, given: Given) -> object:
        """Return the name of an observation; the events of one by components that the model does not tell apart."""
        space = self._symbols.observation_space
        if isinstance(given, tuple) and self._observations and space is not None and len(given) != len(space.factors):
            parts = zip(self._observations, given, strict=True)
            return ", ".join(f"{factor.name}={factor.events[place]}" for factor, place in parts if place is not None)
        return _name(space, given)


def _name(space: Space | None, given: Given) -> object:
    """Return the name of a symbol; of several factors the value of each that is known."""
    if given is None or space is None:
        return given
    places = space.unravel(given) if isinstance(given, int) else given
    if len(places) == 1:
        return None if places[0] is None else space.factors[0].names[places[0]]
    parts = zip(space.factors, places, strict=True)
    return ", ".join(f"{factor.name}={factor.names[place]}" for factor, place in parts if place is not None)


def _wired(factors: Sequence[StateFactor], state: int) -> str:
    """Return the name of each component of a state, the last factor the least significant."""
    words: list[str] = []
    for factor in reversed(factors):
        state, value = divmod(state, factor.size)
        words.append(str(factor.wires()[value].source))
    return ", ".join(reversed(words))
