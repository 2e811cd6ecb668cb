"""Goals of a server of the real ROS 2, which are pre-empted at random moments."""

from __future__ import annotations

import asyncio
import json
import random

import pytest
from ros2.environment import HERE, programs

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("seed", "brake", "group"), [(1, 0.0, None), (2, 0.02, None), (3, 0.01, "wheels")])
def test_never_two_goals_are_live_in_random_pre_emptions(ros, tmp_path, seed, brake, group):
    async def main():
        async with programs(ros, tmp_path) as domain:
            peer = await domain.peer()
            peer.tell(act="/count", type="test_msgs/action/Fibonacci", brake=brake, replaces=group is not None)
            given = {"seed": seed, "decisions": 300, "group": group}
            mind = await domain.start(HERE / "preempting_program.py", json.dumps(given))
            await mind.hear("ready")
            over = asyncio.create_task(mind.hear("over"))
            draw = random.Random(seed)
            while not over.done():
                peer.tell(finish=draw.choice([4, 4, 6]))
                await asyncio.wait([over], timeout=draw.choice([0.01, 0.03, 0.1]))
            await over
            peer.tell(echoed=1)
            await peer.hear("echoed")
            return peer.heard, mind.heard

    served, told = asyncio.run(main())
    accepted = [event for event in served if "accepted" in event]
    ended = [event for event in served if "ended" in event]
    assert len(accepted) == len(ended) > 50
    assert {event["live"] for event in accepted} <= ({1, 2} if group else {1})
    lives = [event for event in told if "action" in event and event["action"] != "Rest"]
    ends = [event["status"] for event in lives if event["status"] != "running"]
    assert ends.count("succeeded") <= sum(event["status"] == 4 for event in ended)
    assert len(ends) == len(lives) / 2
