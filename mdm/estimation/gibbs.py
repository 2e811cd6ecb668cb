"""Gibbs sampling: intervals of T and O where states are hidden.

In turn the states of all chains are drawn, given T and O, and T and O, given the states (S. L. Scott, *Bayesian methods
for hidden Markov models*, Journal of the American Statistical Association 97, 2002). States are drawn by a filter
forwards and samples backwards (C. K. Carter and R. Kohn, *On Gibbs sampling for state space models*, Biometrika 81,
1994), rows from Dirichlet distributions with Jeffreys' prior on the entries that the model has. Several samplers go
side by side as arrays, each from the estimate of `mdm.estimation.hidden`: names of states are not swapped.

A row is tested by the draws of it, in which all other rows vary: held as in a wrong model, they make a wrong row look
right. The likelihood of the best others would not do: it may have the states by each other's names.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import numpy as np
import numpy.typing as npt

from mdm.estimation.hidden import Matrices, moves
from mdm.estimation.intervals import LEVEL, PRIOR

if TYPE_CHECKING:
    from mdm.estimation.hidden import Evidence, Fit
    from mdm.models.matrices import Vector
    from mdm.models.pomdp import POMDP

__all__ = ["Intervals", "sample"]

_SAMPLERS = 32
_SWEEPS = 30
_BURNT = 8
"""The sweeps of each sampler that are not used: it begins at the estimate, where it would end anyhow."""
_TOGETHER = 16_000_000
"""The numbers that all samplers may hold."""


class Intervals(msgspec.Struct, frozen=True):
    """The intervals of T and O.

    Attributes:
        transitions: The lower and the upper ends, 2 x A x S x S'.
        observations: The same of O, 2 x A x S' x O; those of events are the model's probabilities.
        p_values: Of the hypotheses that a row of T, and of O, is as in the model, whatever the others are: A x S each.
    """

    transitions: npt.NDArray[np.float64]
    observations: npt.NDArray[np.float64]
    p_values: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]


def sample(
    model: POMDP, evidence: Evidence, fit: Fit, *, seed: int = 0, sweeps: int = _SWEEPS, level: float = LEVEL
) -> Intervals:
    """Return the intervals of T and O.

    Args:
        model: Has what is possible.
        evidence: See `mdm.estimation.hidden.evidence_of`.
        fit: Where the samplers begin.
        seed: The same seed gives the same intervals.
        sweeps: How often each of up to 32 samplers draws the states of all chains.
        level: The probability of the intervals.
    """
    random = np.random.default_rng(seed)
    old = Matrices.of(model)
    possible = old.transitions > 0, old.observations > 0
    events = old.observations.ndim > 3
    size = old.transitions.size * max(len(evidence.masks), 1) + evidence.steps * len(model.state_space)
    count = max(2, min(_SAMPLERS, _TOGETHER // size))
    current = Matrices(
        np.repeat(fit.transitions[None], count, axis=0), np.repeat(fit.observations[None], count, axis=0)
    )
    kept: list[Matrices] = []
    for sweep in range(_BURNT + sweeps):
        joint = moves(current, evidence.masks)
        transitions, observations = _counts(evidence, joint, current, random)
        current = Matrices(
            _draw(transitions, possible[0], random),
            current.observations if events else _draw(observations, possible[1], random),
        )
        if sweep >= _BURNT:
            kept.append(current)
    ends = [(1 - level) / 2, (1 + level) / 2]
    parts = [np.concatenate([each[place] for each in kept]) for place in (0, 1)]
    transitions, observations = (np.quantile(part, ends, axis=0) for part in parts)
    first, second = (_p_values(*each) for each in zip(parts, old, possible, strict=True))
    return Intervals(transitions, observations, (first, second))


def _p_values(draws: Vector, model: Vector, possible: npt.NDArray[np.bool_]) -> Vector:
    """Return the p-values of rows: the least of their entries' two tails, times their number but one.

    Beyond all draws a tail is that of the normal distribution of the arcs whose sines are the roots of the draws.
    """
    from scipy.special import erfc  # noqa: PLC0415 - slow to import

    below, count = (draws < model).sum(axis=0), len(draws)
    tails = 2 * (np.minimum(below, count - below) + 1) / (count + 1)
    arcs, arc = np.arcsin(np.sqrt(np.clip(draws, 0, 1))), np.arcsin(np.sqrt(np.clip(model, 0, 1)))
    spread = np.maximum(arcs.std(axis=0), 1e-12)
    beyond = np.minimum(tails, erfc(np.abs(arc - arcs.mean(axis=0)) / spread / np.sqrt(2)))
    tails = np.where((below == 0) | (below == count), beyond, tails)
    least = np.where(possible, tails, 1.0).min(axis=-1)
    result: Vector = np.minimum(least * np.maximum(possible.sum(axis=-1) - 1, 1), 1.0)
    return result


def _draw(counts: Vector, possible: npt.NDArray[np.bool_], random: np.random.Generator) -> Vector:
    """Return rows drawn from their posterior, Dirichlet(counts + 1/2) on what is possible."""
    drawn = np.where(possible, random.standard_gamma(np.where(possible, counts + PRIOR, 1.0)), 0.0)
    sums = drawn.sum(axis=-1, keepdims=True)
    result: Vector = np.divide(drawn, sums, out=np.zeros_like(drawn), where=sums > 0)
    return result


def _counts(evidence: Evidence, joint: Vector, current: Matrices, random: np.random.Generator) -> tuple[Vector, Vector]:
    """Draw the states of all chains for each sampler, and count: C x A x S x S', and C x A x S' x O."""
    samplers, actions, symbols, states, _ = joint.shape
    kinds, places = evidence.kinds, evidence.places
    forth = np.ascontiguousarray(np.moveaxis(joint, 0, 2)).reshape(actions * symbols, samplers, states, states)
    back = np.ascontiguousarray(np.swapaxes(forth, 2, 3))
    beliefs = np.empty((evidence.steps, samplers, states))
    belief = np.repeat(evidence.first[:, None], samplers, axis=1)
    last = belief.copy()
    for place in places:
        count = place.stop - place.start
        beliefs[place] = belief[:count]
        after = np.matmul(belief[:count, :, None], forth[kinds[place]])[:, :, 0]
        belief = last[:count] = after / after.sum(axis=-1, keepdims=True)
    every = np.arange(samplers)
    path = np.empty((2, evidence.steps, samplers), dtype=np.intp)  # before, and after each step
    state = _chosen(last, random)
    for place in reversed(places):
        count = place.stop - place.start
        path[1, place] = state[:count]
        weights = beliefs[place] * back[kinds[place, None], every, state[:count]]
        path[0, place] = state[:count] = _chosen(weights, random)
    who = np.broadcast_to(every, path.shape[1:]).ravel()
    acted, seen = np.repeat(evidence.actions, samplers), np.repeat(evidence.symbols, samplers)
    before, after_ = path.reshape(2, -1)
    transitions = _bins((samplers, actions, states, states), who, acted, before, after_)
    if current.observations.ndim > 4:
        return transitions, np.zeros(0)
    told, which = _complete(evidence, current, who, acted, after_, seen, random)
    shape = (samplers, actions, states, current.observations.shape[-1])
    return transitions, _bins(shape, who[which], acted[which], after_[which], told)


def _chosen(weights: Vector, random: np.random.Generator) -> npt.NDArray[np.intp]:
    """Draw a place by weights, along the last axis."""
    levels = weights.cumsum(axis=-1)
    numbers = random.random((*levels.shape[:-1], 1))
    # A number of 0 to 1, times the sum, is below the last level but for rounding.
    drawn: npt.NDArray[np.intp] = (levels[..., :-1] <= numbers * levels[..., -1:]).sum(axis=-1)
    return drawn


def _bins(shape: tuple[int, ...], *places: npt.NDArray[np.intp]) -> Vector:
    flat = np.ravel_multi_index(places, shape)
    return np.bincount(flat, minlength=int(np.prod(shape))).reshape(shape).astype(np.float64)


def _complete(
    evidence: Evidence,
    current: Matrices,
    who: npt.NDArray[np.intp],
    acted: npt.NDArray[np.intp],
    state: npt.NDArray[np.intp],
    seen: npt.NDArray[np.intp],
    random: np.random.Generator,
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.bool_]]:
    """Return what was observed, drawn where components are missing, and for which steps anything was."""
    widths = evidence.masks.sum(axis=1)
    which = (widths[seen] < evidence.masks.shape[1]) | (widths[seen] == 1)
    symbols = evidence.masks.argmax(axis=1)[seen[which]]
    partly = widths[seen[which]] > 1
    if partly.any():
        at = np.flatnonzero(which)[partly]
        weights = current.observations[who[at], acted[at], state[at]] * evidence.masks[seen[at]]
        symbols[partly] = _chosen(weights, random)
    return symbols, which
