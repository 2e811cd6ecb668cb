"""Step 1, predicates: what is sensed becomes true, false or unknown, and formulas follow."""

import mdm
from mdm.messages import PredicateUpdate
from mdm.testing import run_virtual

predicates = mdm.PredicateManager()
battery_low = predicates.sensor("BatteryLow", max_age=2.0)  # unknown two seconds after it was told last
moving = predicates.sensor("IsMoving", initial=False)
predicates.define("MayGo", "not BatteryLow and not IsMoving")


def show(update: PredicateUpdate) -> None:
    for names, value in ((update.rising, "true"), (update.falling, "false"), (update.unknown, "unknown")):
        for name in names:
            print(f"{update.time / 1e9:4.1f} s  {name} is {value}")


async def main(runtime: mdm.Runtime) -> None:
    await runtime.start(predicates)
    predicates.updates.subscribe(show)
    battery_low.set(False)
    await runtime.clock.sleep(1)
    moving.set(True)
    await runtime.clock.sleep(5)  # nothing is told of the battery meanwhile


run_virtual(main)
