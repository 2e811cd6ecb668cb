"""Files of decisions."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest
from sentences import refused
from team_robots import Robot, over_beliefs

import mdm
from mdm import problems
from mdm.team.decisions import Decisions
from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.testing import probe, run_virtual


def test_each_step_is_a_line_and_what_was_there_stays(tmp_path):
    path = tmp_path / "left.jsonl"
    path.write_text('{"before": true}\n')

    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        team = Team("tigers", ["left", "right"])
        robot = Robot(team, "left", network, over_beliefs(problems.dec_tiger()))
        ensemble = over_beliefs(problems.dec_tiger())(robot, 0)
        member = team.member("left", ensemble, transport=network.transport("left"), decisions=path)
        await runtime.start(member)
        ensemble.start()
        await asyncio.sleep(1.0)
        ensemble.publish_observation(("hear-left", None))
        await asyncio.sleep(1.0)
        await runtime.stop(member)

    run_virtual(main)
    first, *lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert first == {"before": True}
    assert [(line["step"], line["input"], line["missing"]) for line in lines] == [
        (1, {}, []),
        (2, {"left": "hear-left"}, ["right"]),
    ]
    assert lines[0]["command"] == "start"
    assert [line["action"] for line in lines] == ["listen listen", "open-right open-right"]


def test_a_file_that_cannot_be_written_is_told(tmp_path):
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        team = Team("tigers", ["left", "right"])
        robot = Robot(team, "left", network, over_beliefs(problems.dec_tiger()))
        ensemble = over_beliefs(problems.dec_tiger())(robot, 0)
        member = team.member(
            "left", ensemble, transport=network.transport("left"), decisions=tmp_path / "none" / "left.jsonl"
        )
        with refused(mdm.Error):
            await runtime.start(member)

    run_virtual(main)


def test_nothing_starts_where_the_file_cannot_be_written(tmp_path):
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        team = Team("tigers", ["left", "right"])
        robot = Robot(team, "left", network, over_beliefs(problems.dec_tiger()))
        ensemble = over_beliefs(problems.dec_tiger())(robot, 0, safe_action=robot.act("SAFE"))
        (tmp_path / "left.jsonl").mkdir()
        member = team.member("left", ensemble, transport=network.transport("left"), decisions=tmp_path / "left.jsonl")
        lives = probe(runtime.lives)
        with refused(mdm.Error):
            await runtime.start(member)
        assert {change.actor for change in lives} == {"left", "left/decisions"}
        assert robot.did == []

    run_virtual(main)


def test_an_agent_that_returns_writes_each_step_once(tmp_path):
    path = tmp_path / "right.jsonl"
    model = problems.dec_tiger()

    async def main(runtime):
        network = Network(runtime.clock, team="tigers", lease=0.5)
        team = Team("tigers", ["left", "right"], period=0.5)
        left = await Robot(team, "left", network, over_beliefs(model)).start(runtime)
        for life in range(3):
            robot = Robot.__new__(Robot)
            robot.did = []
            member = team.member(
                "right", over_beliefs(model)(robot, 1), transport=network.transport("right"), decisions=path
            )
            await runtime.start(member)
            await asyncio.sleep(3.0)
            if life == 1:
                network.crash("right")
            await runtime.stop(member)
            if life == 1:
                path.write_bytes(path.read_bytes()[:-20])  # broken off
        return left

    left = run_virtual(main)
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    places = [(tuple(line["term"]), line["step"]) for line in lines]
    assert len(places) == len(set(places))
    assert len(places) > 15
    applied = {(tuple(commit.term), commit.step): commit.digest for commit in left.commits}
    assert all(applied[place] == line["digest"] for place, line in zip(places, lines, strict=True) if place in applied)
    assert set(places) <= set(applied)


@pytest.mark.parametrize(
    ("before", "after"),
    [("", ""), ("one\n", "one\n"), ('{"a": 1}', '{"a": 1}\n'), ('{"a": 1}\n{"b', '{"a": 1}\n'), ('{"b', "")],
)
def test_of_what_was_there_a_line_that_was_broken_off_alone_goes(tmp_path, before, after):
    path = tmp_path / "left.jsonl"
    path.write_text(before)

    async def main(runtime):
        decisions = Decisions(path)
        await runtime.start(decisions)
        await runtime.stop(decisions)

    run_virtual(main)
    assert path.read_text() == after


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
def test_lines_that_cannot_be_written_are_told_at_once_and_at_the_end(tmp_path):
    path = tmp_path / "left.jsonl"
    path.symlink_to("/dev/full")

    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        team = Team("tigers", ["left", "right"])
        robot = Robot(team, "left", network, over_beliefs(problems.dec_tiger()))
        ensemble = over_beliefs(problems.dec_tiger())(robot, 0)
        member = team.member("left", ensemble, transport=network.transport("left"), decisions=path)
        faults = probe(runtime.faults)
        await runtime.start(member)
        ensemble.start()
        await asyncio.sleep(1.0)
        for _ in range(3):
            ensemble.publish_observation(("hear-left", None))
            await asyncio.sleep(1.0)
        await runtime.stop(member)
        assert [fault.kind for fault in faults if fault.source == "left/decisions"] == ["decisions"]
        assert member.failings() == [f"4 decisions could not be written to {path}"]

    run_virtual(main)


def test_files_of_another_kind_are_not_written_to(tmp_path):
    with refused(mdm.Error):
        Decisions(tmp_path / "team.toml")
