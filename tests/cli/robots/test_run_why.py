"""``mdm run --why``: why, with each decision of the log."""

from __future__ import annotations

import json

from places import EXAMPLES

import mdm as library
from mdm.cli.robots.run import why_in
from mdm.messages import Decision
from mdm.runtime import Log
from mdm.testing import run_virtual


def lines(errors):
    return [json.loads(line) for line in errors.splitlines() if line.startswith("{")]


def test_each_decision_has_its_line(mdm):
    file = EXAMPLES / "tiger.toml"
    _, _, errors = mdm("run", file, "--virtual", "--epochs", "3", "--why", "--log", "json")
    told = [each for each in lines(errors) if each["event"] in {"decision", "why"}]
    assert [each["event"] for each in told] == ["decision", "why"] * 3
    assert [each["epoch"] for each in told] == [0, 0, 1, 1, 2, 2]
    assert told[1]["values"].startswith("listen 19.37, open-left -26.6")
    assert "then 'open-left'" in told[1]["otherwise"]


def test_nothing_without_it(mdm):
    _, _, errors = mdm("run", EXAMPLES / "tiger.toml", "--virtual", "--epochs", "2", "--log", "json")
    assert not [each for each in lines(errors) if each["event"] == "why"]


class Kept:
    """A log that keeps what is written."""

    def __init__(self):
        self.lines = []

    def write(self, event, facts):
        self.lines.append((event, facts()))


def robot():
    predicates = library.PredicateManager()
    predicates.sensor("Warm")
    return library.Ensemble(
        "robot",
        policy=[0, 1],
        actions={"Rest": lambda: None, "Work": lambda: None},
        predicates=predicates,
        states=[library.StateFactor("warm", {"no": "not Warm", "yes": "Warm"})],
    )


def test_names_are_those_of_the_wiring_and_other_decisions_have_no_line():
    kept, ensemble = Kept(), robot()
    note = why_in(kept, [ensemble])

    def decided(path, epoch, action):
        return Decision(0, path, epoch, "state", 1, None, None, action, "Work", None)

    note(decided("robot", 0, 1))
    ensemble.controller.see(1)
    note(decided("robot", 0, 1))
    note(decided("robot", 1, 1))
    note(decided("robot", 0, 0))
    note(decided("another", 0, 1))
    ((event, facts),) = kept.lines
    assert (event, facts["ensemble"], facts["epoch"]) == ("why", "robot", 0)
    assert facts["otherwise"] == "warm not Warm instead of Warm, then 'Rest'"
    case = ensemble.named(ensemble.controller.case())
    assert case.state_name(1) == "Warm"
    assert ensemble.named(case) is case


def test_a_line_is_written_behind_the_decisions(capsys):
    async def main(runtime):
        log.write("why", lambda: {"answer": 42})

    log = Log("json")
    run_virtual(main, log=log)
    assert {"answer": 42, "event": "why", "level": "info"} in lines(capsys.readouterr().err)
