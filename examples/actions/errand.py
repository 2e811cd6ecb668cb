"""The errand that the examples of this folder have in common: a robot fetches boxes, unless somebody calls it.

An ensemble decides between two actions. To come is an async function. To fetch takes several steps: each example has
them done by a tree or a state machine of another library, which tells the step that it takes. What it tells makes a
predicate, by which the robot brings a box that it holds before it comes.
"""

import asyncio
from collections.abc import Awaitable, Callable

import mdm
from mdm.messages import ActionLife

Feedback = Callable[[str], object]


class GripperError(Exception):
    """The gripper does not do what it was told."""


class Robot:
    """A robot that drives, and takes boxes from a shelf.

    Args:
        boxes: How many there are on the shelf.
        pace: Seconds for a quarter of a way, and for each use of the gripper.
        tell: Takes what the robot does, as it does it.
    """

    def __init__(self, boxes: int = 1, *, pace: float = 1.0, tell: Callable[[str], object] = print) -> None:
        self.boxes = boxes
        self.pace = pace
        self.tell = tell
        self.is_jammed = False
        self.is_moving = False

    async def drive(self, place: str) -> None:
        """Drive to a place; cancelled on the way, the robot brakes before this ends."""
        self.is_moving = True
        try:
            for quarter in range(1, 5):
                await asyncio.sleep(self.pace)
                if quarter == 2:
                    self.tell(f"half way to {place}")
            self.tell(f"at {place}")
        except asyncio.CancelledError:
            await asyncio.sleep(self.pace)
            self.tell("braked")
            raise
        finally:
            self.is_moving = False

    async def take(self) -> bool:
        """Take a box; False where there is none."""
        await asyncio.sleep(self.pace)
        if self.is_jammed:
            raise GripperError("the gripper is jammed")
        self.boxes -= 1
        return self.boxes >= 0

    async def put_down(self) -> None:
        """Put the box down."""
        await asyncio.sleep(self.pace)


Fetch = Callable[[Robot, Feedback], Callable[[], Awaitable[object]]]
"""What an example makes: from a robot, and from what takes the names of steps, an async function for the action."""


class Helper:
    """The ensemble, and the sensor that tells when somebody calls."""

    def __init__(self, robot: Robot, fetch: Fetch) -> None:
        predicates = mdm.PredicateManager()
        self.is_called = predicates.sensor("IsCalled", initial=False)
        bring = predicates.event("Bring")
        predicates.latch("IsBringing", set="Bring", reset="Fetch.succeeded or Fetch.failed or Fetch.preempted")

        def step(name: str) -> None:
            robot.tell(f"step: {name}")
            if name == "bring":
                bring.fire()

        async def come() -> None:
            await robot.drive("the person")

        self.ensemble = mdm.Ensemble(
            "helper",
            policy=mdm.policies.DeterministicPolicy([0, 0, 1, 0]),  # comes when called, unless it brings a box
            predicates=predicates,
            states=[mdm.StateFactor("person", ["IsCalled"]), mdm.StateFactor("box", ["IsBringing"])],
            actions={"Fetch": fetch(robot, step), "Come": come},
        )


def play(fetch: Fetch, *, virtual: bool = True, pace: float = 1.0) -> None:
    """Run the errand, call the robot now and then, and print what it does."""
    said: asyncio.Queue[str] = asyncio.Queue()

    def tell(line: str) -> None:
        print(line)
        said.put_nowait(line)

    async def until(line: str) -> None:
        while await said.get() != line:
            pass

    async def main() -> None:
        helper = Helper(Robot(pace=pace, tell=tell), fetch)

        def show(life: ActionLife) -> None:
            detail = life.detail.partition(" (")[0]  # without the place in the code
            tell(" ".join(filter(None, (life.action, life.status, detail))))

        async with mdm.Runtime(log=False) as runtime:  # it tells all ends itself
            lives = runtime.channel("helper/lives", ActionLife)
            lives.subscribe(show)
            await runtime.start(helper.ensemble)
            await until("half way to the shelf")
            helper.is_called.set(True)  # it comes
            await until("Come succeeded")
            helper.is_called.set(False)
            await until("half way to the dock")
            helper.is_called.set(True)  # it brings the box that it holds, and then comes
            await until("Come succeeded")
            helper.is_called.set(False)
            await until("at the shelf")  # which is empty now
            while not (await said.get()).startswith("Fetch failed"):
                pass

    mdm.run(main, virtual=virtual)
