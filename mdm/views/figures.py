"""Plots: of policies as graphs, over two factors, over beliefs, over an episode; of bounds of solvers; of sweeps."""

from __future__ import annotations

import math
from collections import defaultdict
from html import escape
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.beliefs import Support
from mdm.checks import is_number
from mdm.errors import Error, FormatError, ModelError
from mdm.explanation import Case
from mdm.formats.source import content
from mdm.simulation.batch import EpisodeRunner
from mdm.snapshots.picture import Picture, picture_of
from mdm.solvers import exact_values
from mdm.views.canvas import pyplot
from mdm.views.palette import ACTIONS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from mdm.models import MDP, Space
    from mdm.models.matrices import Vector
    from mdm.simulation.batch import EpisodeStep

_LETTER, _LINE = 4.8, 10.0
"""The width of a letter and the height of a line, in points: names of actions stand in the cells that they fit into."""
_TICKS = 30
_ARROWS = {"north": "↑", "up": "↑", "south": "↓", "down": "↓", "east": "→", "right": "→", "west": "←", "left": "←"}
_POINTS = 401
_EPISODES = 20
_STEPS = 50
_LIKELY = 6
_PAIRS = 50
_FEW = 11
"""Pairs of states that are tried, and beliefs in a pair."""
_ROWS = 25
_CONFIDENCE = 1.96
"""Standard errors within which a value is with 95 % confidence."""
_NAMED = 30
"""Number of decisions up to which actions and observations are labelled."""


def grid_figure(model: MDP, policy: Any, axes: Sequence[str] | None, columns: int | None) -> Any:
    """Draw a policy over the states of a model.

    Further factors have their values in the likeliest initial state. A policy over beliefs is drawn for certain
    states.

    Args:
        model: The model.
        policy: The policy.
        axes: Two factors, by name; by default the two largest.
        columns: The number of states in a row, for states without factors; by default that of a square.

    Raises:
        ModelError: If there is no such factor.
    """
    space = model.state_space
    if columns is not None or (axes is None and len(space.factors) == 1):
        width = min(columns or math.ceil(math.sqrt(len(space))), len(space))
        count = math.ceil(len(space) / width) * width
        states = np.where(np.arange(count) < len(space), np.arange(count), -1).reshape(-1, width)
        labels, title = None, "states in rows, the first at the top left"
    else:
        down, across = _chosen(space, axes)
        states, labels = _cells(model, down, across), (space.factors[down], space.factors[across])
        pairs = zip(space.factors, _likely(model), strict=True)
        rest = [f"{f.name} = {f.names[at]}" for place, (f, at) in enumerate(pairs) if place not in {down, across}]
        title = f"where {', '.join(rest)}" if rest else ""
    used = states >= 0
    values, actions = np.full(states.shape, np.nan), np.full(states.shape, -1)
    values[used], actions[used] = _evaluated(model, policy, states[used])
    plt = pyplot()
    rows, width = states.shape
    size = (2 * np.clip(0.45 * width, 3.5, 9) + 2.5, float(np.clip(0.45 * rows, 2.5, 9)) + 1)
    figure, (left, right) = plt.subplots(1, 2, figsize=size, sharex=True, sharey=True, layout="constrained")
    shades = left.imshow(values, cmap="viridis", aspect="auto")
    figure.colorbar(shades, ax=left, fraction=0.05, pad=0.03)
    left.set_title("value", fontsize=10)
    colours, handles = action_colours(model, sorted(set(actions[used].tolist())))
    image = np.ones((*states.shape, 3))
    image[used] = [colours[action] for action in actions[used].tolist()]
    right.imshow(image, aspect="auto")
    right.set_title("action", fontsize=10)
    right.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1), frameon=False, fontsize=8)
    wide, high = 72 * (size[0] - 2.5) / 2 / width, 72 * (size[1] - 1) / rows
    for row, column in zip(*np.nonzero(used), strict=True):
        name = model.action_space.names[actions[row, column]]
        if name:
            name = _ARROWS.get(name.lower().split()[-1].removeprefix("move").strip("_- "), name)
        if high >= _LINE and wide >= max(_LINE, _LETTER * len(name)):
            right.text(column, row, name, ha="center", va="center", fontsize=8)
    for each in (left, right):
        _label(each, labels)
    right.set_ylabel("")
    figure.suptitle(title, fontsize=10)
    return figure


def action_colours(model: MDP, actions: Sequence[int]) -> tuple[dict[int, Any], list[Any]]:
    """Return a light colour per action, and the handles for a legend."""
    from matplotlib.colors import to_rgb  # noqa: PLC0415 - an extra
    from matplotlib.patches import Patch  # noqa: PLC0415 - an extra

    colours = {action: to_rgb(ACTIONS[action % len(ACTIONS)]) for action in actions}
    names = model.action_space.names
    return colours, [Patch(color=colour, label=names[action]) for action, colour in colours.items()]


