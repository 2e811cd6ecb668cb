"""The measured ensembles, as a file, a program or a model and a policy give them, and random stimuli for them."""

from __future__ import annotations

from functools import partial
from os import PathLike
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from mdm.actors import Ensemble
from mdm.config import System, load_system
from mdm.config.functions import nothing
from mdm.errors import Error
from mdm.loading import model_of, pair_of, policy_of
from mdm.runtime.actor import descendants

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from mdm.actors import PredicateManager, StateFactor
    from mdm.loading import GivenModel, GivenPolicy
    from mdm.runtime import Actor, Runtime

    Given = System | Ensemble | str | Path | tuple[GivenModel, GivenPolicy]
    Stimulus = Callable[[], object]
    Readings = dict[str, bool]

T = TypeVar("T")
_AHEAD = 100


class Subject:
    """Ensembles to be measured, and the stimuli that reach them.

    Args:
        given: A system or an ensemble, the TOML file of a system, or a model and a policy, each by itself or its file.
        agent: Of a team's file, the agent whose own ensembles are measured.
        with_actions: Bind the functions that the file names to its actions. Its tasks and links are left out all the
            same.
        seed: Of the random stimuli.

    Attributes:
        ensembles: All of them by name.

    Raises:
        Error: If there is no ensemble to measure.
    """

    def __init__(self, given: Given, *, agent: str | None, with_actions: bool, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        self._told: dict[object, int] = {}
        self._ahead: list[Stimulus] = []
        self._actor: Actor
        if isinstance(given, System | Ensemble):
            self._actor = given
        elif isinstance(given, tuple):
            self._actor = _made(*given)
        else:
            self._actor = load_system(given, agent=agent, callbacks=with_actions)
        joint = getattr(getattr(self._actor, "member", None), "ensembles", ())
        found = (each for each in descendants(self._actor) if isinstance(each, Ensemble) and each.name not in joint)
        self.ensembles = {each.name: each for each in found}
        if not self.ensembles:
            reason = "it has no ensembles" if agent is None else f"all ensembles of {agent!r} decide with its team"
            raise Error(f"there is nothing to measure, for {reason}: give a model and its policy instead")

    async def start(self, runtime: Runtime) -> None:
        """Start the ensembles, without tasks, links and a team, and tell each predicate that code sets a value."""
        if isinstance(system := self._actor, System):
            system.tasks, system.emergency, system.extensions = [], None, ()
            if system.member is not None:
                await system.stop_child(system.member)
                system.member = None
        await runtime.start(self._actor)
        self.refresh()

    def refresh(self) -> None:
        """Tell every predicate that code sets its value once more, so that none is too old; at first false."""
        self._ahead.clear()  # they follow from each other
        for manager in {each.predicates for each in self.ensembles.values() if each.predicates}:
            values = manager.values().items()
            readings = {name: bool(value) for name, value in values if manager.declared.senses(name)}
            for ensemble in self.ensembles.values():
                for factor in _factors(ensemble) if ensemble.predicates is manager else ():
                    readings |= factor.truth(self._told.setdefault(factor, 0))
            _tell(manager, readings)

    def recover(self) -> None:
        """Release the ensembles that are safe, and tell predicates that have become unknown their values."""
        for ensemble in self.ensembles.values():
            if ensemble.mode == "safe":
                ensemble.release()
        if any(ensemble.waiting for ensemble in self.ensembles.values()):
            self.refresh()

    def pick(self) -> Stimulus:
        """Return a random stimulus, to be called from any thread; many are made at once, so that caches stay warm."""
        if not self._ahead:
            self._ahead = [self._stimulus() for _ in range(_AHEAD)][::-1]
        return self._ahead.pop()

    def _stimulus(self) -> Stimulus:
        ensemble = self._one([*self.ensembles.values()])
        symbols, manager = ensemble.controller.symbols, ensemble.predicates
        if ensemble.state is None and ensemble.observation is None:
            if ensemble.controller.takes == "state":
                return partial(ensemble.publish_state, self._other(ensemble, symbols.num_states or 1))
            observations = 1 if symbols.observation_space is None else len(symbols.observation_space)
            return partial(ensemble.publish_observation, self._one(range(observations)))
        options: list[Any] = [] if manager is None else [*_factors(ensemble)]
        if manager is not None:
            heard = () if ensemble.observation is None else ensemble.observation.factors
            events = ([name for name in each.events if name and manager.declared.raises(name)] for each in heard)
            options = [*options, *filter(None, events)] or [*manager.settable]  # of which all its factors are derived
        if manager is None or not options:
            raise Error(f"nothing that code can set or raise reaches ensemble {ensemble.name!r}: declare its sensors")
        chosen = self._one(options)
        if isinstance(chosen, list):
            return partial(manager.occur, self._one(chosen))
        if isinstance(chosen, str):
            return _telling(manager, {chosen: bool(self._other((manager, chosen), 2))})
        before = chosen.truth(self._told.get(chosen, 0))
        after = chosen.truth(self._other(chosen, chosen.size))
        return _telling(manager, {name: value for name, value in after.items() if value != before[name]})

    def _one(self, of: Sequence[T]) -> T:
        return of[int(self._random.integers(len(of)))]

    def _other(self, key: object, count: int) -> int:
        """Return another value than the last one."""
        step = self._one(range(1, max(count, 2)))
        self._told[key] = (self._told.get(key, 0) + step) % count
        return self._told[key]


def _factors(ensemble: Ensemble) -> Iterator[StateFactor]:
    """Yield the state factors of an ensemble whose predicates code sets, all of them."""
    if ensemble.state is not None and ensemble.predicates is not None:
        for factor in ensemble.state.factors:
            if all(map(ensemble.predicates.declared.senses, factor.predicates)):
                yield factor


def _telling(manager: PredicateManager, readings: Readings) -> Stimulus:
    """Return the call that tells predicates their values, several in a batch."""
    first, *others = readings.items()
    return partial(_tell, manager, readings) if others else partial(manager.take, (first,))


def _tell(manager: PredicateManager, readings: Readings) -> None:
    with manager.batch():
        for reading in readings.items():
            manager.take((reading,))


def _made(model: GivenModel, policy: GivenPolicy) -> Ensemble:
    """Return an ensemble for a model and a policy, to which states or observations are published."""
    seen = model_of(model)
    decides: Any = None
    if isinstance(policy, str | PathLike):
        decides, seen = pair_of(seen, policy)
    else:
        decides = policy_of(policy, seen)
    actions = range(len(seen.action_space.factors[0]))
    return Ensemble("model", policy=decides, model=seen, actions=dict.fromkeys(actions, nothing))
