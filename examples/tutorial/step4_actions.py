"""Step 4, actions that take time: the ways of the map are driven, one life after the other."""

from floor import ROOMS, Robot, position
from step3_model import patrol, solution

import mdm
from mdm.messages import ActionLife, EventUpdate
from mdm.testing import run_virtual


def patrolling(robot: Robot, **options: object) -> mdm.Ensemble:
    """Return the ensemble that patrols."""
    return mdm.Ensemble(
        "patrol",
        policy=solution.policy,
        model=patrol,
        predicates=robot.predicates,
        states=[position(), mdm.StateFactor("next", [f"{room}.next" for room in ROOMS])],
        actions=robot.navigation.actions(then="decide"),
        **options,
    )


if __name__ == "__main__":
    robot = Robot(mdm.PredicateManager())

    async def main(runtime: mdm.Runtime) -> None:
        def show(life: ActionLife) -> None:
            print(f"{life.time / 1e9:5.1f} s  {life.action} {life.status}")

        def arrived(update: EventUpdate) -> None:
            for event in update.events:
                if event.endswith(".arrived"):
                    print(f"{update.time / 1e9:5.1f} s  in {event.removesuffix('.arrived')}")

        await robot.start(runtime)
        runtime.channel("patrol/lives", ActionLife).subscribe(show)
        robot.predicates.events.subscribe(arrived)
        await runtime.start(patrolling(robot))
        await runtime.clock.sleep(60)

    run_virtual(main)
