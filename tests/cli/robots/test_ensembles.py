"""The wiring of a file's ensembles, as `mdm info` prints it."""

from __future__ import annotations

import json

import pytest
from places import DATA


def test_info_prints_the_wiring(mdm):
    status, lines, _ = mdm("info", DATA / "patrol" / "patrol.toml")
    told = [line.strip() for line in lines]
    assert status == 0
    assert told[told.index("state fire") + 1 :][:2] == ["no  <- not FireIsConfirmed", "yes <- FireIsConfirmed"]
    camera = ["Clear    <- SeesClear", "Smoke    <- SeesSmoke", "Reported <- Report.succeeded"]
    assert told[told.index("observation camera") + 1 :][:3] == camera
    assert "Patrol      -> ensemble patrol" in told
    assert "GoLab    -> building:go_lab" in told
    assert "FireIsConfirmed     <- set by Report.succeeded, reset by Emergency.succeeded" in told
    facts = json.loads(mdm("info", DATA / "patrol" / "patrol.toml", "--json")[1][0])
    wiring = facts["ensembles"][0]["wiring"]
    assert wiring["states"]["person"]["no"] == {"from": "not PersonIsWaiting", "idle": False}
    assert wiring["actions"]["Assistance"] == "building:assist"
    assert facts["definitions"]["SeesSmoke"] == "raised by code"


MODEL = """discount: 0.9
values: reward
states: clean_ok clean_low dirty_ok dirty_low
actions: go
T: go identity
R: go : * : * : * 1
"""
TWO = """
[predicates]
FloorDirty = {}
BatteryLow = {}
[ensembles.robot]
model = "m.mdp"
policy = [0, 0, 0, 0]
states = { %s }
actions = { go = "robot:go" }
"""


@pytest.mark.parametrize(
    ("factors", "first_low"),
    [
        ('dirty = ["FloorDirty"], low = ["BatteryLow"]', "not FloorDirty and BatteryLow"),
        ('low = ["BatteryLow"], dirty = ["FloorDirty"]', "not BatteryLow and FloorDirty"),
    ],
)
def test_the_states_that_factors_make_up_by_their_order_are_told(mdm, tmp_path, factors, first_low):
    (tmp_path / "m.mdp").write_text(MODEL)
    (tmp_path / "robot.py").write_text("def go(): ...\n")
    file = tmp_path / "r.toml"
    file.write_text(TWO % factors)
    status, lines, _ = mdm("check", file)
    assert status == 0
    assert any(line.endswith(f"state 'clean_low' is {first_low}") for line in lines)
    told = [" ".join(line.split()) for line in mdm("info", file)[1]]
    assert f"clean_low <- {first_low}" in told
    facts = json.loads(mdm("info", file, "--json")[1][0])
    joint = facts["ensembles"][0]["wiring"]["joint_states"]
    assert list(joint) == ["clean_ok", "clean_low", "dirty_ok", "dirty_low"]
    assert joint["clean_low"] == first_low


def test_factors_by_symbol_over_flat_states_are_offered_one_over_formulas(mdm, tmp_path):
    (tmp_path / "m.mdp").write_text(MODEL)
    (tmp_path / "robot.py").write_text("def go(): ...\n")
    (tmp_path / "r.toml").write_text(TWO % 'dirty = { yes = "FloorDirty" }, low = ["BatteryLow"]')
    status, _, errors = mdm("check", tmp_path / "r.toml")
    assert status == 1
    assert "give lists, or one factor with a predicate for each of the 4, defined by a formula" in errors