def _chosen(space: Space, axes: Sequence[str] | None) -> tuple[int, int]:
    names = [factor.name for factor in space.factors]
    if axes is None:
        first, second = sorted(sorted(range(len(names)), key=lambda place: -len(space.factors[place]))[:2])
        return first, second
    for name in axes:
        if name not in names:
            raise ModelError(f"the states have no factor {name!r}; there are {', '.join(names)}")
    if axes[0] == axes[1]:
        raise ModelError(f"a grid needs two factors, not {axes[0]!r} twice")
    return names.index(axes[0]), names.index(axes[1])


def _likely(model: MDP) -> tuple[int, ...]:
    return model.state_space.unravel(int(model.initial_belief.argmax()))


def _cells(model: MDP, down: int, across: int) -> Any:
    """Return the index of the state in each cell."""
    space = model.state_space
    parts: list[Any] = list(_likely(model))
    parts[down], parts[across] = np.ix_(range(space.shape[down]), range(space.shape[across]))
    return np.ravel_multi_index(tuple(np.broadcast_arrays(*parts)), space.shape)


def _evaluated(model: MDP, policy: Any, states: Any) -> tuple[Vector, list[int]]:
    """Return the values and actions of some states."""
    if policy.input == "state":
        values = exact_values(model, policy)
        if values is None:
            values = np.array([policy.value(state) for state in range(policy.num_states)])
        return values[states], [policy.action(state) for state in states.tolist()]
    values, actions = np.empty(len(states)), []
    for place, state in enumerate(states.tolist()):
        belief = np.zeros(len(model.state_space))
        belief[state] = 1
        values[place] = policy.value(belief)
        actions.append(policy.action(belief))
    values[~np.isfinite(values)] = np.nan
    return values, actions


def _label(axes: Any, labels: Any) -> None:
    if labels is None:
        axes.set_xticks([])
        axes.set_yticks([])
        return
    down, across = labels
    axes.set_xlabel(across.name)
    axes.set_ylabel(down.name)
    for axis, factor in ((axes.xaxis, across), (axes.yaxis, down)):
        places = range(0, len(factor), math.ceil(len(factor) / _TICKS))
        turned = axis is axes.xaxis and max(len(factor.names[place]) for place in places) > 3
        axis.set_ticks(places, [factor.names[place] for place in places], fontsize=7, rotation=90 if turned else 0)


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


_STYLE = """svg{--paper:#fff;--ink:#1b2129;--soft:#55606d;--mark:#1f5fbf;background:var(--paper);font:12px sans-serif}
@media(prefers-color-scheme:dark){svg{--paper:#1a2027;--ink:#e8ecf1;--soft:#a5b0bd;--mark:#7fb0ff}}
text{text-anchor:middle;fill:var(--ink)}path{fill:none;stroke:var(--soft)}.lit path,.way path{stroke:var(--mark);
stroke-width:3}.lit text{font-weight:700}.edge text{paint-order:stroke;stroke:var(--paper);stroke-width:9}.area path{
stroke:var(--paper)}.area.lit path{stroke:#14181d}.now path{fill:var(--mark)}.inked text{fill:#14181d}
.edge path{marker-end:url(#tip)}.edge.lit path{marker-end:url(#tiplit)}marker path,marker.lit path{stroke:none}
marker path{fill:var(--soft)}marker.lit path{fill:var(--mark)}"""
_TIP = """<marker id="tip{0}" class="{0}" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8"
markerUnits="userSpaceOnUse" orient="auto"><path d="M0 0L8 4L0 8z"/></marker>"""


def policy_graph(model: MDP, policy: Any) -> Picture:
    """Return a policy as a page draws it, with the first decision lit where the first state or belief is known."""
    at = policy.information(model).current
    if at is None and model.initial_belief.max() == 1:
        at = int(model.initial_belief.argmax())
    spaces = model.state_space, model.action_space, model.observation_space
    return picture_of(Case(policy, model, *spaces, 0, -1, at))


