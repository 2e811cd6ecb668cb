"""External beliefs: a particle filter of your own tells the control layer what to believe.

The robot looks for its charger in a corridor of five cells. A filter over its position, which a real robot would run
on its laser, publishes its belief ten times a second; the ensemble decides on each belief, and tracks none itself.
"""

import numpy as np

import mdm
from mdm.messages import Decision

CELLS = 5
CHARGER = 3
random = np.random.default_rng(7)


def corridor() -> mdm.models.POMDP:
    """Cells from left to right; Left and Right move by one, Dock is right at the charger alone."""
    left, right = np.eye(CELLS, k=-1), np.eye(CELLS, k=1)
    left[0, 0] = right[-1, -1] = 1
    rewards = np.full((CELLS, 3), -1.0)
    rewards[:, 2] = -20.0
    rewards[CHARGER, 2] = 10.0
    return mdm.models.POMDP(
        [left, right, np.eye(CELLS)],
        [np.ones((CELLS, 1))] * 3,  # the model itself observes nothing
        rewards,
        discount=0.9,
        actions=["Left", "Right", "Dock"],
        states=[f"cell{index}" for index in range(CELLS)],
    )


def greedy(model: mdm.models.POMDP) -> mdm.policies.AlphaVectors:
    """Return the vectors of the model's MDP, one an action: good enough where the belief is sharp."""
    value = np.zeros(CELLS)
    for _ in range(100):
        q = model.rewards + model.discount * np.stack([model.transition_matrix(a) @ value for a in range(3)], axis=1)
        value = q.max(axis=1)
    return mdm.policies.AlphaVectors(q.T, [0, 1, 2])


class ParticleFilter(mdm.Actor):
    """Guesses the robot's cell, moves its guesses as the robot moves, and keeps those that fit what the laser says."""

    def __init__(self, robot: mdm.Ensemble) -> None:
        super().__init__("filter")
        self.robot = robot
        self.cell = 0
        self.particles = random.integers(CELLS, size=500)

    def on_start(self) -> None:
        """Filter ten times a second."""
        self.every(10, lambda _: self.filter())

    def move(self, by: int) -> None:
        """Move the robot and the guesses; the guesses slip now and then."""
        self.cell = min(max(self.cell + by, 0), CELLS - 1)
        slips = random.random(self.particles.size) < 0.1
        self.particles = np.clip(self.particles + np.where(slips, 0, by), 0, CELLS - 1)

    def filter(self) -> None:
        """Weigh the guesses by a laser reading, and publish them as a belief."""
        reading = self.cell + random.normal(scale=0.7)
        weights = np.exp(-((self.particles - reading) ** 2))
        self.particles = random.choice(self.particles, size=500, p=weights / weights.sum())
        self.robot.publish_belief(np.bincount(self.particles, minlength=CELLS) / 500)


def show(decision: Decision) -> None:
    """Print what was believed and done."""
    belief = " ".join(f"{chance:4.2f}" for chance in decision.belief)
    print(f"{decision.time / 1e9:3.1f} s  believes {belief}  by {decision.cause}: {decision.action_name}")


async def main() -> None:
    model = corridor()
    robot = mdm.Ensemble(
        "robot",
        policy=greedy(model),
        model=model,
        actions={
            "Left": lambda: particles.move(-1),
            "Right": lambda: particles.move(1),
            "Dock": lambda: print(f"docking in cell {particles.cell}; the charger is in cell {CHARGER}"),
        },
    )
    particles = ParticleFilter(robot)
    async with mdm.Runtime() as runtime:
        runtime.decisions.subscribe(show)
        await runtime.start(robot)
        await runtime.start(particles)
        await runtime.clock.sleep(1.0)


mdm.run(main, virtual=True)
