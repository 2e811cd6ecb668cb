"""From a ROS node's message to mdm's decision to the message that its action publishes, against a bare echo by rclpy.

A node sends a number, waits for the answer, and sends the next one 2 ms later; to the one and the other by turns. Each
run has processes of its own. It needs an interpreter that has rclpy, given by ``--ros`` or MDM_ROS_PYTHON.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from measurement import parser, report, table

ROOT = Path(__file__).resolve().parents[1]
BLOCK = 50

SENDER = """
import json, sys, threading, time
import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import Float64

blocks, block = int(sys.argv[1]), int(sys.argv[2])
rclpy.init()
node = rclpy.create_node("sender")
executor = SingleThreadedExecutor()
executor.add_node(node)
answers = {"bare": None, "mdm": None}
seconds = {"bare": [], "mdm": []}


def hearing(name):
    def hear(message):
        answers[name] = message.data
    return hear


publishers = {name: node.create_publisher(Float64, f"/{name}/ping", 10) for name in answers}
for name in answers:
    node.create_subscription(Float64, f"/{name}/pong", hearing(name), 10)
message, sign = Float64(), 1.0
while not all(node.count_publishers(f"/{name}/pong") and publishers[name].get_subscription_count() for name in answers):
    executor.spin_once(timeout_sec=0.05)
time.sleep(0.5)  # to have each known to the other
for number in range(-2, blocks):
    for name, publisher in publishers.items():
        for _ in range(block):
            message.data, sign = sign, -sign
            begin = time.perf_counter()
            publisher.publish(message)
            while answers[name] != message.data:
                executor.spin_once(timeout_sec=5.0)
            if number >= 0:
                seconds[name].append(time.perf_counter() - begin)
            answers[name] = None
            time.sleep(0.002)
print(json.dumps(seconds), flush=True)
"""

BARE = """
import rclpy
from std_msgs.msg import Float64

rclpy.init()
node = rclpy.create_node("bare")
publisher = node.create_publisher(Float64, "/bare/pong", 10)
node.create_subscription(Float64, "/bare/ping", lambda message: publisher.publish(Float64(data=message.data)), 10)
rclpy.spin(node)
"""

SYSTEM = """
[ros2]
node = "decider"

[predicates]
High = { topic = "/mdm/ping", type = "std_msgs/msg/Float64", when = "data > 0" }

[ensembles.decider]
policy = [0, 1]
states.high = { yes = "High" }

[ensembles.decider.actions]
0 = { publish = "/mdm/pong", type = "std_msgs/msg/Float64", message = { data = -1.0 } }
1 = { publish = "/mdm/pong", type = "std_msgs/msg/Float64", message = { data = 1.0 } }
"""

DECIDER = """
import sys
import mdm


async def main():
    async with mdm.Runtime(log=None) as runtime:
        await runtime.start(mdm.load_system(sys.argv[1]))
        await runtime.wait()


mdm.run(main)
"""


def measured(python: Path, folder: Path, blocks: int, number: int) -> dict[str, list[float]]:
    """Return the seconds of each round trip of one run."""
    ours = [ROOT, *{sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}]
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(map(str, ours)),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": str(60 + number % 30),
        "ROS_LOG_DIR": str(folder),
    }

    def begin(*arguments: object) -> subprocess.Popen[str]:
        command = [python, *map(str, arguments)]
        return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True, cwd=folder)

    for name, text in (("sender.py", SENDER), ("bare.py", BARE), ("decider.py", DECIDER), ("system.toml", SYSTEM)):
        (folder / name).write_text(text)
    others = [begin("bare.py"), begin("decider.py", "system.toml")]
    try:
        sender = begin("sender.py", blocks, BLOCK)
        output, _ = sender.communicate(timeout=300)
        seconds: dict[str, list[float]] = json.loads(output)
        return seconds
    finally:
        for each in others:
            each.kill()
            each.communicate()


def main() -> None:
    reading = parser(__doc__.splitlines()[0])
    reading.add_argument("--ros", type=Path, default=os.environ.get("MDM_ROS_PYTHON"), help="who has rclpy")
    reading.add_argument("--runs", type=int, default=10)
    options = reading.parse_args()
    rows: list[dict[str, Any]] = []
    if options.ros is None:
        print("skipped: no interpreter that has rclpy is given, by --ros or MDM_ROS_PYTHON")
    else:
        with tempfile.TemporaryDirectory() as folder:
            for number in range(1 if options.quick else options.runs):
                seconds = measured(options.ros, Path(folder), 1 if options.quick else 20, number)
                bare, mdm = (statistics.median(seconds[name]) * 1e6 for name in ("bare", "mdm"))
                rows.append({"run": number, "bare_us": bare, "mdm_us": mdm, "ratio": mdm / bare})
        table("From a message to the answer, in microseconds", rows)
        ratio = statistics.median(row["ratio"] for row in rows)
        print(f"\nmdm took {ratio:.2f} times as long as a bare echo (median of {len(rows)} runs)", file=sys.stdout)
    report("ros2", {"runs": rows}, options.output)


if __name__ == "__main__":
    main()
