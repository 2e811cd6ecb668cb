"""Actors for tests of the runtime: they tell a list of their life, and fail when they are told to."""

from __future__ import annotations

from mdm import Actor
from mdm.messages import State


class Recorded(Actor):
    """Tells a list of its life."""

    def __init__(self, name, log, **options):
        super().__init__(name, **options)
        self.log = log

    def on_start(self):
        self.log.append(("start", self.path))

    def on_stop(self):
        self.log.append(("stop", self.path))


class Fragile(Recorded):
    """Fails at each odd number it is told."""

    def on_start(self):
        super().on_start()
        self.subscribe(self.runtime.channel("numbers", State), self.handle)

    def handle(self, message):
        if message.index % 2:
            raise ValueError(f"{message.index} is odd")
        self.log.append(("handled", message.index))


def tell(runtime, number):
    """Publish a number where `Fragile` actors listen."""
    runtime.channel("numbers", State).publish(state(number))


def state(number):
    """Return a message that holds a number."""
    return State(0, number, ())
