"""A user's own actor: it says what only programs of their own say, on a channel and in faults of its own."""

from __future__ import annotations

from typing import Any

import msgspec

import mdm


class Own(msgspec.Struct):
    message: Any


class Talker(mdm.Actor):
    """Talks, some of it what no record can hold, and fails at times.

    Args:
        random: Draws what it says.
        journal: Is told of it.
        texts: Makes what it says.
    """

    def __init__(self, random, journal, texts):
        super().__init__("talker", supervision=mdm.Restart(limit=100, within=60.0, backoff=0.3))
        self._random, self._journal, self._texts = random, journal, texts
        self._talks = random.random() < 0.3

    def on_start(self):
        if self._talks:
            self._own = self.runtime.channel("own", Own)
            self.every(self._random.choice([0.5, 2.0]), self._talk)

    def _talk(self, _):
        match self._random.choice(["text", "text", "deep", "cycle", "report", "raise"]):
            case "text":
                self._say(self._texts.more())
            case "deep":
                message = {}
                for _ in range(2_000):
                    message = {"in": message}
                self._say(message)
            case "cycle":
                message = {}
                message["again"] = message
                self._say(message)
            case "report":
                self.report("own", f"the program says {self._texts.more()}")
            case "raise":
                self._texts.throw(ValueError, self._journal.text())

    def _say(self, message):
        self._journal.says(message)
        self._own.publish(Own(message))
