"""The system: predicates, ensembles and tasks as one actor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.messages import Fault
from mdm.runtime import Actor, ActorFailure
from mdm.runtime.supervision import describe

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from mdm.actors import Ensemble, PredicateManager
    from mdm.maps import Places
    from mdm.models import Durations
    from mdm.team import Member

__all__ = ["System"]


class System(Actor):
    """A predicate manager, ensembles and tasks as one actor, as described by a TOML file.

    Example::

        system = mdm.load_system("patrol/patrol.toml", callbacks=False)
        print(system.tree())

    Args:
        predicates: The predicate manager that all ensembles share.
        ensembles: All ensembles by name. Those without a parent start with the system.
        tasks: Async functions that take the system and run beside the ensembles, such as sensor drivers.
        places: Where the robot is, on a map; its tasks tell it poses.
        member: Of a team, this agent's part: its ensembles start with it.
        emergency: A plain function without arguments that the runtime calls as the last resort, besides its own.
        starved_after: Seconds for which a turn that was cut short may go on while other input comes, where the runtime
            is given none of its own.
        monitors: Actors that start before the ensembles and watch them, such as drift monitors.
        durations: By the names of ensembles, how long actions take in the models that their policies are for.
    """

    def __init__(
        self,
        predicates: PredicateManager,
        ensembles: dict[str, Ensemble],
        tasks: list[Callable[[System], Any]],
        name: str = "system",
        *,
        places: Places | None = None,
        member: Member | None = None,
        emergency: Callable[[], object] | None = None,
        starved_after: float | None = None,
        monitors: Iterable[Actor] = (),
        durations: Mapping[str, Durations] | None = None,
    ) -> None:
        super().__init__(name)
        self.predicates = predicates
        self.ensembles = ensembles
        self.tasks = tasks
        self.places = places
        self.member = member
        self.emergency = emergency
        self.starved_after = starved_after
        self.durations = {} if durations is None else dict(durations)
        self.add(predicates)
        if places is not None:
            self.add(places)
        if member is not None:
            self.add(member)
        for monitor in monitors:
            self.add(monitor)
        for ensemble in self.top:
            if member is None or ensemble.name not in member.ensembles:
                self.add(ensemble)

    @property
    def path(self) -> str:
        """Empty, so that channels have the names of their ensembles: ``patrol/state``."""
        return ""

    @property
    def agent(self) -> str | None:
        """Of a team, which agent this is."""
        return None if self.member is None else self.member.agent

    @property
    def top(self) -> tuple[Ensemble, ...]:
        """The ensembles without a parent, which start with the system."""
        below = {below.name for ensemble in self.ensembles.values() for below in ensemble.subensembles}
        return tuple(ensemble for name, ensemble in self.ensembles.items() if name not in below)

    def on_start(self) -> None:
        """Give the runtime what is its own; have teammates' predicates known before the predicate manager starts."""
        if self.emergency is not None and not self._is_repeated:
            self.runtime.add_emergency(self.emergency)
        if self.starved_after is not None:
            self.runtime.limit_starving(self.starved_after)
        if self.member is not None:
            self.member.prepare(self.runtime)

    def on_running(self) -> None:
        """Run the tasks; where a run is repeated, its record has what they said."""
        for task in () if self._is_repeated else self.tasks:
            self.spawn(self._run_task(task), name=task.__name__)

    @property
    def _is_repeated(self) -> bool:
        return self.runtime.dispatcher.choices.repeats

    async def _run_task(self, task: Callable[[System], Any]) -> None:
        try:
            await task(self)
        except Exception as error:
            failure = ActorFailure(f"task {task.__name__!r} failed: {describe(error)}")
            failure.escalated = True  # it is told here, with its own place in the code alone
            self._tell(task, str(failure))
            raise failure from error
        text = "the predicates that it set are told nothing more, and are unknown after their max_age"
        self._tell(task, f"task {task.__name__!r} has returned: {text}, if nothing else sets them")

    def _tell(self, task: Callable[[System], Any], detail: str) -> None:
        self.runtime.faults.publish(Fault(self.runtime.now(), f"tasks/{task.__name__}", "task", detail))

    def tree(self) -> str:
        """Return the names of all ensembles, indented below their parents."""
        return "\n".join(ensemble.tree() for ensemble in self.top)
