"""The layer that a team adds to an ensemble: it takes the input of the own layers, and leads the control layer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from mdm.actors.layer import Layer
from mdm.actors.options import OnEvent
from mdm.actors.safety.modes import WAYS_BACK
from mdm.errors import ConfigError
from mdm.messages import Mode, Observation, State
from mdm.runtime import Subscription
from mdm.runtime.time.scheduler import next_tick
from mdm.stimuli import Recalled
from mdm.team.copy import Copy
from mdm.team.decisions import Committed
from mdm.team.ownership import Ownership, acting
from mdm.team.sharing.commanding import DONE, PENDING, Commands
from mdm.team.storage import Stored, StoredStop
from mdm.team.transport.bounds import UNREADABLE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from typing import Literal

    from mdm.actors import Ensemble
    from mdm.messages import Cause, Tick
    from mdm.runtime import Channel
    from mdm.team.link import Link
    from mdm.team.ownership import Placement
    from mdm.team.storage import Storage
    from mdm.team.team import Team
    from mdm.team.transport.transport import Sample

T = TypeVar("T")

_FAREWELL = 10.0
"""Seconds within which the agents of a team that ends have all said so."""

_UNMET = frozenset({"missing_teammate"})
_REFUSED = frozenset({"refused"})
_TEAMMATE = frozenset({"lost_teammate"})


class TeamLayer(Layer):
    """The base of a team's layers: the last layer of an ensemble, between it and the other agents.

    At a fixed rate it proposes at each tick its agent's input since the last one; where events make steps, at once.

    Args:
        name: Its name.
        team: The team.
        ensemble: The ensemble, whose control layer it leads.
        link: The connection of this agent to the others.
        placement: Where the ensemble's layers are.

    Raises:
        ConfigError: If the ensemble does not fit the team.

    Attributes:
        ownership: The factors of the ensemble's input, and their owners.
        process: The joint process, as this agent's control layer decides on it.
        copy: This agent's copy of it, and its input.
        commits: Where each step is told; set before the start.
        lost: The teammates that are lost.
        own: The present values of this agent's state factors.
        tick: The number of the last tick.
        commands: The outcomes of commands.
        storage: Where the stop that it obeys outlives the process; None where it does not. Set before the start.
        stopped: The stop that it obeys.
        reported_held: Whether it has reported that it stays stopped.
    """

    def __init__(self, name: str, team: Team, ensemble: Ensemble, link: Link, placement: Placement) -> None:
        super().__init__(name)
        self.team = team
        self.ensemble = ensemble
        self.link = link
        self.agent = link.agent
        agents = acting(team, ensemble, placement)
        _check(team, self.agent, ensemble, agents)
        if not team.event_driven:
            ensemble.controller.step_by_step()
        self.ownership = Ownership(team, ensemble, placement)
        self.process = ensemble.follow(self, self.ownership.named(self.agent), acts=self.agent in agents)
        protocol = link.transport.protocol
        self.copy = Copy(team, self.agent, ensemble, self.process, self.ownership, protocol)
        link.configuration.add(ensemble.name, self.copy.facts)
        self.commits: Channel[Committed] | None = None
        self.lost: frozenset[str] = frozenset()
        self.malformed = 0
        self.tick = 0
        self.commands = Commands(self.agent, link.transport.incarnation)
        self._places = self.ownership.of[self.agent]
        self.own: tuple[int | None, ...] = (None,) * len(self._places)
        self._seen: list[int | None] = [None] * len(self._places)
        self.reported_held = False
        # Until when it waits for the team's word: that it was safe for missing teammates, whoever has released it.
        self._waits_for: frozenset[str] = frozenset()
        self._held_for: frozenset[str] = frozenset()
        self.storage: Storage | None = None
        self.stopped: StoredStop | None = None
        self._lasting: tuple[Cause, ...] = ()
        self._hears: list[Subscription[Any]] = []
        facts = msgspec.msgpack.encode(self.copy.facts)
        link.transport.serve(link.key(ensemble.name, "configuration"), lambda _: facts)

    # -- Life ----------------------------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Listen to the own layers."""
        channel = self.owner.channel
        self._dispatcher = self.runtime.dispatcher
        self._now = self._dispatcher.now
        self._waits_for = self._held_for = frozenset()
        if self.ownership.takes == "state":
            self._take_in(channel("own_state", State, retain=True), self._on_own_state)
        else:
            self._take_in(channel("own_observation", Observation), self._on_own_observation)
        if self.team.period is not None:
            self.tick = next_tick(self._now(), 1 / self.team.period) - 1
            self.every(1 / self.team.period, self._on_tick)
        self._hears = [self.link.watch(self._on_live, self)]
        if self.storage is not None:
            self.subscribe(channel("mode", Mode, retain=True), self._on_mode)

    def _take_in(self, channel: Channel[T], handler: Callable[[T], object]) -> None:
        channel.input = True  # users' code may publish there, where no layer covers this agent's factors
        self.subscribe(channel, handler)

    def on_stop(self) -> None:
        """Cancel the subscriptions."""
        self.link.drop(self._hears)

    def listen(self, expression: str, handler: Callable[[Sample], None]) -> None:
        """Handle the messages of other agents under the keys of an expression, until this layer stops."""
        self._hears.append(self.link.listen(expression, handler, self))

    def drop(self, sample: Sample, reason: str) -> None:
        """Count a message that is none, and refuse it."""
        self.malformed += 1
        self.link.refuse_sample(sample, reason)

    def _on_live(self, link: Link) -> None:
        if link.refusal is not None:
            self.pause()
        if self._waits_for and not self.unmet:  # wait no longer: the team decides
            self._waits_for = frozenset()
            now = self.runtime.now()
            self.ensemble.safety.stop(now)
            self.ensemble.safety.reopen(_UNMET, now)
        self.update_live(link)
        self.assess(self.runtime.now())

    @property
    def period(self) -> float | None:
        """Seconds from one joint step to the next; None where events make the steps."""
        return self.team.period

    @property
    def absence(self) -> str:
        """The missing agents whose factors of the state are unknown, and a remedy, in words; empty where none is."""
        state, live = self.ensemble.state, self.link.live
        known = () if state is None else state.joint
        pairs = zip(self.ownership.owners, known, strict=False)
        gone = [agent for agent, value in pairs if value is None and agent not in live]
        if not gone:
            return ""
        agents = dict.fromkeys(gone)
        told = " and ".join(f"agent {agent!r} {self.link.whereabouts(agent)}" for agent in agents)
        return f"{told}, and a state is made of the factors of all: start {'it' if len(agents) == 1 else 'them'} again"

    @property
    def awaited(self) -> tuple[str, ...]:
        """The agents that are not there and without which nothing is decided; none where it is decided."""
        if self.link.refusal is not None or getattr(self.statistics(), "role", "") not in {"joining", "waiting"}:
            return ()
        return tuple(agent for agent in self.team.names if agent not in self.link.live)

    @property
    def unmet(self) -> bool:
        """Whether it waits for teammates that were never met, by whom its team is to decide."""
        return not self.link.met

    def miss(self, text: str) -> None:
        """Be safe until the teammates that were never met come, or a person asks for a start."""
        if self.unmet and not self.still and self.stopped is None and self.link.refusal is None:
            self._waits_for = frozenset(self.team.names) - {self.agent}
            self.ensemble.safety.wait("missing_teammate", text, self.runtime.now())

    def pause(self) -> None:
        """Decide on nothing that was begun: this agent takes no part in the team now."""

    def report_loss(self, gone: Iterable[str], kind: str, text: str, lasts: Callable[[], bool]) -> None:
        """Report that agents are not there; where all have left in order, only if this one does not end, too."""
        if not all(agent in self.link.left and agent not in self.link.joined for agent in gone):
            self.report(kind, text)
            return

        def tell() -> None:
            if lasts() and not self.link.leaving:
                self.report(kind, text)

        self.call_later(_FAREWELL, tell)

    # -- Each kind of team ---------------------------------------------------------------------------------------

    def propose(self, part: bytes | None, now: int) -> None:
        """Propose this agent's part of the next step; None where it saw nothing."""
        raise NotImplementedError

    def request(self, command: str, token: str) -> None:
        """Order a command that was asked for here, at all agents."""
        raise NotImplementedError

    @property
    def still(self) -> bool:
        """Whether this agent carries out no decisions, since it took a stop that the team knows nothing of."""
        raise NotImplementedError

    @property
    def holds(self) -> bool:
        """Whether this agent stays stopped beside a team that decides."""
        return self.still and self.process.running

    @property
    def knows(self) -> object:
        """A plain value that is the same at agents that know of the same commands."""
        raise NotImplementedError

    @property
    def term(self) -> int:
        """The number of the term that it takes part in, or of its like in another kind of team."""
        raise NotImplementedError

    def memory(self) -> bytes | None:
        """Return the present stop, for another process to obey; None where it obeys none."""
        raise NotImplementedError

    def obey(self, memory: bytes) -> None:
        """Obey a stop of an earlier process; of one without memory nothing is known but that there may have been one.

        Raises:
            ValueError: If this is no memory of such a layer.
        """
        raise NotImplementedError

    def update_live(self, link: Link) -> None:
        """Update the live agents."""
        raise NotImplementedError

    # -- The own layers ------------------------------------------------------------------------------------------

    def command(self, command: Literal["start", "stop", "reset", "resume"], token: str | None = None) -> None:
        """Order a command that was asked for here, at the whole team; a stop stops this agent at once, too."""
        if command == "stop":
            self.ensemble.safety.stop(self.runtime.now())
        elif token is not None and self.commands.outcomes.get(token) in {DONE, PENDING}:
            return  # another agent was asked for the same, and has told this one
        self.request(command, self.commands.ask(command, token))
        self.keep(self.agent if command == "stop" else "")

    def report_void(self, token: str, reason: str) -> None:
        """Report that a command which was asked for here will not be done."""
        command = self.commands.name(token)
        self.commands.void(token, reason)
        after = "; this agent stays stopped until a start is asked for" if command == "stop" and self.still else ""
        self.report("void_command", f"{command}, asked for at {self.agent}, is void: {reason}{after}")

    def propose_values(self, values: Iterable[int | None], now: int) -> None:
        """Offer the values of this agent's factors."""
        self.propose(self.copy.part(now, values), now)

    def forget(self) -> None:
        """Discard the observations since the last tick: a command has come between."""
        self._seen = [None] * len(self._places)

    def _on_own_state(self, state: State) -> None:
        own = tuple(state.values[place] for place in self._places)
        if own != self.own:
            self.own = own
            if self.team.event_driven:
                self.propose_values(own, self._dispatcher.time)

    def _on_own_observation(self, observation: Observation) -> None:
        new = [observation.values[place] if observation.mask[place] else None for place in self._places]
        if new.count(None) == len(new):
            return
        if not self.team.event_driven:
            self._seen = [old if value is None else value for old, value in zip(self._seen, new, strict=True)]
        elif self.process.running:
            self.propose_values(new, self._dispatcher.time)

    def _on_tick(self, tick: Tick) -> None:
        self.tick = tick.number
        if not self.process.running:
            return
        if self.ownership.takes == "state":
            self.propose_values(self.own, self._dispatcher.time)
        elif any(value is not None for value in self._seen):
            seen = self._seen
            self.forget()
            self.propose_values(seen, self._dispatcher.time)
        else:
            self.propose(None, self._dispatcher.time)

    # -- Lost teammates ------------------------------------------------------------------------------------------

    def update_lost(self, lost: Iterable[str]) -> None:
        """Take note of the teammates that are lost."""
        self.lost = frozenset(lost)
        self.assess(self.runtime.now())

    def assess(self, now: int) -> None:
        """Go safe, hold or go on, by who is lost; safe as long as this agent is refused."""
        safety = self.ensemble.safety
        if self.link.refusal is not None:
            safety.endanger("refused", self.link.refusal, now, at_rest=True)
            return
        safety.reopen(_REFUSED, now)
        if safety.on_lost_teammate == "safe_action":
            if self.lost:
                safety.endanger("lost_teammate", f"lost: {', '.join(sorted(self.lost))}", now)
            else:
                safety.reopen(_TEAMMATE, now)
        elif safety.on_lost_teammate == "hold" and bool(self.lost) != bool(self._held_for):
            self._held_for = self.lost
            self.ensemble.action.bar(barred=bool(self.lost))
            if not self.lost:
                self.process.repeat(now)

    # -- Over the end of the process -----------------------------------------------------------------------------

    def keep(self, by: str = "") -> None:
        """Keep the stop that is obeyed over the end of the process; of a new one, who was asked for it."""
        memory, stop = self.memory(), self.stopped
        if memory is None:
            self.stopped = None
        elif stop is None or (by and (by, memory) != (stop.by, stop.memory)):
            self.stopped = StoredStop(by or self.agent, self.term, self.runtime.now(), memory)
        else:
            self.stopped = msgspec.structs.replace(stop, memory=memory)
        if self.storage is not None:
            self.storage.keep(self.ensemble.name, Stored(self.stopped, self._lasting))

    def _on_mode(self, mode: Mode) -> None:
        lasting = tuple(cause for cause in mode.causes if WAYS_BACK.get(cause.kind) == "release")
        if lasting != self._lasting:
            self._lasting = lasting
            self.keep()

    def bring_back(self) -> None:
        """Be as an earlier process of this agent was, if anything is stored of it."""
        stored = None if self.storage is None else self.storage.recall(self.ensemble.name)
        if stored is None or stored == Stored():
            return

        def note(stored: Stored) -> None:
            told = msgspec.json.encode(stored)
            self.runtime.observers.tell(Recalled, self.runtime.now(), self.ensemble.name, told)
            self.recall(stored)

        self.runtime.dispatcher.deliver(Subscription(None, self, note), stored)

    def recall(self, stored: Stored) -> None:
        """Be stopped, and wait for a release, as an earlier process was."""
        self.stopped, self._lasting = stored.stop, stored.causes
        told = []
        if stored.stop is not None:
            try:
                self.obey(stored.stop.memory)
            except UNREADABLE:  # of a team of another mode
                self.obey(b"")
            told.append(f"is {stored.stop}: start the team to have it decide")
        if stored.causes:
            self.ensemble.safety.recall(stored.causes, self.runtime.now())
            told.append(f"waits for a release: {', '.join(cause.detail for cause in stored.causes)}")
        self.report("held", f"{self.agent} {', and '.join(told)}")

    # -- Steps ---------------------------------------------------------------------------------------------------

    def report_held(self, *, settled: bool) -> None:
        """Report once that this agent stays stopped while the others decide, once the team knows of its stop."""
        held = settled and self.holds
        if held and not self.reported_held:
            self.report("held", f"{self.agent} was stopped, and stays so while the team decides: start the team again")
        self.reported_held = held

    def apply_command(self, command: str, token: str, now: int, by: str = "") -> None:
        """Carry out a command of the team; an agent that stays stopped decides as the others do, without acting."""
        self.copy.command(command, now, still=self.still and command != "stop")
        self.forget()
        self.commands.done(token)
        self.keep(by if command == "stop" else "")

    def publish_commit(
        self,
        term: tuple[int, str, int],
        step: int,
        inputs: Mapping[str, bytes],
        missing: Iterable[str],
        command: str | None,
        *,
        action: int | None,
        digest: str,
        caught_up: bool = False,
    ) -> None:
        """Publish a step, if the channel has a subscriber."""
        if self.commits is None or not self.commits.heard:
            return
        self.commits.publish(
            Committed(
                time=self.runtime.now(),
                agent=self.agent,
                ensemble=self.ensemble.name,
                term=term,
                step=step,
                input=self.copy.named(inputs),
                missing=tuple(missing),
                command=command,
                action=None if action is None else self.ensemble.controller.symbols.action_name(action),
                digest=digest,
                caught_up=caught_up,
            )
        )


