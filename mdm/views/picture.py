"""Drawing of a two-slice network: current variables on the left, next states in the middle, outcomes on the right."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.models.factored.two_slice import Node
from mdm.views.canvas import keep, pyplot

if TYPE_CHECKING:
    from mdm.models import TwoSliceNetwork
    from mdm.models.factored.two_slice import Role

_COLOURS = {"state": "#cfe2f3", "next_state": "#cfe2f3", "action": "#f9cb9c", "observation": "#d9ead3"}
_REWARD = "#fff2cc"
_WIDTH = 5.0
_GAP, _APART = 0.2, 0.09
"""Half the room between two boxes, and how far arrows through it are apart."""


def draw(network: TwoSliceNetwork, path: str) -> None:
    """Draw a network into a file in the format of its suffix: .png, .svg or .pdf.

    Raises:
        Error: If matplotlib is not installed, or the file cannot be written.
    """
    plt = pyplot()
    columns = _columns(network)
    places = {
        name: (_WIDTH * column, -(row - (len(names) - 1) / 2))
        for column, names in enumerate(columns)
        for row, name in enumerate(names)
    }
    tallest = max(map(len, columns))
    figure, axes = plt.subplots(figsize=(11, max(3.0, 0.9 * tallest)))
    boxes: dict[Any, Any] = {}
    for names in columns:
        for name, (label, colour) in names.items():
            style = {"boxstyle": "round,pad=0.4", "facecolor": colour, "edgecolor": "#444444"}
            boxes[name] = axes.text(*places[name], label, ha="center", va="center", fontsize=10, bbox=style, zorder=3)
    axes.set_xlim(-_WIDTH / 2, _WIDTH * 2.5)
    axes.set_ylim(-tallest / 2 - 0.3, tallest / 2 + 0.3)
    axes.axis("off")
    figure.canvas.draw()  # boxes have no size before this
    inverse = axes.transData.inverted()
    spans = {name: box.get_bbox_patch().get_window_extent().transformed(inverse) for name, box in boxes.items()}
    roles: tuple[Role, ...] = ("state", "next_state", "observation")
    nodes = [Node(role, place) for role in roles for place in range(len(network.factors(role)))]
    edges: list[tuple[Any, Any]] = [(node, parent) for node in nodes for parent in network.parents(node)]
    edges += [(index, node) for index, utility in enumerate(network.utilities) for node in utility.scope]
    far = [(child, parent) for child, parent in edges if places[child][0] - places[parent][0] > _WIDTH]
    middle = (min(spans[name].x0 for name in columns[1]), max(spans[name].x1 for name in columns[1]))
    heights = _heights(far, places, [places[name][1] for name in columns[1]])
    for child, parent in edges:
        same = places[child][0] == places[parent][0]
        start = (spans[parent].x0 if same else spans[parent].x1, places[parent][1])
        if (child, parent) in heights:
            start = _pass(axes, start, middle, heights[child, parent])
        arrow = {"arrowstyle": "-|>", "color": "#888888", "shrinkA": 0, "shrinkB": 1}
        arrow["connectionstyle"] = f"arc3,rad={0.4 if same else 0.04}"
        axes.annotate("", xy=(spans[child].x0, places[child][1]), xytext=start, arrowprops=arrow, zorder=1)
    keep(figure, path)


def _heights(
    edges: list[tuple[Any, Any]], places: dict[Any, tuple[float, float]], rows: list[float]
) -> dict[tuple[Any, Any], float]:
    """Return the height at which each edge over the middle column passes between its boxes, side by side."""
    gaps: dict[float, list[tuple[Any, Any]]] = {}
    free = [max(rows) + 0.5, *(row - 0.5 for row in rows)]
    for child, parent in edges:
        straight = (places[child][1] + places[parent][1]) / 2
        gaps.setdefault(min(free, key=lambda gap: abs(gap - straight)), []).append((child, parent))
    heights: dict[tuple[Any, Any], float] = {}
    for gap, those in gaps.items():
        those.sort(key=lambda edge: -places[edge[1]][1])
        apart = min(_APART, 2 * _GAP / len(those))
        heights |= {edge: gap + ((len(those) - 1) / 2 - place) * apart for place, edge in enumerate(those)}
    return heights


def _pass(axes: Any, start: tuple[float, float], middle: tuple[float, float], height: float) -> tuple[float, float]:
    """Draw a line past the middle column at a height; return where it ends."""
    from matplotlib.patches import PathPatch  # noqa: PLC0415 - an extra
    from matplotlib.path import Path  # noqa: PLC0415

    (first, last), half = middle, (start[0] + middle[0]) / 2
    points = [start, (half, start[1]), (half, height), (first, height), (last, height)]
    codes = [Path.MOVETO, Path.CURVE4, Path.CURVE4, Path.CURVE4, Path.LINETO]
    axes.add_patch(PathPatch(Path(points, codes), edgecolor="#888888", facecolor="none", lw=1.0, zorder=1))
    return last, height


def _columns(network: TwoSliceNetwork) -> list[dict[Any, tuple[str, str]]]:
    """Return the variables from left to right, each with its label and colour."""
    columns: list[dict[Any, tuple[str, str]]] = [{}, {}, {}]
    order: tuple[tuple[int, Role], ...] = ((0, "state"), (0, "action"), (1, "next_state"), (2, "observation"))
    for column, role in order:
        for place in range(len(network.factors(role))):
            node = Node(role, place)
            columns[column][node] = (network.name(node), _COLOURS[role])
    for index in range(len(network.utilities)):
        columns[2][index] = (f"reward {index + 1}", _REWARD)
    return columns
