"""The drift monitor: reports rows of a model that a robot's decisions contradict, as they come."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from mdm.actors.options import FixedRate
from mdm.errors import ConfigError, ModelError
from mdm.estimation.drift import ODDS, DriftTest
from mdm.runtime import Actor

if TYPE_CHECKING:
    from mdm.actors.ensemble import Ensemble
    from mdm.estimation.drift import Alarm
    from mdm.messages import Decision
    from mdm.models import MDP


class DriftMonitor(Actor):
    """Reports drift: a fault of the kind ``drift`` for each row of a model that decisions contradict.

    It bets against each row of T, or where states are hidden against the observations predicted after each action, and
    reports a row, once, when the odds against it are high enough (`mdm.estimation.DriftTest`). One in ``odds`` robots
    whose model is right ever reports anything. The robot goes on.

    It subscribes to ``runtime.decisions``, which costs each decision about 1.5 microseconds, and its own work a few
    more.

    Args:
        ensemble: The ensemble that decides.
        odds: See above.
        model: The model; by default the ensemble's.
        name: Its name.

    Raises:
        ConfigError: If there is no model, the odds are not more than 1, or the model may go on without a detection, so
            that the number of its steps is not known.

    Attributes:
        test: The test, with the odds against each row so far.

    Example::

        async with mdm.Runtime() as runtime:
            await runtime.start(mdm.DriftMonitor(robot, odds=1000))
            await runtime.start(robot)
    """

    def __init__(
        self, ensemble: Ensemble, *, odds: float = ODDS, model: MDP | None = None, name: str = "drift"
    ) -> None:
        super().__init__(name)
        given = ensemble.controller.model if model is None else model
        if given is None:
            raise ConfigError(f"a drift monitor needs a model, but ensemble {ensemble.name!r} has none: give it one")
        drive = ensemble.status().drive
        rate = drive.rate if isinstance(drive, FixedRate) else None
        if rate is not None:
            given = given.step_by_step()
        elif given.pomdp is not None and given.pomdp.waits and ensemble.controller.takes != "state":
            raise ConfigError(
                f"the model of ensemble {ensemble.name!r} may go on without a detection: its steps are known at a "
                f"fixed rate alone"
            )
        try:
            self.test = DriftTest(given, odds=odds, period=None if rate is None else round(1e9 / rate))
        except ModelError as error:
            raise ConfigError(str(error)) from None
        self._model = given
        self._ensemble = ensemble
        self._told = False

    def on_start(self) -> None:
        """Listen to decisions."""
        self.subscribe(self.runtime.decisions, self._on_decision)

    def _on_decision(self, decision: Decision) -> None:
        if decision.ensemble == self._ensemble.path:
            if decision.cause == "belief" and not self._told:
                self._told = True
                self.report("unwatched", f"{decision.ensemble} decides on beliefs from outside", time=decision.time)
            alarm = self.test.take(decision)
            if alarm is not None:
                self.report("drift", self._described(alarm), time=decision.time)

    def _described(self, alarm: Alarm) -> str:
        action = self._model.action_space.names[alarm.action]
        if alarm.state is None:
            assert self._model.observation_space is not None
            row = f"after {action!r}: {self._model.observation_space.names[alarm.symbol]!r}"
        else:
            names = self._model.state_space.names
            row = f"from {names[alarm.state]!r} by {action!r} to {names[alarm.symbol]!r}"
        if math.isinf(alarm.odds) and not alarm.model:
            return f"{self._ensemble.path}: {row} is impossible by the model, and has happened"
        return (
            f"{self._ensemble.path}: {row} in {alarm.share:.1%} of {alarm.visits} times, expected in "
            f"{alarm.model:.1%}; the odds against the model are {alarm.odds:.3g} to 1"
        )
