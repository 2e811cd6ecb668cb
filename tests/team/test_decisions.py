"""Files of decisions."""

from __future__ import annotations

import asyncio
import json

import pytest
from team_robots import Robot, over_beliefs

import mdm
from mdm import problems
from mdm.team.decisions import Decisions
from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.testing import run_virtual


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
    assert lines[0]["command"] == "begin"
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
        with pytest.raises(mdm.Error, match="decisions cannot be written to"):
            await runtime.start(member)

    run_virtual(main)


def test_files_of_another_kind_are_not_written_to(tmp_path):
    with pytest.raises(mdm.Error, match=r"name a file that ends in \.jsonl, not .*team\.toml"):
        Decisions(tmp_path / "team.toml")
