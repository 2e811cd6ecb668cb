"""The log: which messages are rendered, where, and after what."""

from __future__ import annotations

import asyncio
import json

import pytest
from recorded import Fragile, tell
from sentences import refused

from mdm import MDP, Actor, Ensemble, Error, PredicateManager, Runtime, StateFactor
from mdm.messages import Cause, Decision, Fault, Mode
from mdm.policies import DeterministicPolicy, StatePolicy
from mdm.runtime import Log
from mdm.testing import run_virtual


class Kept:
    """A logger that keeps its lines."""

    def __init__(self):
        self.lines = []

    def __getattr__(self, level):
        return lambda event, **fields: self.lines.append((level, event, fields))


DECISION = Decision(
    1_500_000_000, "robot", 3, "tick", state=1, observation=None, action=0, action_name="Go", belief=None, reward=0.5
)


async def live(runtime):
    await runtime.start(Fragile("actor", [], supervision="stop"))
    runtime.decisions.publish(DECISION)
    await runtime.clock.sleep(2)
    tell(runtime, 1)


@pytest.mark.parametrize("debug", [False, True])
def test_faults_lives_and_at_debug_level_decisions_are_told(debug):
    kept = Kept()
    run_virtual(live, log=kept, debug=debug)
    assert [(level, event) for level, event, _ in kept.lines if event != "decision"] == [
        ("info", "starting"),
        ("info", "running"),
        ("error", "fault"),
        ("info", "stopping"),
        ("info", "failed"),
    ]
    (fault,) = (fields for level, _, fields in kept.lines if level == "error")
    assert (fault["time"], fault["source"], fault["kind"]) == (2.0, "actor", "exception")
    assert fault["detail"].startswith("ValueError: 1 is odd")
    decisions = [(level, fields) for level, event, fields in kept.lines if event == "decision"]
    assert [level for level, _ in decisions] == ["debug"] * debug
    for _, fields in decisions:
        assert (fields["time"], fields["ensemble"], fields["action"]) == (1.5, "robot", "Go")


class Nest(Actor):
    def __init__(self, *children):
        super().__init__("nest")
        for child in children:
            self.add(child)


@pytest.mark.parametrize("debug", [False, True])
def test_of_lives_below_the_top_debug_alone_tells(debug):
    kept = Kept()

    async def main(runtime):
        await runtime.start(Nest(Actor("child")))

    run_virtual(main, log=kept, debug=debug)
    told = [(level, fields["actor"]) for level, event, fields in kept.lines if event == "running"]
    assert told == [("debug", "nest/child")] * debug + [("info", "nest")]


def test_decisions_are_told_in_the_words_that_are_given_for_them():
    kept = Kept()
    run_virtual(live, log=Log(kept, decisions=lambda decision: {"state": f"place {decision.state}"}))
    ((level, fields),) = [(level, fields) for level, event, fields in kept.lines if event == "decision"]
    assert level == "info"
    assert list(fields) == ["time", "ensemble", "epoch", "cause", "state", "action", "reward"]
    assert fields["state"] == "place 1"


def test_json_is_a_record_a_line_on_standard_error(capsys):
    run_virtual(live, log="json")
    output, errors = capsys.readouterr()
    assert output == ""
    records = [json.loads(line) for line in errors.splitlines()]
    assert [record["event"] for record in records] == ["starting", "running", "fault", "stopping", "failed"]
    assert {record["actor"] for record in records if "actor" in record} == {"actor"}
    assert records[2]["level"] == "error"


def test_the_console_gets_a_line_each(capsys):
    run_virtual(live, log="console")
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 5
    assert "1 is odd" in lines[2]
    assert "\x1b" not in lines[2]  # colours are for terminals


@pytest.mark.parametrize("target", ["file", 5, ["console"]])
def test_another_target_is_refused(target):
    with refused(Error):
        Runtime(log=target)


def test_the_cause_of_a_safe_mode_is_told_in_words_once():
    def safe(*causes):
        return Mode(0, "robot", "safe", 0, tuple(Cause(kind, detail, 0) for kind, detail in causes))

    async def main(runtime):
        runtime.faults.publish(Fault(0, "robot", "action", "action 'Go' failed"))
        runtime.modes.publish(safe(("action", "action 'Go' failed")))
        runtime.modes.publish(safe(("action", "action 'Go' failed"), ("end", "the runtime ends")))
        runtime.modes.publish(safe(("end", "the runtime ends")))
        await runtime.clock.sleep(1)

    kept = Kept()
    run_virtual(main, log=kept)
    modes = [(fields["causes"], fields.get("why")) for _, event, fields in kept.lines if event == "safe"]
    assert modes == [("action", None), ("action, end", "the runtime ends"), ("end", None)]


class Broken(StatePolicy):
    num_states, num_actions = 1, 1

    def action(self, state):
        raise KeyError(state)


@pytest.mark.parametrize(
    ("policy", "told"),
    [
        (DeterministicPolicy([0], 1), [("info", "end")]),
        (Broken(), [("warning", "policy"), ("warning", "policy, end")]),
    ],
    ids=["sound", "broken"],
)
def test_an_ordinary_end_is_no_warning(policy, told):
    kept = Kept()
    robot = Ensemble("robot", policy=policy, actions={"0": lambda: None}, safe_action="0")

    async def main(runtime):
        await runtime.start(robot)
        robot.publish_state(0)

    run_virtual(main, log=kept)
    assert [(level, fields["causes"]) for level, event, fields in kept.lines if event == "safe"] == told


def opened_and_shut(log):
    """Run a robot whose door is open, then shut."""
    names = {"states": ["shut", "open"], "actions": ["push", "wait"]}
    model = MDP([[[0, 1], [1, 0]]] * 2, [[0, 1], [1, 0]], discount=0.9, **names)
    predicates = PredicateManager()
    door = predicates.sensor("Open", initial=True)

    async def push():
        await asyncio.sleep(1)

    robot = Ensemble(
        "robot",
        policy=[1, 0],
        model=model,
        predicates=predicates,
        states=[StateFactor("door", ["Open"])],
        actions={"push": push, "wait": lambda: None},
    )

    async def main(runtime):
        await runtime.start(robot)
        await asyncio.sleep(2)
        door.set(False)

    run_virtual(main, log=log)


def test_the_console_shows_decisions_by_names_and_the_ends_of_actions(capsys):
    opened_and_shut("console")
    lines = [line.split("] ")[1].split() for line in capsys.readouterr().err.splitlines()]
    told = [line for line in lines if line[0] in {"decision", "succeeded"}]
    assert told[:3] == [
        ["decision", "ensemble=robot", "state=open", "action=push"],
        ["succeeded", "ensemble=robot", "action=push"],
        ["decision", "ensemble=robot", "state=shut", "action=wait"],
    ]


def test_other_targets_show_no_decisions_nor_does_a_console_that_is_told_not_to(capsys):
    kept = Kept()
    opened_and_shut(kept)
    opened_and_shut(Log("console", decisions=False))
    assert kept.lines
    assert "decision" not in capsys.readouterr().err + str(kept.lines)
