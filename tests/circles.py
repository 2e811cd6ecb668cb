"""A lamp whose actions set what they are decided on, beside a robot that drives until it sees an obstacle."""

from __future__ import annotations

import mdm

__all__ = ["Lamp"]


class Lamp:
    """Two ensembles over one predicate manager, the first of which goes round in a circle for as long as it shines.

    Args:
        acts: Called by each action of the lamp, as to have time go on.
        max_age: How long it is known that there is no obstacle.
    """

    def __init__(self, acts=lambda: None, max_age=None):
        self.acts = acts
        self.switches = 0
        self.motors = []
        self.predicates = mdm.PredicateManager("predicates")
        self.lit = self.predicates.sensor("Lit", initial=False)
        self.power = self.predicates.sensor("Power", initial=False)
        self.obstacle = self.predicates.sensor("Obstacle", initial=False, max_age=max_age)
        self.lamp = mdm.Ensemble(
            "lamp",
            policy=[0, 0, 1, 2],  # by power and light
            predicates=self.predicates,
            states=[mdm.StateFactor("power", ["Power"]), mdm.StateFactor("lit", ["Lit"])],
            actions={"rest": lambda: None, "on": lambda: self.switch(True), "off": lambda: self.switch(False)},
        )
        self.robot = mdm.Ensemble(
            "robot",
            policy=[0, 1],
            predicates=self.predicates,
            states=[mdm.StateFactor("obstacle", ["Obstacle"])],
            actions={name: self.motor(name) for name in ("drive", "halt")},
            safe_action=self.motor("off"),
        )
        self.tops = [self.robot, self.lamp]

    def switch(self, lit):
        """Turn the lamp on or off."""
        self.switches += 1
        self.acts()
        self.lit.set(lit)

    def motor(self, name):
        """Return a plain function that drives the robot."""
        return lambda: self.motors.append(name)
