"""A run in a terminal: the same frames as a page shows, as text of rich."""

from __future__ import annotations

import importlib
from collections import deque
from itertools import islice
from typing import TYPE_CHECKING, Any

from mdm.errors import Error

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.snapshots import EnsembleFrame, Event, Frame, Scene

_SIGNS = {"deciding": "▶", "safe": "■", "stopped": "○", "waiting": "…", "idle": "-"}
_COLOURS = {"deciding": "green", "safe": "bold red", "stopped": "bright_black", "waiting": "yellow", "idle": "yellow"}
_BARS = 20
_EVENTS = 100_000
_ALARMS = 4


def rich() -> Any:
    """Return the parts of rich that are needed.

    Raises:
        Error: If it is not installed.
    """
    try:
        parts = {
            name: getattr(importlib.import_module(f"rich.{module}"), name)
            for module, name in (
                ("console", "Console"),
                ("console", "Group"),
                ("live", "Live"),
                ("table", "Table"),
                ("text", "Text"),
            )
        }
    except ImportError:
        raise Error("to watch in a terminal needs rich: pip install rich websockets") from None
    return type("Rich", (), parts)


def seconds(time: float) -> str:
    """Return a time as minutes and seconds."""
    return f"{int(time) // 60:02}:{time % 60:04.1f}"


def standing(frame: EnsembleFrame) -> str:
    """Return the mode of an ensemble, or that it waits or has nothing to do."""
    if frame.mode == "deciding" and frame.waiting:
        return "waiting"
    return "idle" if frame.mode == "deciding" and frame.idle is not None else frame.mode


