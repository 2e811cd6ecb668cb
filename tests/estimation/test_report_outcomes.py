"""What ended a child: its success, by which the ensemble above it went on, is its model's last step."""

from __future__ import annotations

import numpy as np
import pytest
from estimated import nothing

import mdm
from mdm.estimation import as_text, chains_of_records, open_records, statistics
from mdm.messages import ActionLife
from mdm.models import MDP

ENDS = ["succeeded", "blocked", "failed", "blocked", "succeeded", "blocked", "succeeded"] * 3
"""How each `go` ends: through the door, at a person in it, or stuck."""


def door(through, *, ends=True):
    going = [[0.7 * (1 - through), 0.3 * (1 - through), through], [0.3, 0.7, 0.0], [0.0, 0.0, 1.0]]
    waiting = [[0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.0, 0.0, 1.0]]
    if not ends:
        going[2] = waiting[2] = [0.5, 0.0, 0.5]
    names = {"states": ["free", "blocked", "through"], "actions": ["go", "wait"]}
    return MDP([going, waiting], np.zeros((3, 2)), discount=0.9, **names)


@pytest.fixture(scope="module")
def chains(tmp_path_factory):
    """Record a robot that is sent through a door, again and again; above it nothing waits for what it sees then."""
    path, left = tmp_path_factory.mktemp("door") / "run.mcap", list(ENDS)

    async def main():
        async with mdm.Runtime(record=path, log=False) as runtime:

            async def go():
                await runtime.clock.sleep(1)
                end = left.pop(0)
                if end == "failed":
                    raise RuntimeError("stuck")
                if end == "blocked":
                    child.publish_state(1)
                    await runtime.clock.sleep(1_000)

            async def wait():
                await runtime.clock.sleep(1)
                child.publish_state(0)
                await runtime.clock.sleep(1_000)

            def hear(life):
                if (life.action, life.status) == ("go", "succeeded"):
                    top.publish_state(1)

            child = mdm.Ensemble("child", policy=[0, 1, 0], model=door(0.3), actions={"go": go, "wait": wait})
            top = mdm.Ensemble("top", policy=[0, 1], actions={0: child, 1: nothing})
            await runtime.start(top)
            runtime.channel("top/child/lives", ActionLife).subscribe(hear)
            while left:
                child.publish_state(0)
                top.publish_state(0)
                await runtime.clock.sleep(20)

    mdm.run(main, virtual=True)
    return chains_of_records(open_records([path]), "child")


def test_the_success_that_ended_a_child_is_its_last_step(chains):
    report = statistics(chains, door(0.3))
    (row,) = [row for row in report.rows if (row.action, row.state) == ("go", "free")]
    counts = {entry.symbol: entry.count for entry in row.entries}
    assert counts == {"blocked": ENDS.count("blocked"), "through": ENDS.count("succeeded")}
    assert report.decisions == chains.decisions + ENDS.count("succeeded")
    assert not [note for note in report.notes if "outcome" in note]


def test_where_nothing_says_what_the_outcome_is_that_is_said(chains):
    report = statistics(chains, door(0.3, ends=False))
    (row,) = [row for row in report.rows if (row.action, row.state) == ("go", "free")]
    assert {entry.symbol: entry.count for entry in row.entries} == {"blocked": ENDS.count("blocked"), "through": 0}
    assert f"{ENDS.count('succeeded')} times the success of an action ended 'child' before" in report.notes[-1]


def test_failures_are_counted_by_state(chains):
    report = statistics(chains, door(0.3))
    told = {(action, state, end): count for action, state, end, count in report.ends}
    assert told["go", "free", "failed"] == ENDS.count("failed")
    assert told["go", "free", "succeeded"] == ENDS.count("succeeded")
    assert f"free, go: {ENDS.count('failed')} failed, " in as_text(report)
    assert "blocked, wait" not in as_text(report).partition("actions that failed")[2]
