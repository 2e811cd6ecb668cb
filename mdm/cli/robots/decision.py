"""The input and output of a decision, in the words of the model or of the wiring."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from mdm.actors import Ensemble, StateFactor
    from mdm.messages import Decision
    from mdm.models import Space

__all__ = ["in_words"]


def in_words(ensembles: Iterable[Ensemble]) -> Callable[[Decision], Mapping[str, object]]:
    """Return a function that says of which state or observation a decision of these ensembles is.

    A state or an observation without a name is told by its index, and so are those of other ensembles, which a task of
    the file has started.
    """
    by_name = {ensemble.name: ensemble for ensemble in ensembles}

    def words(decision: Decision) -> dict[str, object]:
        ensemble = by_name.get(decision.ensemble.rpartition("/")[2])
        if ensemble is None:
            return _known(decision.state, decision.observation)
        symbols = ensemble.controller.symbols
        state = _name(symbols.state_space, decision.state)
        if isinstance(state, int) and ensemble.state is not None:
            state = _wired(ensemble.state.factors, state)
        return _known(state, _observed(ensemble, decision.observation))

    return words


def _known(state: object, observation: object) -> dict[str, object]:
    given = {"state": state, "observation": observation}
    return {name: word for name, word in given.items() if word is not None}


def _observed(ensemble: Ensemble, given: int | tuple[int | None, ...] | None) -> object:
    """Return the name of an observation; the events of one by components that the model does not tell apart."""
    space, layer = ensemble.controller.symbols.observation_space, ensemble.observation
    if isinstance(given, tuple) and layer is not None and space is not None and len(given) != len(space.factors):
        parts = zip(layer.factors, given, strict=True)
        return ", ".join(f"{factor.name}={factor.events[place]}" for factor, place in parts if place is not None)
    return _name(space, given)


def _name(space: Space | None, given: int | tuple[int | None, ...] | None) -> object:
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
