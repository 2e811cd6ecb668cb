"""The wiring of a file's ensembles, as `mdm info` prints it."""

from __future__ import annotations

import json

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
