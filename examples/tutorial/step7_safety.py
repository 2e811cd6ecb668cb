"""Step 7, safety: the localisation fails in the middle of a drive, and comes back."""

from floor import Robot
from step4_actions import patrolling

import mdm
from mdm.messages import Mode
from mdm.testing import run_virtual

robot = Robot(mdm.PredicateManager())


def brake() -> None:
    print("        the motors are off")


async def main(runtime: mdm.Runtime) -> None:
    def show(mode: Mode) -> None:
        causes = ", ".join(f"{cause.kind}: {cause.detail}" for cause in mode.causes)
        print(f"{mode.time / 1e9:5.1f} s  {mode.mode}{f' ({causes})' if causes else ''}")

    await robot.start(runtime)
    runtime.modes.subscribe(show)
    await runtime.start(patrolling(robot, safe_action=brake))
    await runtime.clock.sleep(20)
    robot.lost = True  # as though somebody had pulled the sensor's plug
    await runtime.clock.sleep(5)
    robot.lost = False
    await runtime.clock.sleep(5)


run_virtual(main)
