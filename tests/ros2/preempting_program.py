"""A robot that changes its mind at random between two goals of one server and none, and prints how each ended as JSON.

Its argument is JSON: ``seed``, ``decisions``, ``group`` and ``silence``. With 0 decisions it decides as it is
told by lines such as ``{"decide": 1}``, until they end.
"""

import asyncio
import json
import random
import sys

import mdm
from mdm.messages import ActionLife
from mdm.policies import DeterministicPolicy
from mdm.ros2.actions import Actions
from mdm.ros2.rclpy_wire import RclpyWire

FIBONACCI = "test_msgs/action/Fibonacci"


def tell(**what):
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


async def main(seed, decisions, group=None, silence=None):
    draw = random.Random(seed)
    wire = RclpyWire(f"mind_{seed}")
    actions = Actions(wire)
    options = {"group": group} if group else {}
    goals = {
        name: actions.goal("/count", FIBONACCI, goal={"order": order}, silence=silence, **options)
        for order, name in enumerate(("Rise", "Fall"), start=1)
    }
    made = {"Rest": lambda: None, **goals}
    robot = mdm.Ensemble("robot", policy=DeterministicPolicy([0, 1, 2]), actions=made, on_failed_action="continue")
    async with mdm.Runtime(log=False) as runtime:
        runtime.channel("robot/lives", ActionLife).subscribe(
            lambda life: tell(action=life.action, status=life.status, detail=life.detail)
        )
        await wire.open(runtime)
        await actions.open(runtime)
        await runtime.start(robot)
        server = actions.server("/count", FIBONACCI)
        while not server.goals.ready:
            await asyncio.sleep(0.05)
        tell(ready=True)
        if not decisions:
            while line := await asyncio.to_thread(sys.stdin.readline):
                robot.publish_state(json.loads(line)["decide"])
        for _ in range(decisions):
            robot.publish_state(draw.choice([0, 1, 1, 2, 2]))
            await asyncio.sleep(draw.choice([0.0, 0.0, 0.001, 0.003, 0.01, 0.03]))
        robot.publish_state(0)
        while decisions and server.open:
            await asyncio.sleep(0.01)
        tell(over=True, ended=dict(robot.action.ended))
        await actions.close()
    await wire.close()


asyncio.run(main(**json.loads(sys.argv[1])))
