"""The robot comes to every room in turn, in ten minutes of virtual time."""

from pathlib import Path

import mdm
from mdm.messages import EventUpdate
from mdm.testing import run_virtual

HERE = Path(__file__).parent


def test_it_makes_its_round():
    async def minutes(runtime):
        rooms = []

        def arrived(update):
            rooms.extend(event.removesuffix(".arrived") for event in update.events if event.endswith(".arrived"))

        runtime.channel("predicates/events", EventUpdate).subscribe(arrived)
        await runtime.start(mdm.load_system(HERE / "robot.toml"))
        await runtime.clock.sleep(600)
        return rooms

    rooms = run_virtual(minutes)
    assert len(rooms) > 30
    assert rooms[:5] == ["Lobby", "Office", "Lab", "Office", "Lobby"]  # back through the office