class Terminal:
    """Draws frames of a run as text.

    Args:
        scene: The run.

    Attributes:
        selected: The place of the ensemble at close range.
        scene: The run.
    """

    def __init__(self, scene: Scene) -> None:
        self._rich = rich()
        self._events: deque[Event] = deque(maxlen=_EVENTS)
        self.scene = scene
        self.selected = 0

    @property
    def close(self) -> tuple[str, ...]:
        """The path of the ensemble at close range."""
        ensembles = self.scene.ensembles
        return (ensembles[self.selected].path,) if self.selected < len(ensembles) else ()

    def choose(self, by: int) -> None:
        """Choose another ensemble, so many places further down."""
        self.selected = max(0, min(len(self.scene.ensembles) - 1, self.selected + by))

    def hear(self, events: Sequence[Event]) -> None:
        """Take events in, but for changes of predicates, which have a line of their own."""
        self._events.extend([event for event in events if event.kind != "predicate"])

    def picture(self, frame: Frame, *, height: int = 40, status: str = "") -> Any:
        """Return a frame as an object that rich prints.

        Args:
            frame: The frame.
            height: The lines that there are.
            status: Text at the top.
        """
        remarks = [self._text((f"Note: {text}", "yellow")) for text in self.scene.remarks]
        whole = f" of {seconds(self.scene.last)}" if self.scene.source == "record" else ""
        head = self._text(
            (f"{self.scene.title or 'robot'}  ", "bold"), (f"{seconds(frame.time)}{whole}  ", ""), (status, "cyan")
        )
        parts = [head, *remarks, *self._alarms(frame), self._tree(frame, max(4, height // 3))]
        parts += self._detail(frame)
        left = max(3, height - sum(self._lines(part) for part in parts) - 2)
        parts += [self._predicates(frame, max(2, left // 2)), self._last(frame.time, max(2, left // 2))]
        return self._rich.Group(*parts)

    @staticmethod
    def _lines(part: Any) -> int:
        if getattr(part, "no_wrap", None) is False:
            return 2  # a sentence on a screen that is not wide
        return int(getattr(part, "row_count", 1)) or 1

    def _text(self, *pieces: tuple[str, str]) -> Any:
        text = self._rich.Text(no_wrap=True, overflow="ellipsis")
        for piece, style in pieces:
            text.append(piece, style=style)
        return text

    def _table(self, columns: int) -> Any:
        table = self._rich.Table.grid(padding=(0, 1))
        for _ in range(columns):
            table.add_column(no_wrap=True, overflow="ellipsis")
        return table

    def _alarms(self, frame: Frame) -> list[Any]:
        """Return the judgements, the worst first, with evidence and remedy; green where nothing is named."""
        shown = [each for each in frame.judgements if each.until is None or frame.judgements[0].until is not None]
        if not frame.headline:
            earlier = f"; earlier: {frame.judgements[0]}" if frame.judgements else ""
            return [self._text((f"✓ nothing is named{earlier}", "green"))]
        found = []
        for place, each in enumerate(shown[:_ALARMS]):
            sign, style = ("✕", "bold red") if each.severity == "wrong" else ("?", "bold yellow")
            words = frame.headline if place == 0 else str(each)
            text = self._text((f"{sign} {words} ", style), (f"{each.evidence} → {each.remedy}", style.split()[1]))
            text.no_wrap = False
            found.append(text)
        return found

    def _tree(self, frame: Frame, most: int) -> Any:
        table = self._table(5)
        depths: list[int] = []
        for of in self.scene.ensembles:
            depths.append(0 if of.parent < 0 else depths[of.parent] + 1)
        first = max(0, min(self.selected - most // 2, len(depths) - most))
        pairs = list(zip(self.scene.ensembles, frame.ensembles, depths, strict=False))
        for place, (of, each, depth) in list(enumerate(pairs))[first : first + most]:
            how = standing(each)
            above = "" if of.parent < 0 else self.scene.ensembles[of.parent].path
            live = ", ".join(life.action for life in each.live) or each.action
            live += f" (its shield: in place of {each.wanted})" if each.wanted else ""
            standing_since = {"idle": each.idle, "waiting": None}.get(how, each.since)
            since = each.live[-1].since if each.live else standing_since
            table.add_row(
                ">" if place == self.selected else " ",
                self._text(("  " * depth + of.path[len(above) :].lstrip("/"), "bold")),
                self._text((f"{_SIGNS.get(how, '?')} {how}", _COLOURS.get(how, ""))),
                self._text((live + (f"  waits for {', '.join(each.waiting)}" if each.waiting else ""), "")),
                self._text(("" if since is None else f"{max(0.0, frame.time - since):.1f} s", "bright_black")),
            )
        return table

    def _detail(self, frame: Frame) -> list[Any]:
        detail = frame.details.get(self.close[0]) if self.close else None
        if detail is None:
            return []
        told = [
            (name, value)
            for name, value in (
                ("state", ", ".join(f"{name} {value or '?'}" for name, value in detail.factors) or detail.state),
                ("observed", detail.observation),
                ("so far", ", ".join(f"{name} {count}" for name, count in detail.tally[:4]) or None),
                ("reward", None if detail.reward is None else f"{detail.reward:.4g}"),
                ("return", None if detail.value is None else f"{detail.value:.4g}"),
                ("decided", detail.cause or None),
            )
            if value is not None
        ]
        parts = [
            self._text((f"{self.close[0]}: ", "bold"), ("   ".join(f"{name} {value}" for name, value in told), ""))
        ]
        if detail.belief is not None:
            table = self._table(3)
            shown = [(state, chance) for state, chance in detail.belief.top[:6] if chance >= 0.0005]
            if detail.belief.rest > 0.0005:
                shown.append(("others", detail.belief.rest))
            for state, chance in shown:
                filled = round(_BARS * chance)
                table.add_row(
                    state,
                    self._text(("█" * filled, "blue"), ("░" * (_BARS - filled), "bright_black")),
                    f"{chance:6.1%}",
                )
            parts.append(table)
        return parts

    def _predicates(self, frame: Frame, most: int) -> Any:
        found = []
        for of, value, changed in zip(self.scene.predicates, frame.predicates, frame.changed, strict=False):
            if value is not False:
                sign, style = ("●", "green") if value else ("?", "yellow")
                found.append((changed, (f"{sign} {of.name} ", style)))
        found.sort(key=lambda pair: -pair[0])
        false = sum(value is False for value in frame.predicates)
        shown = [piece for _, piece in found[: 6 * most]]
        text = self._text(("predicates ", "bold"), *shown, (f"and {false} false" if false else "", "bright_black"))
        text.no_wrap = False
        return text

    def _last(self, time: float, most: int) -> Any:
        table = self._table(4)
        table.expand, table.columns[-1].ratio = True, 1  # a long sentence is cut, not all that stands before it
        past = (event for event in reversed(self._events) if event.time <= time + 1e-6)
        for event in [*islice(past, most)][::-1]:
            style = "red" if event.kind == "fault" or event.status in {"failed", "timed_out", "abandoned"} else ""
            words = f"{event.status} {event.detail}".strip() + (f" → {event.remedy}" if event.remedy else "")
            sign, name = "⚠ " * (event.kind == "fault"), event.name
            if event.kind == "judgement":
                style, sign, words = "yellow", "? ", event.detail
                name = event.name if event.status == "begins" else f"{event.name}: over"
            table.add_row(
                self._text((seconds(event.time), "bright_black")),
                self._text((event.source, "")),
                self._text((f"{sign}{name}", style or "bold")),
                self._text((words, style)),
            )
        return table
