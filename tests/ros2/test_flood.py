"""More messages than can be taken, and larger ones than anybody wants: the loop goes on, and decides by the newest."""

from __future__ import annotations

import asyncio

import pytest
from ros2.environment import Watched, programs

pytestmark = pytest.mark.slow

SYSTEM = """
[ros2]
node = "flooded"

[predicates]
High = { topic = "/level", type = "std_msgs/msg/Float64", when = "data > 0.5", qos = { depth = 100 } }
Go = { topic = "/go", type = "std_msgs/msg/Bool", when = "data" }

[predicates.Near]
topic = "/scan"
type = "sensor_msgs/msg/LaserScan"
when = "ranges[2499999] < 1.0"
qos = { reliability = "reliable" }

[predicates.Wide]
topic = "/cloud"
type = "sensor_msgs/msg/PointCloud2"
when = "width > 100"
qos = { reliability = "reliable" }

[events]
Bump = { topic = "/level", type = "std_msgs/msg/Float64", when = "data > 2.0" }

[ensembles.level]
policy = [0, 1]
states.high = { yes = "High" }
[ensembles.level.actions]
0 = { publish = "/is_high", type = "std_msgs/msg/Bool" }
1 = { publish = "/is_high", type = "std_msgs/msg/Bool", message = { data = true } }

[ensembles.go]
policy = [0, 1]
states.go = { yes = "Go" }
[ensembles.go.actions]
0 = { publish = "/lamp", type = "std_msgs/msg/Bool" }
1 = { publish = "/lamp", type = "std_msgs/msg/Bool", message = { data = true } }

[ensembles.sight]
policy = [0, 1, 2, 3]
states.near = { yes = "Near" }
states.wide = { yes = "Wide" }
[ensembles.sight.actions]
0 = { publish = "/sight", type = "std_msgs/msg/Int32" }
1 = { publish = "/sight", type = "std_msgs/msg/Int32", message = { data = 1 } }
2 = { publish = "/sight", type = "std_msgs/msg/Int32", message = { data = 2 } }
3 = { publish = "/sight", type = "std_msgs/msg/Int32", message = { data = 3 } }
"""
RATE = 11_000


def test_floods_and_large_messages_neither_stop_the_loop_nor_mislead_it(ros, tmp_path):
    async def main():
        async with programs(ros, tmp_path) as here:
            peer, other = Watched(await here.peer("flooder")), Watched(await here.peer("other"))
            for topic, kind in (("/level", "Float64"), ("/go", "Bool")):
                node = peer if topic == "/level" else other
                node.tell(publish=topic, type=f"std_msgs/msg/{kind}", quiet=True)
            for topic, kind in (("/is_high", "Bool"), ("/lamp", "Bool"), ("/sight", "Int32")):
                other.tell(echo=topic, type=f"std_msgs/msg/{kind}")
            other.tell(publish="/scan", type="sensor_msgs/msg/LaserScan", quiet=True, depth=1)
            other.tell(publish="/cloud", type="sensor_msgs/msg/PointCloud2", quiet=True, depth=1)
            system = Watched(await here.system(SYSTEM))
            for node, topics in ((peer, ["/level"]), (other, ["/go", "/scan", "/cloud", "/is_high", "/lamp"])):
                for topic in topics:
                    node.tell(matched=topic)
                    await node.says("matched", where=lambda event, topic=topic: event["matched"] == topic)

            peer.tell(flood="/level", messages=[{"data": 0.9}, {"data": 0.1}, {"data": 3.0}], count=2 * RATE, rate=RATE)
            answered = 0
            while peer.last("flooded") is None:  # meanwhile other topics are decided on
                answered += 1
                other.tell(publish="/go", type="std_msgs/msg/Bool", message={"data": answered % 2 == 1}, rate=50)
                await other.until(lambda go=answered % 2 == 1: newest(other, "/lamp") is go)
            assert answered > 1
            for high in (True, False):
                peer.tell(publish="/level", type="std_msgs/msg/Float64", message={"data": 0.9 * high}, rate=20)
                await other.until(lambda high=high: newest(other, "/is_high") == high)
            ranges = {"ranges": {"value": 0.5, "times": 2_500_000}}
            cloud = {"width": 200, "data": {"value": 7, "times": 10_000_000}}
            other.tell(publish="/scan", type="sensor_msgs/msg/LaserScan", message=ranges, rate=2)
            other.tell(publish="/cloud", type="sensor_msgs/msg/PointCloud2", message=cloud, rate=2)
            await other.until(lambda: newest(other, "/sight") == 3)
            system.tell(end=True)
            await system.ended()
            assert system.last("ended")["heard"]["/level"] > 100
            assert system.last("ended")["heard"]["/scan"] >= 1
            faults = {event["fault"] for event in system.said if "fault" in event}
            assert faults <= {"waiting", "overflow", "stall", "livelock"}

    asyncio.run(main())


def newest(node, topic):
    """Return what the newest message on a topic says, or None."""
    return next((event["message"]["data"] for event in reversed(node.said) if event.get("heard") == topic), None)
