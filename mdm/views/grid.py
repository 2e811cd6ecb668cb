"""Plot of a policy over two factors of the state: values as shades, actions as colours."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import ModelError
from mdm.solvers import exact_values
from mdm.views.canvas import pyplot

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.models import MDP, Space
    from mdm.models.matrices import Vector

__all__ = ["action_colours", "grid_figure"]

_LETTER, _LINE = 4.8, 10.0
"""The width of a letter and the height of a line, in points: names of actions stand in the cells that they fit into."""
_TICKS = 30
_ARROWS = {"north": "↑", "up": "↑", "south": "↓", "down": "↓", "east": "→", "right": "→", "west": "←", "left": "←"}


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
    from matplotlib.patches import Patch  # noqa: PLC0415 - an extra

    palette = pyplot().get_cmap("tab20" if len(actions) > 10 else "tab10")
    colours = {action: tuple(0.4 * c + 0.6 for c in palette(i % palette.N)[:3]) for i, action in enumerate(actions)}
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
