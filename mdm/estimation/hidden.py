"""Hidden states: what a POMDP's T and O are, from actions and observations alone.

Expectation maximisation (L. E. Baum et al., 1970; L. R. Rabiner, *A tutorial on hidden Markov models*, Proceedings of
the IEEE 77, 1989, section III.C), in which an action chooses the matrices of each step. It climbs from **the model in
use**: from random beginnings it ends in other maxima, or with the names of the states swapped. A row of the model
counts as one visit (`mdm.estimation.reestimation`), so that rows of which nothing is known stay as they are. A round
costs a multiplication of an S x S matrix for each step.

Expected counts are no counts: intervals that take them as seen cover four fifths of what they should.
`mdm.estimation.gibbs` has intervals, and tests of each row; `joint_odds` tests all of T and O together.

Where the model cannot tell two states apart, no round does either, and which of them is which is not in the record:
`alike` names them. The test then climbs also from a model whose rows are tilted a little.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.estimation.reestimation import WEIGHT
from mdm.models.dynamics import dense

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mdm.estimation.chains import Chain
    from mdm.models.matrices import Vector
    from mdm.models.pomdp import POMDP

__all__ = [
    "Evidence",
    "Fit",
    "Frequencies",
    "Matrices",
    "alike",
    "evidence_of",
    "expected",
    "fit",
    "frequencies",
    "joint_odds",
    "moves",
    "passes",
]

_LARGEST = 8_000_000
"""The most numbers in the matrices of all actions and observed symbols."""
_MOST = 50_000_000
"""The most numbers in the beliefs before all steps."""
_GAIN = 1e-3
"""The gain of log likelihood below which there is no further round."""
_ROUNDS = 100
_PARTS = 8
"""The parts of a record of which each is predicted by what was estimated from those before."""
_ALIKE = 0.01
"""The share of what there is to know of which of two states it was, below which they are not told apart."""

Observed = int | tuple[int | None, ...] | None


class Matrices(NamedTuple):
    """The probabilities of a model as arrays.

    Attributes:
        transitions: P(s' | s, a): A x S x S'.
        observations: P(o | a, s'): A x S' x O; of events P(o | s, a, s'): A x S x S' x O.
    """

    transitions: Vector
    observations: Vector

    @classmethod
    def of(cls, model: POMDP) -> Matrices:
        """Return those of a model.

        Raises:
            ModelError: If it is too large to be laid out.
        """
        states, actions, symbols = len(model.state_space), len(model.action_space), len(model.observation_space)
        size = actions * states**2 * (symbols if model.event_observations else 1)
        if size > _LARGEST:
            raise ModelError(
                f"a model of {states} states and {actions} actions is too large to estimate where states are hidden"
            )
        flat = model.flatten()
        transitions = np.stack([dense(flat.transition_matrix(action)) for action in range(actions)])
        if not flat.event_observations:
            return cls(transitions, np.stack([dense(flat.observation_matrix(action)) for action in range(actions)]))
        events = [[dense(flat.event_matrix(a, o)) for o in range(symbols)] for a in range(actions)]
        told = np.moveaxis(np.array(events), 1, -1)
        return cls(transitions, np.where(transitions[..., None] > 0, told, 0.0))


class Evidence(msgspec.Struct, frozen=True):
    """N chains of actions and observations as arrays, the longest first: M steps in all, at most L in a chain.

    Steps lie in the order of their place in the chain: the first ones of all chains, then the second ones, and so on.

    Attributes:
        first: The belief before the first action of each chain, N x S.
        starts: Where the steps of each place in the chain begin, and the end of the last: L + 1.
        actions: The action of each step, M.
        symbols: What was observed after it, as places in ``masks``, M.
        masks: For each symbol that was observed the observations that it may be, K x O: one, or several where
            components are missing, or all.
        impossible: Actions and observations of probability 0, with their count; chains are cut there.
    """

    first: npt.NDArray[np.float64]
    starts: npt.NDArray[np.intp]
    actions: npt.NDArray[np.intp]
    symbols: npt.NDArray[np.intp]
    masks: npt.NDArray[np.bool_]
    impossible: tuple[tuple[int, Observed, int], ...] = ()

    @property
    def steps(self) -> int:
        """The number of steps of all chains."""
        return len(self.actions)

    @property
    def places(self) -> list[slice]:
        """The steps of each place in the chain, L slices; those of place t are of the first chains."""
        return [slice(*pair) for pair in pairwise(self.starts.tolist())]

    @property
    def kinds(self) -> npt.NDArray[np.intp]:
        """The place of each step's action and symbol among all pairs of them, M."""
        return self.actions * len(self.masks) + self.symbols


class Fit(msgspec.Struct, frozen=True):
    """The result of expectation maximisation.

    Attributes:
        transitions: P(s' | s, a) as estimated: A x S x S'.
        observations: P(o | a, s') as estimated, A x S' x O; those of events are the model's.
        transition_counts: How often each transition is expected to have happened: A x S x S'.
        observation_counts: How often each observation is expected in each state: A x S' x O; zeros of events.
        log_likelihood: Of the estimate.
        before: Of the model in use.
        rounds: The number of rounds.
    """

    transitions: npt.NDArray[np.float64]
    observations: npt.NDArray[np.float64]
    transition_counts: npt.NDArray[np.float64]
    observation_counts: npt.NDArray[np.float64]
    log_likelihood: float
    before: float
    rounds: int


# -- Evidence --------------------------------------------------------------------------------------------------------


def evidence_of(model: POMDP, chains: Iterable[Chain]) -> Evidence:
    """Return the evidence of chains of decisions on observations.

    A chain begins with the belief of its first decision, or with the initial belief where there is none. Where
    something was observed that has no probability, the chain is cut, and begins anew with the belief that was decided
    on then.

    Raises:
        ModelError: If the model may go on without a detection (`POMDP.waits`): the number of steps is not known then.
    """
    if model.waits:
        raise ModelError(
            "steps without a detection are not in a record: at a fixed rate, or with a model without false negatives, "
            "each step is known"
        )
    return _arrays(model, _Cutter(model).parts(chains))


class _Part(NamedTuple):
    first: Vector
    actions: list[int]
    symbols: list[Observed]


class _Cutter:
    """Cuts chains where an observation is impossible, by a filter of its own."""

    def __init__(self, model: POMDP) -> None:
        self._model = model
        self._matrices = Matrices.of(model)
        self._masks: dict[Observed, npt.NDArray[np.bool_]] = {}
        self._moves: dict[tuple[int, Observed], Vector] = {}
        self.impossible: dict[tuple[int, Observed], int] = {}

    def parts(self, chains: Iterable[Chain]) -> tuple[list[_Part], dict[tuple[int, Observed], int]]:
        """Return the parts, and what was impossible."""
        parts = [part for chain in chains for part in self._cut(chain)]
        return [part for part in parts if part.actions], self.impossible

    def _cut(self, chain: Chain) -> Iterable[_Part]:
        before = chain.decisions[0]
        part = _Part(self._belief(before.belief), [], [])
        belief = part.first
        for decision in chain.decisions[1:]:
            key = before.action, decision.observation
            after = belief @ self._move(*key)
            total = float(after.sum())
            if total <= 0:
                self.impossible[key] = self.impossible.get(key, 0) + 1
                yield part
                part = _Part(self._belief(decision.belief), [], [])
                belief = part.first
            else:
                part.actions.append(key[0])
                part.symbols.append(key[1])
                belief = after / total
            before = decision
        yield part

    def _belief(self, belief: Vector | None) -> Vector:
        return np.asarray(self._model.initial_belief if belief is None else belief, dtype=np.float64)

    def _move(self, action: int, symbol: Observed) -> Vector:
        key = action, symbol
        if key not in self._moves:
            mask = _mask(self._model, symbol)
            observations = self._matrices.observations[action]
            self._moves[key] = self._matrices.transitions[action] * _seen(observations, mask[None])[..., 0]
        return self._moves[key]


def _mask(model: POMDP, symbol: Observed) -> npt.NDArray[np.bool_]:
    """Return which observations a symbol may be."""
    space = model.observation_space
    result = np.zeros(space.shape, dtype=bool)
    if symbol is None:
        result[...] = True
    elif isinstance(symbol, tuple):
        result[tuple(slice(None) if component is None else component for component in symbol)] = True
    else:
        result.ravel()[symbol] = True
    return result.ravel()


def _seen(observations: Vector, masks: npt.NDArray[np.bool_]) -> Vector:
    """Return the probability of each observed symbol: ... x K; of nothing 1, for it may be what events leave open."""
    told: Vector = observations @ masks.T.astype(np.float64)
    told[..., masks.all(axis=1) & (masks.shape[1] > 1)] = 1.0
    return told


def _arrays(model: POMDP, found: tuple[list[_Part], dict[tuple[int, Observed], int]]) -> Evidence:
    parts, impossible = found
    parts.sort(key=lambda part: -len(part.actions))
    longest = len(parts[0].actions) if parts else 0
    places: dict[Observed, int] = {}
    actions: list[int] = []
    symbols: list[int] = []
    starts, going = [0], len(parts)
    for step in range(longest):
        while len(parts[going - 1].actions) <= step:
            going -= 1
        actions += [part.actions[step] for part in parts[:going]]
        symbols += [places.setdefault(part.symbols[step], len(places)) for part in parts[:going]]
        starts.append(len(actions))
    states, count = len(model.state_space), len(model.observation_space)
    return Evidence(
        np.array([part.first for part in parts]).reshape(len(parts), states),
        np.array(starts, dtype=np.intp),
        np.array(actions, dtype=np.intp),
        np.array(symbols, dtype=np.intp),
        np.array([_mask(model, symbol) for symbol in places]).reshape(len(places), count),
        tuple((action, symbol, times) for (action, symbol), times in impossible.items()),
    )


# -- Expectation -----------------------------------------------------------------------------------------------------


def moves(matrices: Matrices, masks: npt.NDArray[np.bool_]) -> Vector:
    """Return P(s', what was observed | s, a) for each observed symbol: ... x A x K x S x S'."""
    told = _seen(matrices.observations, masks)
    if matrices.observations.ndim > matrices.transitions.ndim:  # of events
        return np.ascontiguousarray(matrices.transitions[..., None, :, :] * np.moveaxis(told, -1, -3))
    return matrices.transitions[..., None, :, :] * np.swapaxes(told, -1, -2)[..., None, :]


def passes(evidence: Evidence, joint: Vector) -> tuple[Vector, float]:
    """Return the belief before each step, M x S, and the log likelihood of all steps."""
    flat, kinds = joint.reshape(-1, *joint.shape[-2:]), evidence.kinds
    before = np.empty((evidence.steps, joint.shape[-1]))
    sums = np.empty((evidence.steps, 1))
    belief = evidence.first
    for place in evidence.places:
        belief = before[place] = belief[: place.stop - place.start]
        after = np.matmul(belief[:, None], flat[kinds[place]])[:, 0]
        total = sums[place] = after.sum(axis=1, keepdims=True)
        belief = after / total
    return before, float(np.log(sums).sum())


def _backwards(evidence: Evidence, joint: Vector) -> tuple[Vector, Vector]:
    """Return how likely, but for a factor, what is observed from each step on is by the state before it, and after."""
    flat, kinds = joint.reshape(-1, *joint.shape[-2:]), evidence.kinds
    before, later = np.empty((2, evidence.steps, joint.shape[-1]))
    running = np.ones(evidence.first.shape)
    for place in reversed(evidence.places):
        count = place.stop - place.start
        later[place] = running[:count]
        back = np.matmul(flat[kinds[place]], later[place][:, :, None])[..., 0]
        before[place] = np.divide(back, back.sum(axis=1, keepdims=True), out=running[:count])
    return before, later


def alike(model: POMDP, evidence: Evidence) -> tuple[tuple[int, ...], ...]:
    """Return the states that the model cannot tell apart by the evidence, in groups.

    Of each step, what is known of which of two states it was is a probability; if this hardly ever changes, nothing
    that is done or observed tells them apart: as in a model that is the same with the two in each other's place.
    """
    joint = moves(Matrices.of(model), evidence.masks)
    chances = passes(evidence, joint)[0] * _backwards(evidence, joint)[0]
    chances /= chances.sum(axis=1, keepdims=True)
    groups: list[list[int]] = []
    for state in np.flatnonzero(chances.sum(axis=0) >= 0.5).tolist():
        for group in groups:
            pair = chances[:, [group[0], state]]
            both = pair.sum(axis=1)
            share = np.divide(pair[:, 0], both, out=np.zeros(len(both)), where=both > 0)
            mean = float((both * share).sum() / both.sum())
            if float((both * (share - mean) ** 2).sum() / both.sum()) < _ALIKE * mean * (1 - mean):
                group.append(state)
                break
        else:
            groups.append([state])
    return tuple(tuple(group) for group in groups if len(group) > 1)


def expected(evidence: Evidence, joint: Vector) -> tuple[Vector, float]:
    """Return how often each transition is expected, with what was observed, and the log likelihood: A x K x S x S'."""
    before, total = passes(evidence, joint)
    flat, kinds = joint.reshape(-1, *joint.shape[-2:]), evidence.kinds
    _, later = _backwards(evidence, joint)
    counts = np.zeros(flat.shape)
    for kind in np.unique(kinds):
        which = kinds == kind
        after = later[which]
        weights = 1 / (before[which] * (after @ flat[kind].T)).sum(axis=1, keepdims=True)
        counts[kind] = (before[which] * weights).T @ after
    return (counts * flat).reshape(joint.shape), total


def _tally(counts: Vector, matrices: Matrices, evidence: Evidence) -> tuple[Vector, Vector]:
    """Return the expected counts of transitions and of observations in states."""
    transitions = counts.sum(axis=1)
    observations = matrices.observations
    if observations.ndim > 3:
        return transitions, np.zeros((*transitions.shape[:2], observations.shape[-1]))
    arrived = counts.sum(axis=2)  # A x K x S'
    seen = np.zeros(observations.shape)
    for symbol, mask in enumerate(evidence.masks):
        if mask.all():
            continue  # nothing was observed, which tells nothing of O
        share = observations * mask
        sums = share.sum(axis=2, keepdims=True)
        seen += arrived[:, symbol, :, None] * np.divide(share, sums, out=np.zeros_like(share), where=sums > 0)
    return transitions, seen


# -- Maximisation ----------------------------------------------------------------------------------------------------


def _improved(counts: Vector, model: Vector) -> Vector:
    """Return rows as estimated, each of which the model counts as one visit."""
    result: Vector = (counts + WEIGHT * model) / (counts.sum(axis=-1, keepdims=True) + WEIGHT)
    return result


def fit(model: POMDP, evidence: Evidence, *, rounds: int = _ROUNDS, begin: Matrices | None = None) -> Fit:
    """Estimate T and O by expectation maximisation from the model in use; of events T alone.

    Args:
        model: The model in use.
        evidence: See `evidence_of`.
        rounds: The most rounds; it ends when one gains less than 0.001 in log likelihood.
        begin: Where it begins, in place of the model.

    Raises:
        ModelError: If the model is too large.
    """
    old = Matrices.of(model)
    _check_size(old, evidence)
    current, events = begin or old, old.observations.ndim > 3
    before, last, done = math.nan, -math.inf, 0
    while True:
        counts, likelihood = expected(evidence, moves(current, evidence.masks))
        transitions, observations = _tally(counts, current, evidence)
        before = likelihood if done == 0 else before
        if likelihood - last < _GAIN or done >= rounds:
            break
        last = likelihood
        current = Matrices(
            _improved(transitions, old.transitions),
            old.observations if events else _improved(observations, old.observations),
        )
        done += 1
    return Fit(*current, transitions, observations, likelihood, before, done)


def _check_size(matrices: Matrices, evidence: Evidence) -> None:
    if evidence.steps * matrices.transitions.shape[1] > _MOST:
        raise ModelError(f"{evidence.steps} decisions are too many to estimate at once where states are hidden")
    size = matrices.transitions.size * max(len(evidence.masks), 1)
    if size > _LARGEST:
        raise ModelError(
            f"{matrices.transitions.shape[1]} states with {len(evidence.masks)} symbols observed are too many to "
            f"estimate where states are hidden"
        )


def joint_odds(model: POMDP, chains: Sequence[Chain], *, tilted: bool = False) -> float:
    """Return the natural logarithm of the odds against all of T and O together: at least m in 1/m of right models.

    Who bets against the model predicts each eighth of the decisions by what he has estimated from those before (L.
    Wasserman, A. Ramdas and S. Balakrishnan, *Universal inference*, PNAS 117, 2020). Twice the gain of log likelihood
    is no chi-squared number here: of dec-tiger's own records it refused nine of ten at 5 %.

    Args:
        model: The model in use.
        chains: The chains, see `evidence_of`.
        tilted: Whether half of the bet is on estimates from beside the model, which cannot tell all states apart.
    """
    old = Matrices.of(model)
    parts = [evidence_of(model, _first(chains, share)) for share in np.arange(1, _PARTS + 1) / _PARTS]
    begins = [old]
    if tilted:
        random = np.random.default_rng(0)
        aside = [part * random.uniform(0.5, 1.5, part.shape) for part in old]
        sums = [part.sum(axis=-1, keepdims=True) for part in aside]
        aside = [np.divide(part, total, out=part, where=total > 0) for part, total in zip(aside, sums, strict=True)]
        begins.append(Matrices(aside[0], old.observations if model.event_observations else aside[1]))
    won = []
    for begin in begins:
        total = 0.0
        for known, more in pairwise(parts):
            if known.steps:
                found = fit(model, known, begin=begin)
                better = Matrices(found.transitions, found.observations)
                total += _gain(more, better, old) - _gain(known, better, old)
        won.append(total)
    return float(np.logaddexp.reduce(won)) - math.log(len(won))


def _first(chains: Sequence[Chain], share: float) -> list[Chain]:
    """Return the first decisions of all."""
    left = math.ceil(share * sum(len(chain.decisions) for chain in chains))
    result = []
    for chain in chains:
        if left > 0:
            result.append(msgspec.structs.replace(chain, decisions=chain.decisions[:left]))
        left -= len(chain.decisions)
    return result


def _gain(evidence: Evidence, new: Matrices, old: Matrices) -> float:
    """Return by how much more likely the evidence is, as a logarithm."""
    likelihoods = [passes(evidence, moves(matrices, evidence.masks))[1] for matrices in (new, old)]
    return likelihoods[0] - likelihoods[1]


class Frequencies(msgspec.Struct, frozen=True):
    """How often each observation was made after an action, wherever it led.

    Attributes:
        action: The action.
        counts: How often each was made: O numbers.
        expected: How often the model expected each, under the belief before each action: O numbers.
        missing: How often nothing was observed, or a part of it.
    """

    action: int
    counts: npt.NDArray[np.float64]
    expected: npt.NDArray[np.float64]
    missing: int


def frequencies(model: POMDP, evidence: Evidence) -> tuple[Frequencies, ...]:
    """Return how often each observation was made after each action that was done.

    Args:
        model: The model in use.
        evidence: See `evidence_of`.
    """
    size = len(model.observation_space)
    matrices = Matrices.of(model)
    before, _ = passes(evidence, moves(matrices, evidence.masks))
    single = evidence.masks.sum(axis=1) == 1
    symbols = evidence.masks.argmax(axis=1)
    acted, seen = evidence.actions, evidence.symbols
    every = moves(matrices, np.eye(size, dtype=bool))
    result = []
    for action in np.unique(acted).tolist():
        which = (acted == action) & single[seen]
        told = np.bincount(symbols[seen[which]], minlength=size).astype(np.float64)
        # A x O x S x S', summed over S': what is observed after each state
        expected = before[which].sum(axis=0) @ every[action].sum(axis=2).T
        missing = int(((acted == action) & ~single[seen]).sum())
        result.append(Frequencies(action, told, np.asarray(expected), missing))
    return tuple(result)
