"""The belief over places: from the particles of a filter to the belief of an ensemble."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ConfigError, Error
from mdm.maps.map import Floors, Map
from mdm.messages import Belief, ParticleUpdate
from mdm.runtime import Actor

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.actors import Ensemble
    from mdm.maps.raster import Labels
    from mdm.models.matrices import Vector
    from mdm.runtime import Supervision

_QUIET = round(10e9)


class PlaceBelief(Actor):
    """Gives an ensemble its belief over places, from particles on `see`, or on the channel ``place_belief/particles``.

    The belief goes to the ensemble's ``external_belief``: of an event-driven one each set of particles makes a
    decision. The probability of a place is the share of the particles that lie in it; those that lie in none count for
    nothing. Where the model has other factors than the place, they keep their own belief, that of the ensemble at this
    time, as though they were independent of the place.

    Args:
        floor: The map, or its labels alone.
        ensemble: Whose policy is over beliefs, and whose model names its states.
        factor: The factor of the model's states whose symbols are the names of the places; where there is but one, it
            is that one.
        name: Its name among actors.
        supervision: The meaning of its failure.

    Raises:
        ConfigError: If the ensemble takes no beliefs, or the factor is none of its model's or has other symbols.

    Attributes:
        unplaced: The share of the last particles that lay in no place.
    """

    def __init__(
        self,
        floor: Map | Labels,
        ensemble: Ensemble,
        factor: str = "position",
        *,
        name: str = "place_belief",
        supervision: Supervision = "escalate",
    ) -> None:
        super().__init__(name, supervision=supervision)
        if isinstance(floor, Floors):
            raise ConfigError("a PlaceBelief takes one floor: particles do not say on which floor they are")
        labels = floor.labels if isinstance(floor, Map) else floor
        model = ensemble.controller.model
        if ensemble.controller.takes == "state" or model is None:
            raise ConfigError(
                f"ensemble {ensemble.name!r} takes no beliefs: its policy is over states, or has no model"
            )
        space = model.state_space
        factors = [each.name for each in space.factors]
        if len(factors) == 1:
            self._axis = 0
        elif factor in factors:
            self._axis = factors.index(factor)
        else:
            raise ConfigError(f"the model has no factor {factor!r}; its factors are {', '.join(factors)}", key="factor")
        symbols = tuple(space.factors[self._axis].names)
        for some, others, where in ((labels.names, symbols, "the model"), (symbols, labels.names, "the map")):
            missing = [each for each in some if each not in others]
            if missing:
                raise ConfigError(
                    f"{', '.join(map(repr, missing))}: no place of {where}, which has {', '.join(others)}"
                )
        self.ensemble = ensemble
        self.unplaced = 0.0
        self._shape = space.shape
        self._labels = labels
        # For each cell, from the lowest row up, the place's index in the factor from 1, and 0 for none.
        order = np.array([0, *(symbols.index(each) + 1 for each in labels.names)], dtype=np.intp)
        self._raster = order[labels.raster[::-1]].ravel()
        self._told = -(1 << 62)

    def see(self, x: npt.ArrayLike, y: npt.ArrayLike, weights: npt.ArrayLike | None = None) -> None:
        """Take the particles of a filter: any number of them, in metres in the frame of the map. From any thread.

        Args:
            x: Of each particle.
            y: The same.
            weights: Of each particle, in any unit; without, all count the same.

        Raises:
            Error: If this has not started, they are no numbers, or there are not as many of each.
        """
        try:
            along, up = np.array(x, dtype=np.float64), np.array(y, dtype=np.float64)
            heavy = None if weights is None else np.array(weights, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            raise Error("particles are arrays of numbers: x, y, and weights where they differ") from None
        counts = {array.shape for array in (along, up, heavy) if array is not None}
        if len(counts) > 1 or along.ndim != 1:
            raise Error(f"particles are arrays of the same length, not of the shapes {sorted(counts)}")
        update = ParticleUpdate(self.runtime.clock.now(), along, up, heavy)
        self.channel("particles", ParticleUpdate).publish(update)

    def on_start(self) -> None:
        """Listen."""
        self._told = -(1 << 62)
        particles = self.channel("particles", ParticleUpdate)
        particles.input = True
        particles.supersedes = lambda _: "particles"
        self.subscribe(particles, self._on_particles)

    def _on_particles(self, particles: ParticleUpdate) -> None:
        places = self._places(particles)
        if places is None:
            now = self.runtime.now()
            if now - self._told >= _QUIET:
                self.report(
                    "particles",
                    "particles tell no belief: none that weighs anything lies in a place, or a weight is negative, "
                    "infinite or no number",
                )
            self._told = now
            return
        belief = places
        if len(self._shape) > 1:
            present = self.ensemble.controller.belief
            if present is None:
                raise Error(f"ensemble {self.ensemble.name!r} tracks no belief that particles could tell a part of")
            others = present.reshape(self._shape).sum(axis=self._axis, keepdims=True)
            along = [1] * len(self._shape)
            along[self._axis] = -1
            belief = (others * places.reshape(along)).ravel()
        self.ensemble.channel("external_belief", Belief).derive(Belief(particles.time, belief))

    @np.errstate(over="ignore", invalid="ignore")  # what is too far or too heavy becomes infinite, and is left out
    def _places(self, particles: ParticleUpdate) -> Vector | None:
        """Return the probability of each place, in the order of the factor; None where nothing tells it.

        Hot path: 40 µs for 2,000 particles.
        """
        frame, x, y, weights = self._labels.frame, particles.x, particles.y, particles.weights
        every = float(len(x))
        if weights is not None:
            every = float(weights.sum())
            if not (np.isfinite(every) and (weights >= 0).all()):
                return None  # weights that are none tell nothing
        cosine, sine = frame.turn
        x, y = x - frame.x, y - frame.y
        if sine or cosine != 1.0:
            x, y = cosine * x + sine * y, cosine * y - sine * x
        x /= frame.resolution
        y /= frame.resolution
        inside = (x >= 0) & (x < frame.columns) & (y >= 0) & (y < frame.rows)
        if not inside.all():
            x, y = x[inside], y[inside]
            weights = None if weights is None else weights[inside]
        found = self._raster[y.astype(np.intp) * frame.columns + x.astype(np.intp)]
        sums = np.bincount(found, weights, minlength=self._shape[self._axis] + 1)
        placed = sums[1:].sum()
        if not placed > 0:
            self.unplaced = 1.0
            return None
        self.unplaced = float(1 - placed / every)
        probabilities: Vector = sums[1:] / placed
        return probabilities