def _check(team: Team, agent: str, ensemble: Ensemble, agents: tuple[str, ...]) -> None:
    """Refuse an ensemble that is none of a team."""
    key, status = f"ensembles.{ensemble.name}", ensemble.status()
    if ensemble.local:
        raise ConfigError(
            f"ensemble {ensemble.name!r} runs its agent's own plan, which needs no agreement: leave out local, or the "
            "team",
            key=f"{key}.local",
        )
    if not isinstance(status.drive, OnEvent):
        raise ConfigError(
            f"ensemble {ensemble.name!r} has a drive of its own, but its team {team.name!r} says when it decides: "
            "leave it out",
            key=f"{key}.drive",
        )
    if status.deadline is not None and not status.searches:
        raise ConfigError(
            f"ensemble {ensemble.name!r} has a deadline, from its stimulus to its decision, but in a team a step waits "
            "for the agents' parts, for the deadline of the team at most: leave it out",
            key=f"{key}.deadline",
        )
    if status.on_no_observation != "predict":
        raise ConfigError(
            f"on_no_observation of ensemble {ensemble.name!r} is for an agent alone: in a team, what nobody has "
            "observed is summed over",
            key=f"{key}.on_no_observation",
        )
    if agent in agents and ensemble.agent != agents.index(agent):
        raise ConfigError(
            f"ensemble {ensemble.name!r} acts for the model's agent {ensemble.agent}, but {agent!r} is agent "
            f"{agents.index(agent)}: give it agent={agents.index(agent)}",
            key=f"{key}.agent",
        )
