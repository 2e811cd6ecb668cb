"""`mdm team decisions`: files of decisions, compared."""

from __future__ import annotations

import asyncio
import json

import msgspec
import pytest
from team_robots import over_beliefs, started
from teams import team as random_team

from mdm.cli.team.decisions import read, tell
from mdm.team.decisions import Line
from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.testing import run_virtual


def line(agent, step, time, *, term=(1, "a", 5), **more):
    told = Line(
        agent=agent,
        ensemble="joint",
        term=term,
        step=step,
        time=time,
        input={"a": "hear"},
        missing=(),
        action="listen",
        digest=f"digest {step}",
    )
    return msgspec.json.encode(msgspec.structs.replace(told, **more)) + b"\n"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "a.jsonl").write_bytes(line("a", 1, 10.0) + line("a", 2, 10.5))
    (tmp_path / "b.jsonl").write_bytes(
        line("b", 1, 10.1) + line("b", 2, 10.6) + line("b", 3, 12.0, term=(2, "b", 6)) + b'{"agent": "b", "ens'
    )
    return tmp_path


def test_it_says_what_is_the_same_and_how_long_nothing_was_decided(mdm, folder):
    status, out, errors = mdm("team", "decisions", folder)
    assert (status, errors) == (0, "")
    first, second = "term 1, which 'a' leads", "term 2, which 'b' leads"
    assert out == [
        "joint: 3 steps (2 of a, 3 of b)",
        "  2 of them told by more than one agent, the same at all of them",
        f"  longest time without a decision: 1.500 s, from step 2 of {first}, to step 3 of {second}",
    ]


def test_it_says_what_differs_first(mdm, folder):
    with (folder / "c.jsonl").open("ab") as file:
        file.write(line("c", 1, 10.2) + line("c", 2, 10.3, action="open"))
    status, out, _ = mdm("team", "decisions", folder / "a.jsonl", folder / "c.jsonl")
    assert status == 1
    assert out[1:3] == [
        "  2 of them told by more than one agent, and 1 of these differ",
        "  first: step 2 of term 1, which 'a' leads: action is 'open' at 'c' and 'listen' at 'a'",
    ]
    assert out[3] == "  (agents of a communicating team decide each on what it knows, and may differ; others may not)"
    status, out, _ = mdm("team", "decisions", folder, "--json")
    assert status == 1
    told = json.loads(out[0])["joint"]
    assert told["differing"] == 1
    assert told["pause"] == pytest.approx(1.7)


def test_after_a_stop_nobody_is_to_decide(folder):
    (folder / "a.jsonl").write_bytes(line("a", 1, 1.0, command="stop") + line("a", 2, 9.0) + line("a", 3, 9.5))
    assert tell(read([folder / "a.jsonl"]))["joint"].pause == 0.5


def test_steps_that_an_agent_caught_up_with_are_not_its_own(mdm, tmp_path):
    """It was away for them: they count for no agent's time between decisions."""
    (tmp_path / "a.jsonl").write_bytes(b"".join(line("a", step, 10.0 + 0.2 * step) for step in range(1, 11)))
    again = [line("b", step, 12.0, caught_up=True) for step in range(2, 10)]
    (tmp_path / "b.jsonl").write_bytes(b"".join([line("b", 1, 10.2), *again, line("b", 10, 12.19)]))
    status, out, _ = mdm("team", "decisions", tmp_path)
    assert (status, out[0]) == (0, "joint: 10 steps (10 of a, 10 of b, 8 of them caught up)")
    assert out[2].startswith("  longest time without a decision: 0.200 s")
    assert out[3] == "  longest at one agent: 1.990 s at b"
    told = json.loads(mdm("team", "decisions", tmp_path, "--json")[1][0])["joint"]
    assert told["caught_up"] == {"a": 0, "b": 8}
    assert told["pauses"] == {"a": pytest.approx(0.2), "b": pytest.approx(1.99)}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "none.jsonl: No such file or directory"),
        (b"", "there is no decision in"),
        (b'{"agent": "a"}\n', "line 1: this is no decision of a team: Object missing required field `ensemble`"),
        (b"garbage\n", "line 1: this is no decision of a team"),
        (b"\xff\xfe\n", "line 1: this is no decision of a team"),
    ],
)
def test_what_is_no_file_of_decisions_is_refused(mdm, tmp_path, content, words):
    path = tmp_path / "none.jsonl"
    if content is not None:
        path.write_bytes(content)
    status, _, errors = mdm("team", "decisions", path)
    assert status == 1
    assert words in errors
    assert "Traceback" not in errors


EVENTS = 0.02


@pytest.mark.parametrize("phase", [0.0, 0.05, 0.099])
@pytest.mark.parametrize(("period", "lease"), [(0.1, 0.5), (0.5, 0.2), (None, 0.5)])
def test_without_its_leader_a_team_decides_nothing_for_a_lease_and_two_periods_at_most(tmp_path, phase, period, lease):
    names = ["a", "b", "c"]

    async def main(runtime):
        network = Network(runtime.clock, team="team", lease=lease)
        team = Team("team", names, period=period, lease=lease)
        build = over_beliefs(random_team(7, agents=3))
        robots = await started(
            runtime, team, network, build, member=lambda name: {"decisions": tmp_path / f"{name}.jsonl"}
        )

        async def observe():
            while True:
                robots[1].observe(None, 0, None)
                await asyncio.sleep(EVENTS)

        observing = asyncio.create_task(observe())
        await asyncio.sleep(3 + phase)
        assert robots[0].role == "leading"
        network.crash("a")
        await runtime.stop(robots[0].member)
        await asyncio.sleep(4.0)
        observing.cancel()
        for robot in robots[1:]:
            await runtime.stop(robot.member)

    run_virtual(main)
    lines = read([tmp_path])
    assert {line.term[1] for line in lines} == {"a", "b"}
    told = tell(lines)["joint"]
    assert told.differing == 0
    assert lease <= told.pause + 1e-6
    assert told.pause <= lease + 2 * (period or EVENTS) + 1e-6
