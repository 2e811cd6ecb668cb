"""Commits as lines of JSON."""

from __future__ import annotations

import json

from mdm.team.decisions import Committed


def committed(**changed):
    given = {
        "time": 1_500_000_000,
        "agent": "left",
        "ensemble": "joint",
        "term": (2, "left", 7),
        "step": 3,
        "input": {"left": "hear-left", "right": ("a", None)},
        "missing": ("third",),
        "command": None,
        "action": "listen listen",
        "digest": "abc",
    }
    return Committed(**(given | changed))


def test_a_line_has_everything_in_names():
    assert json.loads(committed().line()) == {
        "agent": "left",
        "ensemble": "joint",
        "term": [2, "left", 7],
        "step": 3,
        "time": 1.5,
        "input": {"left": "hear-left", "right": ["a", None]},
        "missing": ["third"],
        "action": "listen listen",
        "digest": "abc",
    }
    assert json.loads(committed(caught_up=True).line())["caught_up"] is True
    assert committed().line().endswith(b"}\n")


def test_a_command_is_told_where_there_is_one():
    assert json.loads(committed(command="reset", input={}).line())["command"] == "reset"
