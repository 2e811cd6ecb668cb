"""Position: the place that a decision was made on, from the state or the belief that it was made on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mdm.actors.ensemble import Ensemble
    from mdm.maps.graph import Graph
    from mdm.messages import Action
    from mdm.models.matrices import Vector

__all__ = ["Position"]


class Position:
    """Tells in which place a robot was when an ensemble decided, as far as what it decided on says so.

    A factor is about places where each of its values is one: by the predicates of a place (``Hall``, ``Hall.reached``,
    ``Hall.at_goal``), or by its name as a symbol of the model.

    Args:
        ensemble: What decides.
        graph: The places.
        prefix: What predicates have before the names of places.
    """

    def __init__(self, ensemble: Ensemble, graph: Graph, prefix: str) -> None:
        self._ensemble = ensemble
        symbols = {prefix + name + end: name for name in graph.names for end in ("", ".reached", ".at_goal")}
        self._symbols = {**symbols, **{name: name for name in graph.names}}
        self._decided: tuple[tuple[str, ...], int] | None = None
        self._believed: tuple[tuple[str, ...], tuple[int, ...], int] | None = None
        self._is_found = False

    def of(self, action: Action) -> str | None:
        """Return the place that the state says which an action was decided on; None where there is none."""
        self._find()
        if action.state is None or self._decided is None:
            return None
        places, stride = self._decided
        return places[int(action.state) // stride % len(places)]

    def likely(self) -> tuple[str, ...]:
        """Return the places by what the ensemble believes now, the likeliest first, without those that are impossible.

        None where it tracks no belief, or its states have no place.
        """
        self._find()
        belief = None if self._believed is None else self._ensemble.controller.belief
        if belief is None or self._believed is None:
            return ()
        places, shape, axis = self._believed
        joint: Vector = np.asarray(belief).reshape(shape)
        weights = joint.sum(axis=tuple(other for other in range(len(shape)) if other != axis))
        return tuple(places[place] for place in np.argsort(-weights, kind="stable").tolist() if weights[place] > 0)

    def _find(self) -> None:
        """Find the factor that is about places, once all is built and a team has shared out its factors."""
        if self._is_found:
            return
        self._is_found = True
        layer, model = self._ensemble.state, self._ensemble.controller.model
        if layer is not None:
            sizes = [factor.size for factor in layer.factors]
            for place, factor in enumerate(layer.factors):
                if factor in layer.own and (places := self._places(factor.predicates)) is not None:
                    self._decided = places, int(np.prod(sizes[place + 1 :], dtype=np.int64))
                    break
        if model is None:
            return
        factors = model.state_space.factors
        shape = tuple(len(factor) for factor in factors)
        found = [
            (places, place)
            for place, factor in enumerate(factors)
            if len(factor) <= len(self._symbols) and (places := self._places(factor.names)) is not None
        ]
        if len(found) == 1:  # those of several robots are of the same places
            (places, place), *_ = found
            self._believed = places, shape, place
            if self._decided is None and layer is None:
                self._decided = places, int(np.prod(shape[place + 1 :], dtype=np.int64))

    def _places(self, symbols: Sequence[str] | Iterable[str]) -> tuple[str, ...] | None:
        places = [self._symbols.get(symbol) for symbol in symbols]
        known = tuple(place for place in places if place is not None)
        return known if len(known) == len(places) > 1 else None
