"""A robot beside stairs: the policy that is worth most falls down them, and a shield keeps it off.

With the name of a file, as in ``python stairs.py stairs.svg``, it draws the policies.
"""

import sys
from pathlib import Path
from typing import Any

import mdm

FLOOR = (
    "D.....G",
    ".|###|.",
    ".|||||.",
    ".......",
)
"""The dock, the goal, stairs, and walls."""
KINDS = {"D": "dock", "G": "goal", "#": "stairs", ".": "floor"}
PLACES = {
    f"{KINDS[kind]}-{row}-{column}": (row, column)
    for row, line in enumerate(FLOOR)
    for column, kind in enumerate(line)
    if kind != "|"
}
NAMES = {place: name for name, place in PLACES.items()}
MOVES = {"up": (-1, 0), "right": (0, 1), "down": (1, 0), "left": (0, -1)}
ARROWS = dict(zip(MOVES, "↑→↓←", strict=True))
SLIPS = 0.1
"""The probability of each of the two moves to the side instead of the one that is wanted."""


def move(place: str, action: str) -> str | list[tuple[str, float]]:
    if place.startswith(("stairs", "goal")):
        return place
    (row, column), (down, across) = PLACES[place], MOVES[action]
    ways = [(down, across, 1 - 2 * SLIPS), (across, down, SLIPS), (-across, -down, SLIPS)]
    return [(NAMES.get((row + dy, column + dx), place), chance) for dy, dx, chance in ways]


def reward(place: str, action: str, following: str) -> float:  # noqa: ARG001 - a fall costs the same by each action
    """Each step costs 1 and a fall 5; the goal is worth 10, so that a long way round is worth less than the danger."""
    if place.startswith(("stairs", "goal")):
        return 0
    return {"goal": 10, "stairs": -5}.get(following.split("-", maxsplit=1)[0], 0) - 1


def text(policy: Any) -> str:
    """The floor, with the action in each place."""
    lines = []
    for row, line in enumerate(FLOOR):
        actions = ["" if kind in "|#G" else ACTIONS[policy.action(NAMES[row, at])] for at, kind in enumerate(line)]
        lines.append("".join(ARROWS.get(action, kind) for action, kind in zip(actions, line, strict=True)))
    return "\n".join(lines)


def picture(policies: dict[str, Any], side: int = 48) -> str:
    """The floor under each policy as SVG: the darker a place, the more probable that the robot ever comes there."""
    high = len(FLOOR) * side
    parts = []
    for number, (title, policy) in enumerate(policies.items()):
        top = number * (high + 50) + 34
        parts.append(f'<text x="8" y="{top - 12}" font-size="15">{title}</text>')
        for name, (row, column) in PLACES.items():
            chance = mdm.verify(model, f"P(reach {name})", policy).result.value
            kind, x, y = FLOOR[row][column], 8 + column * side, top + row * side
            colour = {"#": "#b3261e", "G": "#1b7f3b"}.get(kind, "#2a5a8c")
            ink = "white" if chance > 0.5 else "#12283f"
            sign = f"{chance:.0%}" if kind in "#G" else ARROWS[ACTIONS[policy.action(name)]] if chance else ""
            box = f'x="{x}" y="{y}" width="{side}" height="{side}"'
            parts.append(f'<rect {box} fill="white" stroke="{colour}"/>')
            parts.append(f'<rect {box} fill="{colour}" fill-opacity="{0.08 + 0.8 * chance:.2f}"/>')
            middle = f'x="{x + side / 2:g}" y="{y + side / 2 + 5:g}" text-anchor="middle"'
            parts.append(f'<text {middle} font-size="15" fill="{ink}">{sign}</text>')
    wide = len(FLOOR[0]) * side + 16
    size = f'viewBox="0 0 {wide} {len(policies) * (high + 50)}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="sans-serif" fill="#12283f">'
    return "\n".join([head, '<rect width="100%" height="100%" fill="white"/>', *parts, "</svg>", ""])


model = mdm.MDP.from_functions(
    list(PLACES), list(MOVES), transition=move, reward=reward, discount=0.99, initial="dock-0-0"
)
ACTIONS = model.action_space.names
best = mdm.solve(model).policy
stairs = {"avoid": "stairs-*", "keep": "reach goal-*"}
policies: dict[str, Any] = {
    "worth most": best,
    "the same, shielded": mdm.shield(best, model, **stairs),
    "shielded, and solved again": mdm.shield(best, model, **stairs, resolve=True),
}
for title, policy in policies.items():
    falls, arrives = (mdm.verify(model, f"P(reach {x}-*)", policy).result.value for x in ("stairs", "goal"))
    value = mdm.evaluate(model, policy, episodes=1000, seed=1).mean
    print(f"{title}: falls with probability {falls:.3f}, arrives with {arrives:.3f}, is worth {value:.1f}")
    print(text(policy))
if len(sys.argv) > 1:
    Path(sys.argv[1]).write_text(picture(policies), encoding="utf-8")
