"""A robot that looks ahead at each decision, beside a loop that never waits for it.

The tiger is behind one of two doors. Nothing was solved ahead: a process of its own searches for a tenth of a second
after each observation, and its answer comes back as a message; meanwhile the program goes on. Until that process is
ready, a fallback decides: it listens.
"""

import asyncio
from pathlib import Path

import mdm
from mdm.messages import Answer, Decision

HERE = Path(__file__).parent
DECISIONS = 12


def act() -> None:
    """Do what the world knows of by the action's message."""


def show(decision: Decision) -> None:
    """Print what was believed and done."""
    assert decision.belief is not None
    print(f"tiger left {decision.belief[0]:6.1%}: {decision.action_name}")


async def main() -> None:
    model = mdm.load_model(HERE / "tiger.pomdp")
    listen = mdm.policies.AlphaVectors([[-20.0, -20.0]], [0], num_actions=3)
    tiger = mdm.Ensemble(
        "tiger",
        model=model,
        policy=mdm.solvers.TreeSearch(model, seconds=0.1, fallback=listen),
        actions={"listen": act, "open-left": act, "open-right": act},
    )
    beats = 0

    async def beat() -> None:
        nonlocal beats
        while True:
            await asyncio.sleep(0.01)
            beats += 1

    async with mdm.Runtime() as runtime:
        heart = asyncio.create_task(beat())
        await runtime.start(tiger)
        await tiger.ready()
        runtime.decisions.subscribe(show)
        answers = runtime.channel("tiger/answer", Answer).stream()
        # The world hears each action and says at once what is observed.
        await runtime.start(mdm.World(tiger, seed=1, period=0.0))
        tiger.reset()
        before = beats
        for _ in range(DECISIONS):
            await anext(answers)
        print(f"the loop went on meanwhile: {beats - before > DECISIONS}")
        heart.cancel()


if __name__ == "__main__":
    mdm.run(main)
