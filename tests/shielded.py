"""A house with stairs, a policy of a user's that drives down them, and a file of a robot that has it and a shield."""

from __future__ import annotations

import mdm
from mdm.formats import save_model

STATES = ("home", "landing", "hall", "goal", "stairs")
ACTIONS = ("Wait", "Around", "Straight")
WRONG = (2, 2, 2, 0, 0)
"""Straight on, wherever the robot is: on the landing that is down the stairs."""

_NEXT = {
    ("home", "Straight"): {"landing": 1.0},
    ("landing", "Straight"): {"goal": 0.75, "stairs": 0.25},
    ("landing", "Around"): {"hall": 1.0},
    ("hall", "Straight"): {"goal": 1.0},
    ("hall", "Around"): {"landing": 1.0},
}


def house(initial=None):
    """Return the model of the house."""
    return mdm.MDP.from_functions(
        {"position": STATES},
        ACTIONS,
        transition=lambda state, action: {
            (to,): odds for to, odds in _NEXT.get((state[0], action), {state[0]: 1}).items()
        },
        reward=lambda state, action: float(state[0] in {"landing", "hall"} and action == "Straight"),
        discount=0.9,
        initial=("home",) if initial is None else initial,
    )


SHIELD = 'shield = { avoid = "position = stairs", keep = "reach position = goal" }'
FILE = """
[predicates]
Landing = {{}}
Hall = {{}}
Goal = {{}}
Stairs = {{}}
Home = {{ formula = "not (Landing or Hall or Goal or Stairs)" }}

[ensembles.robot]
model = "house.npz"
policy = {policy}
{shield}
actions = {{ Wait = "house_drives:wait", Around = "house_drives:around", Straight = "house_drives:straight" }}

[ensembles.robot.states]
position = {{ home = "Home", landing = "Landing", hall = "Hall", goal = "Goal", stairs = "Stairs" }}
"""
CODE = """
DRIVEN = []


def wait():
    pass


def around():
    DRIVEN.append("Around")


def straight():
    DRIVEN.append("Straight")
"""


class Kept:
    """A logger that keeps its lines."""

    def __init__(self):
        self.lines = []

    def __getattr__(self, level):
        return lambda event, **fields: self.lines.append((level, event, fields))


def written(folder, shield=SHIELD, policy=WRONG):
    """Write the file, the model and the code into a folder; return the file's path."""
    save_model(house(), folder / "house.npz")
    (folder / "house_drives.py").write_text(CODE)
    path = folder / "robot.toml"
    path.write_text(FILE.format(shield=shield, policy=list(policy)))
    return path


def stand(system, place):
    """Have the sensors say where the robot stands."""
    with system.predicates.batch():
        for each in STATES[1:]:
            system.predicates.sense(each.capitalize(), each == place)
