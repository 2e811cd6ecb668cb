"""Plots over beliefs: a policy over beliefs in two states, and a belief over an episode."""

from __future__ import annotations

from collections import defaultdict
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.beliefs import Support
from mdm.errors import Error, ModelError
from mdm.simulation.batch import EpisodeRunner
from mdm.views.canvas import pyplot
from mdm.views.grid import action_colours

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mdm.models import MDP, Space
    from mdm.models.matrices import Vector
    from mdm.simulation.batch import EpisodeStep

__all__ = ["belief_figure", "state_name", "two_state_figure"]

_POINTS = 401
_EPISODES = 20
_STEPS = 50
_LIKELY = 6
_PAIRS = 50
_FEW = 11
"""Pairs of states that are tried, and beliefs in a pair."""
_ROWS = 25
_NAMED = 30
"""Number of decisions up to which actions and observations are labelled."""


def two_state_figure(model: MDP, policy: Any, states: Sequence[str] | None, seed: int) -> Any:
    """Draw the value and the action of a policy over beliefs in two states.

    Args:
        model: The model.
        policy: The policy.
        states: The two states; by default those that share most belief in simulated episodes, of states between
            which the action changes if there are such.
        seed: Seed of these episodes.
    """
    if states is None:
        pair = _most_confused_pair(model, policy, seed)
    else:
        pair = model.state_space.index(states[0]), model.state_space.index(states[1])
        if pair[0] == pair[1]:
            raise ModelError(f"two states are needed, not {states[0]!r} twice")
    shares = np.linspace(0, 1, _POINTS)
    beliefs = np.zeros((_POINTS, len(model.state_space)))
    beliefs[:, pair[0]], beliefs[:, pair[1]] = 1 - shares, shares
    values = np.array([policy.value(belief) for belief in beliefs])
    actions = np.array([policy.action(belief) for belief in beliefs])
    names = [state_name(model.state_space, state) for state in pair]
    figure, axes = pyplot().subplots(figsize=(8, 5))
    colours, handles = action_colours(model, sorted(set(actions.tolist())))
    edges = np.flatnonzero(np.diff(actions)) + 1
    for part in np.split(np.arange(_POINTS), edges):
        begin, end = shares[part[0]], shares[min(part[-1] + 1, _POINTS - 1)]
        axes.axvspan(begin, end, color=colours[int(actions[part[0]])], lw=0)
    if hasattr(policy, "q_values"):
        each = np.array([policy.q_values(belief) for belief in beliefs])
        each[~np.isfinite(each)] = np.nan
        axes.plot(shares, each, color="#666666", lw=0.7)
    axes.plot(shares, values, color="black", lw=2)
    finite = values[np.isfinite(values)]
    if len(finite):  # values of actions that are never best may lie far below
        margin = 0.25 * (finite.max() - finite.min()) or 1.0
        axes.set_ylim(finite.min() - margin, finite.max() + margin / 2)
    axes.set_xlim(0, 1)
    axes.set_xlabel(f"belief in {names[1]!r}, the rest in {names[0]!r}")
    axes.set_ylabel("value (black), and of each action (grey)")
    axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1), frameon=False, fontsize=9)
    return figure


def _most_confused_pair(model: MDP, policy: Any, seed: int) -> tuple[int, int]:
    """Return the two states with the greatest mean product of beliefs between which the action changes, or of all."""
    shared: defaultdict[tuple[int, int], float] = defaultdict(float)
    for belief in _beliefs(model, policy, seed):
        likely = sorted(np.argsort(-belief, kind="stable")[:_LIKELY].tolist())
        for one, other in combinations(likely, 2):
            shared[one, other] += float(belief[one] * belief[other])
    pairs = [pair for pair in sorted(shared, key=lambda pair: -shared[pair]) if shared[pair] > 0]
    if len(model.state_space) == 1:
        raise Error("a picture over beliefs needs two states, and the model has one")
    if not pairs:
        raise Error("this model's state is always certain: name two states with --states")
    return next((pair for pair in pairs[:_PAIRS] if _changes(model, policy, pair)), pairs[0])


def _beliefs(model: MDP, policy: Any, seed: int) -> Iterator[Vector]:
    """Yield the beliefs of some episodes; the initial one where episodes are empty, since nothing can be earned."""
    run = EpisodeRunner(model, policy)
    empty = True
    for stream in np.random.SeedSequence(seed).spawn(_EPISODES):
        for _, moment in zip(range(_STEPS), run(stream), strict=False):
            empty = False
            yield _dense(moment.belief, model)
    if empty:
        yield model.initial_belief


def _changes(model: MDP, policy: Any, pair: tuple[int, int]) -> bool:
    """Return whether the action changes between two states."""
    belief = np.zeros(len(model.state_space))
    actions = set()
    for share in np.linspace(0, 1, _FEW):
        belief[pair[0]], belief[pair[1]] = 1 - share, share
        actions.add(policy.action(belief))
    return len(actions) > 1


def belief_figure(model: MDP, policy: Any, steps: int, seed: int) -> Any:
    """Draw the belief at each decision of an episode, with true states, actions and observations.

    Args:
        model: The model.
        policy: The policy.
        steps: The maximum number of decisions.
        seed: Seed of the episode.
    """
    moments: list[EpisodeStep] = []
    for moment in EpisodeRunner(model, policy)(seed):
        if moment.decided:
            moments.append(moment)
        if len(moments) == steps:
            break
    if not moments:
        raise Error("the episode is empty: no reward can be reached from its first state")
    beliefs = np.array([_dense(moment.belief, model) for moment in moments]).T
    true = np.array([moment.state for moment in moments])
    peak = beliefs.max(axis=1)
    peak[true] += 1  # true states are always shown
    kept = np.sort(np.argsort(-peak, kind="stable")[: min(_ROWS, int((peak > 1e-3).sum()))])
    width = 0.32 * len(moments) + 2
    figure, axes = pyplot().subplots(figsize=(float(np.clip(width, 6, 16)), 0.3 * len(kept) + 2))
    shades = axes.imshow(beliefs[kept], cmap="Blues", vmin=0, vmax=float(beliefs.max()), aspect="auto")
    figure.colorbar(shades, ax=axes, fraction=0.04, pad=0.02, label="probability")
    shown = np.isin(true, kept)
    axes.plot(
        np.flatnonzero(shown), np.searchsorted(kept, true[shown]), "o", ms=5, mfc="none", mec="C3", label="true state"
    )
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1.01), frameon=False, fontsize=8)
    axes.set_yticks(range(len(kept)), [state_name(model.state_space, int(state)) for state in kept], fontsize=8)
    if len(moments) <= _NAMED:
        acts = model.action_space.names
        sights = () if model.observation_space is None else model.observation_space.names
        labels = [
            f"{'' if moment.seen is None else sights[moment.seen]} → {acts[moment.action]}".lstrip(" ")
            for moment in moments
        ]
        axes.set_xticks(range(len(moments)), labels, rotation=90, fontsize=7)
        axes.set_xlabel("decision: observation → action")
    else:
        axes.set_xlabel("decision")
    return figure


def state_name(space: Space, state: int) -> str:
    """Return the name of a state; of several factors each with its own name."""
    if len(space.factors) == 1:
        return space.names[state]
    pairs = zip(space.factors, space.unravel(state), strict=True)
    return ", ".join(f"{factor.name}={factor.names[value]}" for factor, value in pairs)


def _dense(belief: Vector | Support | None, model: MDP) -> Vector:
    assert belief is not None
    return belief.dense(len(model.state_space)) if isinstance(belief, Support) else belief
