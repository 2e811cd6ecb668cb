"""Draws the pictures of the tutorial from what its programs do: python docs/pictures/tutorial.py [FOLDER]."""

from __future__ import annotations

import contextlib
import io
import math
import re
import runpy
import sys
from html import escape
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from PIL import Image

from mdm.messages import PoseUpdate
from mdm.views.canvas import pyplot
from mdm.views.figures import grid_figure
from mdm.views.floor import FloorView, Mark

HERE = Path(__file__).parent
STEPS = HERE.parent.parent / "examples" / "tutorial"
sys.path.insert(0, str(STEPS))
import floor  # noqa: E402 - what the programs share lies beside them

_WIDE, _LEFT, _RIGHT, _ROW = 760, 130, 20, 40
_COLOURS = {
    **dict.fromkeys(("true", "running", "deciding", "poses come"), "#bfe0c8"),
    **dict.fromkeys(("false", "safe"), "#f6cdb8"),
    **dict.fromkeys(("unknown", "none come"), "#d8d8d8"),
    **dict.fromkeys(("listen", "open-left", "open-right"), "#cfe2f3"),
}
_FAR = 0.5
"""Metres over which the direction of a robot is told: its poses are noisy."""
_INK, _LINE = "#12283f", "#2a5a8c"


class Run(NamedTuple):
    """A program that has run: what it has printed, by its times, and where its robot was."""

    told: list[tuple[float, str]]
    poses: list[tuple[float, float, float, bool]]
    names: dict[str, Any]


class Bar(NamedTuple):
    """A span of time in a row, with a text in it."""

    start: float
    end: float
    text: str


def run(step: str) -> Run:
    """Run a program of the tutorial in virtual time."""
    poses: list[tuple[float, float, float, bool]] = []
    start = floor.Robot.start

    async def watched(robot: Any, runtime: Any) -> None:
        runtime.channel("building/robot/pose", PoseUpdate).subscribe(
            lambda pose: poses.append((pose.time / 1e9, pose.x, pose.y, robot.lost))
        )
        await start(robot, runtime)

    floor.Robot.start = watched
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed):
            names = runpy.run_path(str(STEPS / f"{step}.py"), run_name="__main__")
    finally:
        floor.Robot.start = start
    lines = re.findall(r"^ *([\d.]+) s  (.*)$", printed.getvalue(), re.MULTILINE)
    return Run([(float(seconds), text) for seconds, text in lines], poses, names)


def bars(changes: list[tuple[float, str]], end: float) -> list[Bar]:
    """Return values that last until the next one, from their changes."""
    return [Bar(at, until, value) for (at, value), (until, _) in pairwise([*changes, (end, "")]) if until > at]


def svg(high: int, about: str, parts: list[str]) -> str:
    """Return a picture, on a ground of its own: it is read on light and dark pages."""
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDE} {high}" font-family="sans-serif"'
    ground = f'<rect width="{_WIDE}" height="{high}" rx="8" fill="#ffffff"/>'
    return "\n".join([f'{head} font-size="15" role="img" aria-label="{escape(about)}">', ground, *parts, "</svg>\n"])


def text(x: float, y: float, words: str, anchor: str = "middle", ink: str = _INK) -> str:
    """Return words in a picture."""
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" fill="{ink}">{escape(words)}</text>'


def timeline(about: str, rows: dict[str, list[Bar]], end: float, tick: float) -> str:
    """Return a picture of rows of bars over seconds."""
    scale, bottom = (_WIDE - _LEFT - _RIGHT) / end, 20 + _ROW * len(rows)
    parts = []
    for row, (name, spans) in enumerate(rows.items()):
        top = 16 + _ROW * row
        parts.append(text(_LEFT - 12, top + 20, name, "end"))
        for span in spans:
            x, wide = _LEFT + scale * span.start, scale * (span.end - span.start)
            colour = _COLOURS[span.text.partition(",")[0]]
            box = f'<rect x="{x:.1f}" y="{top}" width="{wide:.1f}" height="28" rx="3"'
            parts.append(f'{box} fill="{colour}" stroke="{_LINE}"/>')
            fits = wide > 7 * len(span.text)
            at = x + wide / 2 if fits else x + wide + 8
            parts.append(text(round(at, 1), top + 19, span.text, "middle" if fits else "start"))
    parts.append(f'<path d="M{_LEFT} {bottom} H{_WIDE - _RIGHT}" stroke="{_LINE}"/>')
    for number in range(round(end / tick) + 1):
        x = round(_LEFT + scale * number * tick, 1)
        parts.append(f'<path d="M{x:g} {bottom} v6" stroke="{_LINE}"/>')
        parts.append(text(x, bottom + 22, f"{number * tick:g}", ink=_LINE))
    parts.append(text(_LEFT - 12, bottom + 22, "seconds", "end", _LINE))
    return svg(bottom + 34, about, parts)


