"""A configuration of two ensembles that use all there is, and the code it names."""

from __future__ import annotations

CALLBACKS = """
calls = []
async def sense(system):
    system.predicates.sense("A", True)
async def work():
    calls.append("work")
def rest():
    calls.append("rest")
def not_async(system):
    pass
async def no_argument():
    pass
number = 7
"""


GOOD = """
tasks = ["robot_code:sense"]
[predicates]
A = { initial = false, max_age = 60.0 }
B = "not A"
Long = { formula = "A", held_for = 2.0 }
Seen = { set = "Work.succeeded", reset = "Ping" }
[events]
Ping = {}
Up = "A"
[ensembles.top]
policy = [0, 1]
safe_action = "Rest"
[ensembles.top.states]
b = ["B"]
[ensembles.top.actions]
Below = { ensemble = "below", resume = true }
Rest = "robot_code:rest"
[ensembles.below]
policy = "below.policy"
drive = 2.0
horizon = 5
supervision = { restart = 2 }
[ensembles.below.states]
a = { predicates = ["A"], on_violation = "hold" }
[ensembles.below.actions]
Work = { call = "robot_code:work", timeout = 3.0, grace = 0.5, on_repeat = "restart" }
Rest = "robot_code:rest"
"""