def vector_image(picture: Picture, actions: Sequence[str] = ()) -> str:
    """Return a picture as an SVG file, light or dark as its viewer is, with actions in the order of their colours."""
    known = [*dict.fromkeys([*actions, *(shape.action for shape in picture.shapes if shape.action)])]
    size = f'viewBox="0 0 {picture.width:g} {picture.height:g}" width="{picture.width:g}" height="{picture.height:g}"'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}><style>{_STYLE}</style>',
        _TIP.format(""),
        _TIP.format("lit"),
    ]
    lines.append(f"<title>{escape(picture.title)}</title>")
    for shape in picture.shapes:
        kind = f"{shape.kind}{' lit' * shape.lit}{' inked' * bool(shape.action)}"
        colour = f' style="fill:{ACTIONS[known.index(shape.action) % len(ACTIONS)]}"' if shape.action else ""
        drawn = f'<path d="{shape.path}"{colour}/>' if shape.path else ""
        first = shape.y - 7.5 * len(shape.text) + 11.5
        texts = [
            f'<text x="{shape.x}" y="{first + 15 * at}">{escape(each)}</text>' for at, each in enumerate(shape.text)
        ]
        lines.append(f'<g class="{kind}"><title>{escape(shape.title)}</title>{drawn}{"".join(texts)}</g>')
    return "\n".join([*lines, "</svg>\n"])


class _Entry(msgspec.Struct):
    seconds: float
    lower: float | None
    upper: float | None


class _Run(msgspec.Struct):
    solver: str
    history: list[_Entry]


def bounds_figure(paths: list[str]) -> Any:
    """Draw the histories in some files.

    Raises:
        FormatError: If a file is not a history.
    """
    runs = [_read(Path(path)) for path in paths]
    figure, axes = pyplot().subplots(figsize=(8, 5))
    settled: list[float] = []
    for place, (path, run) in enumerate(zip(paths, runs, strict=True)):
        label, entries = f"{Path(path).stem} ({run.solver})", run.history
        for side in ("lower", "upper"):
            points = [(entry.seconds, value) for entry in entries if (value := getattr(entry, side)) is not None]
            if points:
                seconds, values = zip(*points, strict=True)
                style = {"marker": "."} if len(points) == 1 else {}
                axes.step(seconds, values, where="post", color=f"C{place}", label=label, **style)
                label = "_"  # one of the two lines is enough for the legend
                settled += values[len(values) // 2 :]
        both = [entry for entry in entries if None not in {entry.lower, entry.upper}]
        sides = ([getattr(entry, side) for entry in both] for side in ("lower", "upper"))
        axes.fill_between([entry.seconds for entry in both], *sides, step="post", color=f"C{place}", alpha=0.12)
    if settled:  # the first bounds are so loose that they would hide the last ones
        margin = 0.05 * (max(settled) - min(settled)) or 1.0
        axes.set_ylim(min(settled) - margin, max(settled) + margin)
        axes.legend(frameon=False)
    axes.set_xscale("log")
    axes.set_xlabel("seconds")
    axes.set_ylabel("value of the initial belief")
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def _read(path: Path) -> _Run:
    try:
        run = msgspec.json.decode(content(path), type=_Run)
    except msgspec.MsgspecError as error:
        raise FormatError(f"a history written by mdm solve --history was expected: {error}", file=path) from None
    if not run.history:
        raise FormatError("the history is empty", file=path)
    return run


def sweep_figure(rows: Sequence[Mapping[str, Any]], x: str, y: str = "value", by: str | None = None) -> Any:
    """Draw a column of a sweep's rows over another, with a line through the means of those that have the same place.

    Args:
        rows: The rows; those without a number to draw are left out.
        x: The column to the right.
        y: The column upwards; values have their 95 % confidence.
        by: The column whose values have a line each.

    Raises:
        Error: If there is no such column, or nothing to draw.
    """
    for name in filter(None, (x, y, by)):
        if not any(name in row for row in rows):
            raise Error(f"the result has no column {name!r}; it has {', '.join(rows[0] if rows else ()) or 'no rows'}")
    found: defaultdict[Any, list[Any]] = defaultdict(list)
    rows = [row for row in rows if is_number(row[y]) and row[x] is not None]
    numbers = all(is_number(row[x]) for row in rows)
    for row in rows:
        within = _CONFIDENCE * row["standard_error"] if y == "value" else 0.0
        place = row[x] if numbers else str(row[x])
        found["" if by is None else f"{by} {row[by]}"].append((place, row[y], within))
    if not found:
        raise Error(f"there is nothing to draw: no row has both {x!r} and a number for {y!r}")
    figure, axes = pyplot().subplots(figsize=(8, 5))
    for number, (label, points) in enumerate(found.items()):
        points.sort()
        places = list(dict.fromkeys(place for place, *_ in points))
        means = [np.mean([height for at, height, _ in points if at == place]) for place in places]
        axes.plot(places, means, color=f"C{number}", lw=1.2, label=label)
        axes.errorbar(*zip(*points, strict=True), fmt="o", ms=4, color=f"C{number}", capsize=2, lw=0.8)
    if by is not None:
        axes.legend(frameon=False)
    axes.set(xlabel=x, ylabel="value of the initial belief" if y == "value" else y)
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
    return figure
