"""Goals of a server of the real ROS 2, which are pre-empted at random moments."""

from __future__ import annotations

import asyncio
import json
import random
import signal
from contextlib import asynccontextmanager

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


COUNT = {"act": "/count", "type": "test_msgs/action/Fibonacci"}


@asynccontextmanager
async def minded(ros, folder, **options):
    """Give a server, and a robot that decides as it is told, whose goals fail after a second of silence."""
    async with programs(ros, folder) as domain:
        domain.leave_shared_memory()
        peer = await domain.peer()
        peer.tell(**COUNT, **options)
        given = {"seed": 0, "decisions": 0, "silence": 1.0}
        mind = await domain.start(HERE / "preempting_program.py", json.dumps(given))
        await mind.hear("ready")
        yield domain, peer, mind


async def decided(mind, peer):
    """Have the robot decide on its goals in turn until the server has accepted one."""
    accepted = asyncio.create_task(peer.hear("accepted"))
    index = 1
    while not accepted.done():
        mind.tell(decide=index)
        index = 3 - index
        await asyncio.wait([accepted], timeout=0.5)
    return await accepted


def test_a_server_that_is_killed_and_started_again_is_given_a_new_goal(ros, tmp_path):
    async def main():
        async with minded(ros, tmp_path) as (domain, peer, mind):
            mind.tell(decide=1)
            await peer.hear("accepted")
            peer.signal(signal.SIGKILL)
            ended = await mind.hear("action", where=lambda event: event["status"] == "failed")
            assert "told nothing for 1 s" in ended["detail"]
            another = await domain.peer("again")
            another.tell(**COUNT)
            mind.tell(decide=2)
            ended = await mind.hear("action", where=lambda event: event["status"] == "failed")
            assert "may go on with an older goal" in ended["detail"]
            await decided(mind, another)  # once that was asked for the old goal, and has said that it knows none

    asyncio.run(main())


def test_a_server_that_was_held_ends_its_old_goal_when_it_wakes(ros, tmp_path):
    async def main():
        async with minded(ros, tmp_path) as (_, peer, mind):
            mind.tell(decide=1)
            await peer.hear("accepted")
            peer.signal(signal.SIGSTOP)
            await mind.hear("action", where=lambda event: event["status"] == "failed")
            mind.tell(decide=2)
            await mind.hear("action", where=lambda event: event["status"] == "failed")
            peer.signal(signal.SIGCONT)
            await peer.hear("cancel")
            assert (await peer.hear("ended"))["status"] == 5
            assert (await decided(mind, peer))["live"] == 1

    asyncio.run(main())
