"""A fixed-rate POMDP: the tiger problem at two decisions a second, in virtual time.

`mdm.World` plays the doors and the tiger: it samples the model and raises the events that the observation factor reads.
The same system runs as ``mdm run examples/tiger.toml --virtual --epochs 20``, there without a world: nothing is heard.
"""

from pathlib import Path

import mdm
from mdm.messages import Decision

HERE = Path(__file__).parent


def listen() -> None:
    """Put an ear to the doors."""


def open_left() -> None:
    """Open the left door."""


def open_right() -> None:
    """Open the right door."""


def show(decision: Decision) -> None:
    """Print what was believed and done."""
    assert decision.belief is not None
    left, reward = decision.belief[0], decision.reward
    print(f"{decision.time / 1e9:4.1f} s  tiger left {left:6.1%}  {decision.action_name:10}  {reward:7.2f}")


async def main() -> None:
    system = mdm.load_system(HERE / "tiger.toml")
    async with mdm.Runtime() as runtime:
        runtime.decisions.subscribe(show)
        await runtime.start(mdm.World(system.ensembles["tiger"], seed=3))
        await runtime.start(system)
        await runtime.clock.sleep(9.9)


if __name__ == "__main__":
    mdm.run(main, virtual=True)
