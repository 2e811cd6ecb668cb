"""A first robot: a model from functions, its optimal policy, and a sensor that changes."""

import asyncio

import mdm


def next_battery(battery, action):
    if action == "charge":
        return "full"
    return {"full": 0.9, "low": 0.1} if battery == "full" else "low"


def reward(battery, action):
    return 0 if action == "charge" else 1 if battery == "full" else -10


names = ["full", "low"], ["work", "charge"]
model = mdm.MDP.from_functions(*names, transition=next_battery, reward=reward, discount=0.95)
predicates = mdm.PredicateManager()
battery_is_low = predicates.sensor("BatteryIsLow", initial=False)
robot = mdm.Ensemble(
    "robot",
    policy=mdm.solve(model),
    model=model,
    predicates=predicates,
    states=[mdm.StateFactor("battery", ["BatteryIsLow"])],
    actions={"work": lambda: print("working"), "charge": lambda: print("charging")},
)


async def main() -> None:
    async with mdm.Runtime() as runtime:
        await runtime.start(robot)  # prints "working"
        await asyncio.sleep(0.1)
        battery_is_low.set(True)  # prints "charging", before set() returns


mdm.run(main)
