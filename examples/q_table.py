"""An MDP controller from a Q-table: a cart that keeps its battery above empty."""

import asyncio

import mdm

q_table = mdm.policies.QTable([[0.0, 5.0], [2.0, 1.0]])  # rows: battery low, battery fine; columns: Work, Charge
predicates = mdm.PredicateManager()
battery_is_fine = predicates.sensor("BatteryIsFine", initial=True)
robot = mdm.Ensemble(
    "robot",
    policy=q_table,
    predicates=predicates,
    states=[mdm.StateFactor("battery", ["BatteryIsFine"])],
    actions={"Work": lambda: print("working"), "Charge": lambda: print("charging")},
)


async def main() -> None:
    async with mdm.Runtime() as runtime:
        await runtime.start(robot)  # prints "working"
        await asyncio.sleep(0.1)
        battery_is_fine.set(False)  # prints "charging", before set() returns


mdm.run(main)
