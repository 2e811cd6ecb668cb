"""The console of a team: each line with its agent."""

from __future__ import annotations

import json

from mdm.cli.team.crew import Console


def said(capfd, *, json):
    console = Console(["ada", "bo"], json=json)
    console.open()
    console.line("ada", "output", "hello")
    console.record("bo", {"event": "running", "level": "info", "actor": "bo"})
    console.line("bo", "log", "no record")
    console.tell("bo", "failed", "has failed", status=3)
    assert console.close() == 0
    return capfd.readouterr()


def test_lines_for_people(capfd):
    output, errors = said(capfd, json=False)
    assert output == "ada | hello\n"
    first, second, third = errors.splitlines()
    assert first.split() == ["bo", "|", "[info", "]", "running", "actor=bo"]
    assert (second, third) == ("bo  | no record", "bo  | * has failed")


def test_lines_for_programs(capfd):
    output, errors = said(capfd, json=True)
    assert json.loads(output) == {"agent": "ada", "event": "output", "text": "hello"}
    assert [json.loads(line) for line in errors.splitlines()] == [
        {"agent": "bo", "event": "running", "level": "info", "actor": "bo"},
        {"agent": "bo", "event": "log", "text": "no record"},
        {"agent": "bo", "event": "failed", "text": "has failed", "status": 3},
    ]
