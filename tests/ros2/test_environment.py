"""The peers that tests have, by each other."""

from __future__ import annotations

import asyncio

import pytest
from ros2.environment import programs

pytestmark = pytest.mark.slow


def test_two_peers_speak_to_each_other(ros, tmp_path):
    async def main():
        async with programs(ros, tmp_path) as here:
            one, other = await asyncio.gather(here.peer("one"), here.peer("other"))
            one.tell(publish="/level", type="std_msgs/msg/Float64", message={"data": 0.5}, rate=20)
            other.tell(echo="/level", type="std_msgs/msg/Float64")
            assert await other.hear("heard") == {"heard": "/level", "message": {"data": 0.5}}
            one.tell(serve="/lamp", type="std_srvs/srv/SetBool", response={"success": True, "message": "on"})
            other.tell(call="/lamp", type="std_srvs/srv/SetBool", request={"data": True})
            assert await one.hear("request") == {"request": "/lamp", "fields": {"data": True}}
            answered = await other.hear("response")
            assert answered == {"response": "/lamp", "fields": {"success": True, "message": "on"}}

    asyncio.run(main())
