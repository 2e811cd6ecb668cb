"""Step 6, a belief: what is not seen for sure is believed, and looked at until it is sure enough to act."""

import random

import mdm
from mdm.messages import Decision
from mdm.testing import run_virtual

model = mdm.problems.tiger()  # here: behind which of two doors somebody waits; a look is right 85 times of 100
predicates = mdm.PredicateManager()
for event in ("SawLeft", "SawRight"):
    predicates.event(event)
chance = random.Random(4)


def look() -> None:
    predicates.occur("SawLeft" if chance.random() < 0.85 else "SawRight")  # it is the left one


def open_door() -> None:
    """Open it; then somebody else waits, and nothing is known."""


watch = mdm.Ensemble(
    "watch",
    policy=mdm.solve(model, gap=0.1).policy,
    model=model,
    predicates=predicates,
    observations=[mdm.ObservationFactor("eyes", {"hear-left": "SawLeft", "hear-right": "SawRight"})],
    actions={"listen": look, "open-left": open_door, "open-right": open_door},
    drive=1.0,  # a decision a second
)


async def main(runtime: mdm.Runtime) -> None:
    def show(decision: Decision) -> None:
        assert decision.belief is not None
        left = decision.belief[model.state_space.index("tiger-left")]
        print(f"{decision.time / 1e9:4.1f} s  left with probability {left:.2f}: {decision.action_name}")

    runtime.decisions.subscribe(show)
    await runtime.start(watch)
    await runtime.clock.sleep(6)


run_virtual(main)
