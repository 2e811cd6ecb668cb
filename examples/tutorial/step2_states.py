"""Step 2, states: the room in which a robot has arrived is a factor of the state, by the map's predicates."""

from floor import FLOOR, Robot, position

import mdm
from mdm.messages import State
from mdm.testing import run_virtual

predicates = mdm.PredicateManager()
robot = Robot(predicates)
watcher = mdm.Ensemble(
    "watcher",
    policy=[0] * 6,
    predicates=predicates,
    states=[position()],
    actions={"watch": lambda: None},
)


def show(state: State) -> None:
    room = "unknown" if state.index is None else FLOOR.graph.names[state.index]
    print(f"{state.time / 1e9:5.1f} s  the state is {room}")


async def main(runtime: mdm.Runtime) -> None:
    runtime.channel("watcher/state", State, retain=True).subscribe(show)
    await robot.start(runtime)
    await runtime.start(watcher)
    for room in ("SouthCorridor", "CoffeeRoom"):
        await robot.wheels.go(FLOOR.graph.node(room).goal)  # driven by hand
        await runtime.clock.sleep(1)


run_virtual(main)
