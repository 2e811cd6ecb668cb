"""Step 5, hierarchy: the patrol is an action of a level above, which ends it when somebody calls."""

from floor import FLOOR, Robot
from step4_actions import patrolling

import mdm
from mdm.messages import ActionLife
from mdm.testing import run_virtual

predicates = mdm.PredicateManager()
called = predicates.sensor("Called", initial=False)
robot = Robot(predicates)


async def answer() -> None:
    """Drive to the coffee room, and help."""
    await robot.wheels.go(FLOOR.graph.node("CoffeeRoom").goal)
    called.set(False)


top = mdm.Ensemble(
    "top",
    policy=[0, 1],  # not called, called
    predicates=predicates,
    states=[mdm.StateFactor("called", ["Called"])],
    actions={"Patrol": mdm.bind(patrolling(robot), resume=True), "Answer": answer},
)


async def main(runtime: mdm.Runtime) -> None:
    def show(life: ActionLife) -> None:
        print(f"{life.time / 1e9:5.1f} s  {life.action} {life.status}")

    await robot.start(runtime)
    runtime.channel("top/lives", ActionLife).subscribe(show)
    await runtime.start(top)
    await runtime.clock.sleep(30)
    called.set(True)
    await runtime.clock.sleep(60)


run_virtual(main)