def predicates() -> str:
    """Step 1: the values of three predicates."""
    changes: dict[str, list[tuple[float, str]]] = {"BatteryLow": [], "IsMoving": [(0.0, "false")], "MayGo": []}
    for at, line in run("step1_predicates").told:
        name, value = line.split(" is ")
        changes[name].append((at, value))
    rows = {name: bars(values, 6.0) for name, values in changes.items()}
    return timeline(
        "BatteryLow is false, then unknown; IsMoving is false, then true; MayGo true, then false", rows, 6.0, 1
    )


def hierarchy() -> str:
    """Step 5: the lives of two actions."""
    lives: dict[str, list[Bar]] = {"Patrol": [], "Answer": []}
    began: dict[str, float] = {}
    for at, line in run("step5_hierarchy").told:
        action, status = line.split()
        if status == "running":
            began[action] = at
        else:
            lives[action].append(Bar(began[action], at, f"running, then {status}"))
    return timeline("Patrol runs and is pre-empted; Answer runs and succeeds; Patrol runs again", lives, 90.0, 10)


def belief() -> str:
    """Step 6: the probability of one of two states, and what is decided on it."""
    told = re.compile(r"left with probability ([\d.]+): (.*)")
    steps = [(at, *told.match(line).groups()) for at, line in run("step6_belief").told]  # type: ignore[union-attr]
    wide, high = (_WIDE - _LEFT - _RIGHT) / len(steps), 130
    parts = [text(_LEFT - 12, y, words, "end") for y, words in ((24, "1"), (22 + high, "0"), (50 + high, "action"))]
    parts += [text(_LEFT - 12, 14 + high / 2, "probability", "end"), text(_LEFT - 12, 33 + high / 2, "of left", "end")]
    for at, probability, action in steps:
        x, tall = _LEFT + wide * at, high * float(probability)
        box = f'<rect x="{x + 6:.1f}" y="{18 + high - tall:.1f}" width="{wide - 12:.1f}" height="{tall:.1f}"'
        parts.append(f'{box} fill="{_COLOURS[action]}" stroke="{_LINE}"/>')
        middle = round(x + wide / 2, 1)
        parts += [text(middle, 12 + high, probability), text(middle, 50 + high, action)]
        parts.append(text(middle, 72 + high, f"{at:g} s", ink=_LINE))
    parts.append(f'<path d="M{_LEFT} {18 + high} H{_WIDE - _RIGHT}" stroke="{_LINE}"/>')
    return svg(high + 84, "After each look the belief grows, and at 97 percent a door is opened", parts)


def safety() -> str:
    """Step 7: whether poses come, and the mode."""
    done = run("step7_safety")
    end = 30.0
    lost = [(at, "none come" if lost else "poses come") for at, _, _, lost in done.poses]
    changes = [lost[0], *((at, value) for (_, before), (at, value) in pairwise(lost) if value != before)]
    modes = [(at, line.split()[0]) for at, line in done.told]
    rows = {"localisation": bars(changes, end), "mode": bars(modes, end)}
    return timeline("Shortly after poses cease to come the mode is safe; when they come again, deciding", rows, end, 5)


def drive(step: str) -> Image.Image:
    """Steps 2 and 4: where the robot was, on the floor."""
    trail = [(x, y) for _, x, y, _ in run(step).poses]
    x, y = trail[-1]
    before = next(point for point in reversed(trail) if math.dist(point, (x, y)) > _FAR)
    robot = Mark(x, y, yaw=math.atan2(y - before[1], x - before[0]))
    picture: Image.Image = FloorView(floor.FLOOR).image([robot], trail=trail, size=760)
    return picture


def policy() -> Image.Image:
    """Step 3: the values of all states, and the actions in them."""
    names = run("step3_model").names
    figure, file = grid_figure(names["patrol"], names["solution"].policy, None, None), io.BytesIO()
    figure.savefig(file, format="png", dpi=100, bbox_inches="tight")
    pyplot().close(figure)
    return Image.open(file).convert("RGB")


TEXTS = {"step1.svg": predicates, "step5.svg": hierarchy, "step6.svg": belief, "step7.svg": safety}
"""The pictures that are text."""


def main(folder: Path = HERE / "tutorial") -> None:
    """Write all pictures."""
    folder.mkdir(exist_ok=True)
    for name, draw in TEXTS.items():
        (folder / name).write_text(draw(), encoding="utf-8")
    images = {"step2.png": drive("step2_states"), "step3.png": policy(), "step4.png": drive("step4_actions")}
    for name, image in images.items():
        image.quantize(256, Image.Quantize.MAXCOVERAGE).save(folder / name, optimize=True)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
