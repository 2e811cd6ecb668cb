"""Plot of a recorded run: modes, actions, beliefs and rewards over time."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import Error
from mdm.messages import ActionLife, Decision, Mode
from mdm.recording.names import Names, names_of
from mdm.views.canvas import pyplot

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.recording.reader import Record

__all__ = ["run_figure"]

_MODES = {"stopped": "#bbbbbb", "deciding": "#4c9f70", "safe": "#d1495b"}
_STATES = 6
"""States of a belief that are drawn: the likeliest over the run, the others as one."""
_FEW = 12
"""Actions whose names have room in a legend."""
_MOST = 8
"""Ensembles that have room in one picture."""


class _Ensemble:
    """What happened to an ensemble, in seconds."""

    def __init__(self) -> None:
        self.modes: list[tuple[float, str]] = []
        self.lives: list[tuple[float, float, str, str | None]] = []
        self.beliefs: list[tuple[float, Any]] = []
        self.rewards: list[tuple[float, float]] = []
        self.decisions = 0
        self._running: dict[int, tuple[float, str]] = {}

    def add(self, message: Any, seconds: float) -> None:
        """Take in a message."""
        if isinstance(message, Mode):
            self.modes.append((seconds, message.mode))
        elif isinstance(message, ActionLife):
            if message.status == "running":
                self._running[message.life] = seconds, message.action
            elif message.life in self._running:
                begin, action = self._running.pop(message.life)
                self.lives.append((begin, seconds, action, message.status))
        elif isinstance(message, Decision):
            self.decisions += 1
            if message.belief is not None:
                self.beliefs.append((seconds, message.belief))
            if message.reward is not None:
                self.rewards.append((seconds, message.reward))

    def end(self, seconds: float) -> None:
        """Take in that nothing more is recorded."""
        self.lives += [(begin, seconds, action, None) for begin, action in self._running.values()]


def run_figure(record: Record, ensembles: Sequence[str] | None = None) -> Any:
    """Draw a record over its time.

    Args:
        record: The record.
        ensembles: The paths of ensembles; by default all, up to eight.

    Raises:
        Error: If there is nothing to draw, or no such ensemble.
    """
    if record.span is None:
        raise Error(f"{record.path}: there are no messages to draw")
    start, last = record.span
    end = (last - start) / 1e9
    found: dict[str, _Ensemble] = {}
    topics = [topic for topic in ("decisions", "lives", "modes") if topic in record.topics]
    for each in record.messages(topics):
        if isinstance(each.message, Decision | ActionLife | Mode):
            found.setdefault(each.message.ensemble, _Ensemble()).add(each.message, (each.time - start) / 1e9)
    for name in ensembles or ():
        if name not in found:
            raise Error(f"{record.path}: there is no ensemble {name!r}; there are {', '.join(sorted(found)) or 'none'}")
    chosen = list(found)[:_MOST] if ensembles is None else list(dict.fromkeys(ensembles))
    if not chosen:
        raise Error(f"{record.path}: there are no decisions, lives of actions or modes to draw")
    names = names_of(record)
    heights = [height for name in chosen for height in ((1.0, 1.6) if found[name].beliefs else (1.0,))]
    rewarded = any(found[name].rewards for name in chosen)
    heights += [1.2] if rewarded else []
    figure, grid = pyplot().subplots(
        len(heights),
        figsize=(12, 1.0 + 1.1 * sum(heights)),
        height_ratios=heights,
        sharex=True,
        squeeze=False,
        layout="constrained",
    )
    axes = iter(grid[:, 0])
    for name in chosen:
        found[name].end(end)
        _draw_lives(next(axes), name, found[name], end)
        if found[name].beliefs:
            _draw_belief(next(axes), found[name], names.get(name, Names()), end)
    if rewarded:
        _draw_rewards(next(axes), {name: found[name] for name in chosen if found[name].rewards}, end)
    grid[-1, 0].set_xlim(0, end or 1.0)
    grid[-1, 0].set_xlabel("seconds")
    return figure


def _draw_lives(axes: Any, name: str, ensemble: _Ensemble, end: float) -> None:
    """Draw the modes as a band above the lives of actions, a bar each; what failed is hatched."""
    changes = [*ensemble.modes, (end, "")]
    for (begin, mode), (until, _) in pairwise(changes):
        axes.broken_barh([(begin, until - begin)], (1.1, 0.25), color=_MODES.get(mode, "white"), lw=0)
    actions = list(dict.fromkeys(action for _, _, action, _ in ensemble.lives))
    colours = pyplot().get_cmap("tab20")
    width = end / 1000
    for place, action in enumerate(actions):
        bars = [
            (begin, max(until - begin, width), status) for begin, until, own, status in ensemble.lives if own == action
        ]
        axes.broken_barh(
            [bar[:2] for bar in bars],
            (0.1, 0.9),
            color=colours(place % 20),
            lw=0,
            label=action if place < _FEW else "_",
        )
        failed = [bar[:2] for bar in bars if bar[2] in {"failed", "timed_out", "abandoned"}]
        axes.broken_barh(failed, (0.1, 0.9), facecolor="none", edgecolor=_MODES["safe"], hatch="////", lw=0)
    axes.set_ylim(0, 1.45)
    axes.set_yticks([0.55, 1.22], ["action", "mode"], fontsize=8)
    axes.set_title(name, loc="left", fontsize=9)
    handles, labels = axes.get_legend_handles_labels()
    shown = dict.fromkeys(mode for _, mode in ensemble.modes)
    handles += [pyplot().Rectangle((0, 0), 1, 1, color=_MODES[mode]) for mode in shown]
    labels += [*shown]
    if handles:
        axes.legend(handles, labels, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=7)


def _draw_belief(axes: Any, ensemble: _Ensemble, names: Names, end: float) -> None:
    """Draw the probabilities of the likeliest states, upon each other."""
    sizes = [len(belief) for _, belief in ensemble.beliefs]
    kept = [(seconds, belief) for seconds, belief in ensemble.beliefs if len(belief) == sizes[-1]]
    beliefs = np.array([belief for _, belief in kept])
    likely = np.sort(np.argsort(-beliefs.mean(axis=0), kind="stable")[:_STATES])
    shares = [beliefs[:, state] for state in likely]
    labels = [names.state(int(state)) or f"state {state}" for state in likely]
    if beliefs.shape[1] > len(likely):
        shares.append(1 - np.sum(shares, axis=0))
        labels.append(f"{beliefs.shape[1] - len(likely):,} others")
    times = np.array([*(seconds for seconds, _ in kept), end])
    layers = [np.append(share, share[-1]) for share in shares]
    axes.stackplot(times, layers, labels=labels, step="post", colors=pyplot().get_cmap("Set2")(range(8)), lw=0)
    axes.set_ylim(0, 1)
    axes.set_ylabel("belief", fontsize=8)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=7)


def _draw_rewards(axes: Any, ensembles: dict[str, _Ensemble], end: float) -> None:
    """Draw the sum of rewards since the start, to the end of the record."""
    for name, ensemble in ensembles.items():
        seconds, rewards = zip(*ensemble.rewards, strict=True)
        axes.step([*seconds, end], np.cumsum([*rewards, 0.0]), where="post", label=name)
    axes.set_ylabel("sum of rewards", fontsize=8)
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=7)
