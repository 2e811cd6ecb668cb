"""Plot of a recorded run: modes, decisions, actions, faults, beliefs and rewards over time."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import Error
from mdm.messages import ActionLife, Decision, Fault, Mode
from mdm.recording.table import Names, names_of
from mdm.views.canvas import pyplot
from mdm.views.palette import ACTIONS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.recording.reader import Record

_MODES = {"stopped": "#bbbbbb", "deciding": "#4c9f70", "safe": "#d1495b"}
_FAILED = {"failed", "timed_out", "abandoned"}
_BAR, _BAND, _MARK = (0.1, 0.9), (1.15, 0.25), 1.55
"""Where actions, modes and faults are, from below: the place and the height."""
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
        self.faults: list[tuple[float, str]] = []
        self.beliefs: list[tuple[float, Any]] = []
        self.rewards: list[tuple[float, float]] = []
        self.decisions: list[float] = []
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
        elif isinstance(message, Fault):
            self.faults.append((seconds, message.kind))
        elif isinstance(message, Decision):
            self.decisions.append(seconds)
            if message.belief is not None:
                self.beliefs.append((seconds, message.belief))
            if message.reward is not None:
                self.rewards.append((seconds, message.reward))

    def end(self, seconds: float) -> None:
        """Take in that nothing more is recorded, or drawn."""
        self.lives += [(begin, seconds, action, None) for begin, action in self._running.values()]
        self.lives.sort(key=lambda life: life[0])

    def lanes(self) -> list[list[tuple[float, float, str, str | None]]]:
        """Return the lives in as few rows as have none over another: those of actions at the same time lie apart."""
        lanes: list[list[tuple[float, float, str, str | None]]] = []
        for life in self.lives:
            free = next((lane for lane in lanes if lane[-1][1] <= life[0]), None)
            if free is None:
                lanes.append([life])
            else:
                free.append(life)
        return lanes


def run_figure(
    record: Record, ensembles: Sequence[str] | None = None, *, since: float = 0.0, until: float | None = None
) -> Any:
    """Draw a record over its time.

    Faults of other actors, such as a predicate manager's, are with the first ensemble.

    Args:
        record: The record.
        ensembles: The paths of ensembles; by default all, up to eight.
        since: From this second of the record on; rewards are summed from there.
        until: To this second; by default to the end.

    Raises:
        Error: If there is nothing to draw, or no such ensemble.
    """
    if record.span is None:
        raise Error(f"{record.path}: there are no messages to draw")
    start, last = record.span
    whole = (last - start) / 1e9
    end = whole if until is None else min(until, whole)
    if not since < end and (since or until is not None):
        part = f"from second {since:g} on" if until is None else f"between the seconds {since:g} and {until:g}"
        raise Error(f"{record.path}: there is nothing to draw {part}: the record lasts {whole:g} s")
    found, faults = _found(record, end)
    for name in ensembles or ():
        if name not in found:
            raise Error(f"{record.path}: there is no ensemble {name!r}; there are {', '.join(sorted(found)) or 'none'}")
    chosen = list(found)[:_MOST] if ensembles is None else list(dict.fromkeys(ensembles))
    if not chosen:
        raise Error(f"{record.path}: there are no decisions, lives of actions or modes to draw")
    for seconds, fault in faults:
        above = [name for name in found if f"{fault.source}/".startswith(f"{name}/")]  # of which the source is a part
        found[max(above, key=len, default=chosen[0])].add(fault, seconds)
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
    every = list(dict.fromkeys(action for name in found for action in names.get(name, Names()).actions))
    has_few = len(every) <= len(ACTIONS)  # so that an action has one colour in all ensembles, as on the page
    for name in chosen:
        found[name].end(end)
        order = every if has_few else [*names.get(name, Names()).actions]
        _draw_lives(next(axes), name, found[name], since, end, order)
        if found[name].beliefs:
            _draw_belief(next(axes), found[name], names.get(name, Names()), end)
    if rewarded:
        _draw_rewards(next(axes), {name: found[name] for name in chosen if found[name].rewards}, since, end)
    grid[-1, 0].set_xlim(since, end or 1.0)
    grid[-1, 0].set_xlabel("seconds")
    return figure


def _found(record: Record, end: float) -> tuple[dict[str, _Ensemble], list[tuple[float, Fault]]]:
    """Return what happened to each ensemble until some second, and the faults."""
    assert record.span is not None
    start = record.span[0]
    found: dict[str, _Ensemble] = {}
    faults = []
    topics = [topic for topic in ("decisions", "lives", "modes", "faults") if topic in record.topics]
    for _, time, _, message in record.messages(topics, until=start + round(end * 1e9) + 1):
        seconds = (time - start) / 1e9
        if isinstance(message, Fault):
            faults.append((seconds, message))
        elif isinstance(message, Decision | ActionLife | Mode):
            found.setdefault(message.ensemble, _Ensemble()).add(message, seconds)
    return found, faults


def _draw_lives(axes: Any, name: str, ensemble: _Ensemble, since: float, end: float, order: list[str]) -> None:
    """Draw the lives of actions, a bar each, of which what failed is hatched; decisions, modes and faults above."""
    for (begin, mode), (until, _) in pairwise([*ensemble.modes, (end, "")]):
        axes.broken_barh([(begin, until - begin)], _BAND, color=_MODES.get(mode, "white"), lw=0)
    axes.vlines(ensemble.decisions, sum(_BAR), _BAND[0], color="black", lw=0.6)
    _draw_bars(axes, ensemble, (end - since) / 200, order)
    if ensemble.faults:
        seconds = [at for at, _ in ensemble.faults]
        axes.plot(seconds, [_MARK] * len(seconds), "v", color=_MODES["safe"], ms=5, clip_on=False)
        if len(seconds) <= _FEW:
            for at, kind in ensemble.faults:
                axes.annotate(kind, (at, _MARK), (5, 0), textcoords="offset points", va="center", fontsize=6)
    axes.set_ylim(0, 1.7 if ensemble.faults else 1.5)
    axes.set_yticks([0.55, 1.27], ["action", "mode"], fontsize=8)
    axes.set_title(name, loc="left", fontsize=9)
    handles, labels = axes.get_legend_handles_labels()
    shown = dict.fromkeys(mode for _, mode in ensemble.modes)
    handles += [pyplot().Rectangle((0, 0), 1, 1, color=_MODES[mode]) for mode in shown]
    labels += [*shown]
    if handles:
        axes.legend(handles, labels, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=7)


def _draw_bars(axes: Any, ensemble: _Ensemble, least: float, order: list[str]) -> None:
    """Draw the lives in lanes; short ones are as wide as can be seen, but cover none that follows.

    Colours go by the order of actions, which others are added to.
    """
    lanes = ensemble.lanes()
    height = _BAR[1] / max(1, len(lanes))
    bars: dict[str, list[tuple[float, float, float, str | None]]] = {action: [] for _, _, action, _ in ensemble.lives}
    for place, lane in enumerate(lanes):
        begins = [life[0] for life in lane[1:]]
        for (begin, until, action, status), following in zip(lane, [*begins, float("inf")], strict=True):
            width = max(until - begin, min(least, following - begin))
            bars[action].append((begin, width, _BAR[0] + place * height, status))
    for number, (action, each) in enumerate(bars.items()):
        if action not in order:
            order.append(action)
        colour, label = ACTIONS[order.index(action) % len(ACTIONS)], action if number < _FEW else "_"
        for bottom in dict.fromkeys(bar[2] for bar in each):
            here = [(begin, width) for begin, width, own, _ in each if own == bottom]
            axes.broken_barh(here, (bottom, height), color=colour, lw=0, label=label)
            label = "_"
            failed = [(begin, width) for begin, width, own, status in each if own == bottom and status in _FAILED]
            if failed:
                axes.broken_barh(
                    failed, (bottom, height), facecolor="none", edgecolor=_MODES["safe"], hatch="////", lw=0
                )


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
    axes.stackplot(times, layers, labels=labels, step="post", colors=ACTIONS, lw=0)
    axes.set_ylim(0, 1)
    axes.set_ylabel("belief", fontsize=8)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=7)


def _draw_rewards(axes: Any, ensembles: dict[str, _Ensemble], since: float, end: float) -> None:
    """Draw the sums of rewards from some second on."""
    for name, ensemble in ensembles.items():
        got = [(seconds, reward) for seconds, reward in ensemble.rewards if seconds >= since] or [(since, 0.0)]
        seconds, rewards = zip(*got, strict=True)
        axes.step([*seconds, end], np.cumsum([*rewards, 0.0]), where="post", label=name)
    axes.set_ylabel("sum of rewards", fontsize=8)
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=7)
