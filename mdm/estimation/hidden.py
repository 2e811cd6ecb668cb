"""Hidden states: estimates of a POMDP's T and O from actions and observations alone.

Expectation maximisation (L. E. Baum et al., 1970; L. R. Rabiner, *A tutorial on hidden Markov models*, Proceedings of
the IEEE 77, 1989, section III.C), in which an action chooses the matrices of each step. It climbs from **the model in
use**: from random beginnings it ends in other maxima, or with the names of the states swapped. A row of the model
counts as one visit (`mdm.estimation.reestimation`), so that rows of which nothing is known stay as they are. A round
costs a multiplication of an S x S matrix for each step.

Where the model cannot tell two states apart, no round does either, and which of them is which is not in the record:
`alike` names them. The test of all of T and O together (`joint_odds`) then climbs also from a model whose rows are
tilted a little.

Expected counts are no counts: intervals that take them as seen cover four fifths of what they should. Intervals, and
tests of each row, are by Gibbs sampling (`sample`). In turn the states of all chains are drawn, given T and O, and T
and O, given the states (S. L. Scott, *Bayesian methods for hidden Markov models*, Journal of the American Statistical
Association 97, 2002). States are drawn by a filter forwards and samples backwards (C. K. Carter and R. Kohn, *On Gibbs
sampling for state space models*, Biometrika 81, 1994), rows from Dirichlet distributions with Jeffreys' prior on the
entries that the model has. Several samplers go side by side as arrays, each from the estimate: names of states are not
swapped. A row is tested by the draws of it, in which all other rows vary: held as in a wrong model, they make a wrong
row look right. The likelihood of the best others would not do: it may have the states by each other's names.
"""

from __future__ import annotations

import math
from collections import Counter
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.estimation.reestimation import WEIGHT
from mdm.estimation.rows import LEVEL, PRIOR
from mdm.models.dynamics import dense

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mdm.estimation.chains import Chain
    from mdm.messages import Decision
    from mdm.models.matrices import Vector
    from mdm.models.pomdp import POMDP

_LARGEST = 8_000_000
"""The most numbers in the matrices of all actions and observed symbols."""
_MOST = 50_000_000
"""The most numbers in the beliefs before all steps."""
_GAIN = 1e-3
"""The gain of log likelihood below which there is no further round."""
_ROUNDS = 100
_PARTS = 8
"""The parts of a record of which each is predicted by the estimate from those before."""
_ALIKE = 0.01
"""The share of all knowledge of which of two states it was, below which they are not told apart."""
_SAMPLERS = 32
_SWEEPS = 30
_BURNT = 8
"""The sweeps of each sampler that are not used: it begins at the estimate, where it would end anyhow."""
_TOGETHER = 16_000_000
"""The numbers that all samplers may hold."""

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
        symbols: The observation after it, as places in ``masks``, M.
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
    something was observed that has no probability, the chain is cut, and begins again with the belief that was decided
    on then.

    Raises:
        ModelError: If the model may go on without a detection (`POMDP.waits`): the number of steps is not known then.
    """
    if model.waits:
        raise ModelError(
            "steps without a detection are not in a record: at a fixed rate, or with a model without false negatives, "
            "each step is known"
        )
    matrices = Matrices.of(model)
    moved: dict[tuple[int, Observed], Vector] = {}
    impossible: Counter[tuple[int, Observed]] = Counter()
    parts: list[_Part] = []
    for chain in chains:
        before = chain.decisions[0]
        parts.append(part := _Part.after(before, model))
        belief = part.first
        for decision in chain.decisions[1:]:
            key = before.action, decision.observation
            if key not in moved:
                seen = _seen(matrices.observations[key[0]], _mask(model, key[1])[None])[..., 0]
                moved[key] = matrices.transitions[key[0]] * seen
            after = belief @ moved[key]
            total = float(after.sum())
            if total > 0:
                part.actions.append(key[0])
                part.symbols.append(key[1])
                belief = after / total
            else:
                impossible[key] += 1
                parts.append(part := _Part.after(decision, model))
                belief = part.first
            before = decision
    parts = sorted((part for part in parts if part.actions), key=lambda part: -len(part.actions))
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
    return Evidence(
        np.array([part.first for part in parts]).reshape(len(parts), len(model.state_space)),
        np.array(starts, dtype=np.intp),
        np.array(actions, dtype=np.intp),
        np.array(symbols, dtype=np.intp),
        np.array([_mask(model, symbol) for symbol in places]).reshape(len(places), len(model.observation_space)),
        tuple((*key, times) for key, times in impossible.items()),
    )


class _Part(NamedTuple):
    """A part of a chain in which nothing impossible was observed."""

    first: Vector
    actions: list[int]
    symbols: list[Observed]

    @classmethod
    def after(cls, decision: Decision, model: POMDP) -> _Part:
        """Return a part that begins with the belief of a decision, or the initial one where it has none."""
        belief = model.initial_belief if decision.belief is None else decision.belief
        return cls(np.asarray(belief, dtype=np.float64), [], [])


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
    """Return the probability of each observed symbol: ... x K; of nothing 1, for events may leave it open."""
    told: Vector = observations @ masks.T.astype(np.float64)
    told[..., masks.all(axis=1) & (masks.shape[1] > 1)] = 1.0
    return told


# -- Expectation -----------------------------------------------------------------------------------------------------


def moves(matrices: Matrices, masks: npt.NDArray[np.bool_]) -> Vector:
    """Return P(s', symbol | s, a) for each observed symbol: ... x A x K x S x S'."""
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
    """Return how likely, but for a factor, all observations from each step on are by the state before it, and after."""
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

    The knowledge of which of two states each step began in is a probability; if this hardly ever changes, nothing
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
    """Return how often each transition is expected, with each symbol, and the log likelihood: A x K x S x S'."""
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

    A gambler against the model predicts each eighth of the decisions by an estimate from those before (L.
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


# -- Sampling ----------------------------------------------------------------------------------------------------------


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
        model: Says which entries are possible.
        evidence: See `evidence_of`.
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
    """Return rows drawn from their posterior, Dirichlet(counts + 1/2) on the possible entries."""
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
    """Return the observations, drawn where components are missing, and the steps that have any."""
    widths = evidence.masks.sum(axis=1)
    which = (widths[seen] < evidence.masks.shape[1]) | (widths[seen] == 1)
    symbols = evidence.masks.argmax(axis=1)[seen[which]]
    partly = widths[seen[which]] > 1
    if partly.any():
        at = np.flatnonzero(which)[partly]
        weights = current.observations[who[at], acted[at], state[at]] * evidence.masks[seen[at]]
        symbols[partly] = _chosen(weights, random)
    return symbols, which
