"""Communicating teams: their agents decide for themselves, and share experiences as they choose.

There is no agreement. All agents number their steps by the same ticks, so that an experience of a step belongs to that
step at every other, whenever it arrives.
"""

from __future__ import annotations

import copy
from enum import Enum
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.errors import ConfigError, ModelError
from mdm.messages import Fault
from mdm.models.digest import of_parts
from mdm.runtime import ActorStatistics, Subscription
from mdm.runtime.time.scheduler import next_tick
from mdm.team.knowledge import Experience, Knowledge, SharedHistory
from mdm.team.layer import TeamLayer
from mdm.team.ownership import acting
from mdm.team.transport.bounds import HOUR, UNREADABLE, Name, Number, Text, can_be
from mdm.team.transport.keys import join

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from mdm.actors import Ensemble
    from mdm.messages import Tick
    from mdm.runtime import Timer
    from mdm.team.link import Link
    from mdm.team.ownership import Placement
    from mdm.team.team import Team
    from mdm.team.transport.transport import Sample

_MOST = 1 << 62
"""No stop has a number as great: they are about as many as nanoseconds have passed since 1970."""

_LONGEST_GAP = 1_000
"""Steps without an observation that an agent goes through to come to the present one; it leaves out those before."""

_MOST_EARLY = 256
"""Experiences that are kept until the first step comes."""


class Episode(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """An episode of a communicating team, or the time between two of them.

    Args:
        number: It grows with each command.
        origin: The number of the tick of step 0: ticks are at multiples of the period since 1970, on every clock.
        by: Who began it.
        running: Whether the agents decide in it, unless one of them was stopped that this does not know of.
        stops: The last stop of each agent of which the agent that began it knew.
        token: The identifier of the command that began it.
    """

    number: Number
    origin: Number
    by: Name
    running: bool
    stops: dict[Name, Number] = {}
    token: Name = ""

    def supersedes(self, other: Episode | None) -> bool:
        """Whether it counts in place of another: the later command does, and of two at once the earlier origin.

        Of any two that differ one does, so that all come to the same. Those of one agent at one time differ where
        another has spoken in its name: then a stop counts.
        """
        return other is None or self.rank > other.rank

    @property
    def rank(self) -> tuple[Any, ...]:
        """The order of episodes; no two that differ have the same."""
        return self.number, -self.origin, self.by, not self.running, sorted(self.stops.items()), self.token


class Stops:
    """The last stop of each agent that one of them knows of; a later one has a greater number, in any life of an agent.

    A stop wins over every start whose sender did not know of it, whichever came first.

    Args:
        agents: All agents.

    Attributes:
        last: The numbers, by agent.
    """

    def __init__(self, agents: Iterable[str]) -> None:
        self._agents = frozenset(agents)
        self.last: dict[str, int] = {}

    def take(self, agent: str, life: int) -> None:
        """Take note of a stop that is asked of an agent."""
        self.last[agent] = max(self.last.get(agent, 0), life) + 1

    def hear(self, others: Mapping[str, int]) -> None:
        """Take note of the stops that another agent knows of."""
        for agent, number in others.items():
            if agent in self._agents and self.last.get(agent, 0) < number < _MOST:
                self.last[agent] = number

    def allow(self, episode: Episode) -> bool:
        """Return whether the agents decide in an episode."""
        return episode.running and all(episode.stops.get(agent, 0) >= number for agent, number in self.last.items())


class Update(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """A message of an agent to all others.

    Args:
        episode: The episode that it is in.
        configuration: The digest of the configuration, which must be the same at all agents.
        experiences: The part of its history that it shares; their steps count from the episode's origin.
        stops: The last stop of each agent that it knows of.
    """

    episode: Episode
    configuration: Text
    experiences: tuple[Experience, ...] = ()
    stops: dict[Name, Number] = {}


class Standstill(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """The stop that an agent obeys, as it outlives its process.

    Args:
        episode: The episode in which nothing is decided; None where there was none.
        stops: The stops that the agent knew of.
    """

    episode: Episode | None
    stops: dict[Name, Number]


encode = msgspec.msgpack.Encoder().encode
decode = msgspec.msgpack.Decoder(Update).decode


class CommunicatingStatistics(ActorStatistics, frozen=True):
    """Where an agent of a communicating team stands.

    Attributes:
        role: ``talking``; ``joining`` before the first episode; ``refused`` where it
            takes no part, for agents that were there before it have another configuration.
        term: The number of the episode.
        step: The present step.
        digest: Of the agent's knowledge.
        members: The agents that it hears, itself included.
        sent: Messages with a part of the history, each to all others.
        held: Of those, messages that the transport did not take; they are lost.
        heard: Experiences of others that came.
        late: Of those, applied to a step before the present one.
        too_late: Of those, not applied: from before the window, or before this agent came.
        refused: Of those, not applied: from far ahead, or another thing than was told before.
        malformed: Messages that were none.
    """

    role: str
    term: int
    step: int
    digest: str
    members: tuple[str, ...]
    sent: int
    held: int
    heard: int
    late: int
    too_late: int
    refused: int
    malformed: int


class Steps:
    """An agent's steps in an episode, and the experiences of others by these.

    The knowledge of an agent that comes late begins at a later step: it has not seen those before.

    Args:
        knowledge: The agent's knowledge.
        agents: The agents of the model, in its order.

    Attributes:
        begin: The step of the episode at which the knowledge begins; None before the first step here.
        last_of: The last step that each agent has reported.
        before: How many experiences were of steps before the first one here.
    """

    def __init__(self, knowledge: Knowledge, agents: tuple[str, ...]) -> None:
        self.begin: int | None = None
        self.last_of: dict[str, int] = {}
        self.before = 0
        self._knowledge = knowledge
        self._agents = agents
        self._early: list[tuple[str, Experience]] = []

    def leave(self) -> None:
        """Leave the episode."""
        self.begin = None
        self.last_of.clear()
        self._early.clear()

    @property
    def present(self) -> int:
        """The step that this agent has come to; 0 before the first one here."""
        return 0 if self.begin is None else self._knowledge.step + self.begin

    def arrive(self, step: int, horizon: int | None) -> list[tuple[str, Experience]]:
        """Come to the first step here; return the experiences that came before it, to be heard now."""
        unseen = min(step, _LONGEST_GAP) if horizon is None else step % horizon
        self.begin = step - unseen
        self._knowledge.start()
        for _ in range(unseen):
            self._knowledge.observe()
        self._knowledge.unshared = ()
        early, self._early = self._early, []
        return early

    def go_on(self, step: int, did: int | None, seen: int | None) -> None:
        """Go on to a step, with the observation and the action since the last one."""
        self._knowledge.act(did)
        for _ in range(step - self.present - 1):
            self._knowledge.observe()
        self._knowledge.observe(seen)

    def share(self, seconds: float) -> tuple[Experience, ...] | None:
        """Return the choice of the communication policy, after so many seconds; None for silence."""
        history = self._knowledge.share(seconds)
        begin = self.begin or 0
        return None if history is None else tuple(_moved(each, begin) for each in history.experiences)

    def hear(self, agent: str, experiences: tuple[Experience, ...]) -> tuple[int, int]:
        """Take the experiences that another agent shares; return how many count, and how many could but do not.

        Raises:
            ModelError: If one of them cannot be.
        """
        if self.begin is None:
            self._early += ((agent, experience) for experience in experiences)
            del self._early[:-_MOST_EARLY]
            return 0, 0
        known = tuple(each for each in (_moved(one, -self.begin) for one in experiences) if each.step >= 1)
        self.before += len(experiences) - len(known)
        unapplied = self._knowledge.hear(SharedHistory(self._agents.index(agent), known))
        steps = [each.step + self.begin for each in known if each.step <= self._knowledge.step + 1]
        self.last_of[agent] = max([self.last_of.get(agent, 0), *steps])
        return len(known) - unapplied, unapplied


def _moved(experience: Experience, steps: int) -> Experience:
    return Experience(experience.step + steps, experience.action, experience.observation)


class Stage(Enum):
    """How far an agent is with a step."""

    DECIDED = "it has decided on the last step, and waits for the next tick"
    LISTENING = "it waits for the experiences of others"
    ANSWERING = "it has just heard some, and asks its communication policy once more behind them"


class CommunicatingLayer(TeamLayer):
    """The last layer of an ensemble in a communicating team.

    At each tick the agent observes, shares the choice of its communication policy, hears the others, and decides: as
    soon as all live agents have reported the step, or the team's deadline after the tick is over.

    Raises:
        ConfigError: If the ensemble cannot be one of a communicating team.

    Attributes:
        knowledge: The agent's knowledge.
        episode: The present episode; None before the first.
        stops: The stops that it knows of.
        steps: The steps of the episode, as this agent has come to them.
        stage: How far it is with the present step.
    """

    def __init__(self, team: Team, ensemble: Ensemble, link: Link, placement: Placement) -> None:
        key = f"ensembles.{ensemble.name}"
        _check_options(ensemble, key)
        first = link.transport.protocol == 1
        super().__init__("talker" if first else "communicator", team, ensemble, link, placement)
        self._agents = acting(team, ensemble, placement)
        if self.ownership.owners != self._agents:
            raise ConfigError(
                f"in a communicating team each agent tells its own component of the observation; of ensemble "
                f"{ensemble.name!r} the components are told by {', '.join(self.ownership.owners)}, and the agents are "
                f"{', '.join(self._agents)}",
                key=f"{key}.observations",
            )
        try:
            self.knowledge = Knowledge.of(
                ensemble.controller, self.process.another, ensemble.agent, copy.deepcopy(team.communication)
            )
        except ConfigError as error:
            raise ConfigError(error.message, key=f"{key}.policy") from None
        self.episode: Episode | None = None
        self.stops = Stops(team.names)
        self._configuration = link.configuration.token(ensemble.name)
        self._key = link.key(ensemble.name, "update")
        if first:
            self._key = join(team.name, self.agent, ensemble.name, "word")
        self.steps = Steps(self.knowledge, self._agents)
        self._first_tick: int | None = None
        self.stage = Stage.DECIDED
        self._step_at = 0, 0
        """The step that it decides on, and the time of its tick."""
        self._timer: Timer | None = None
        self._did: int | None = None
        self._reported: set[tuple[str, str]] = set()
        self._problem: str | None = None
        self._symbol = self.ownership.idle[ensemble.agent]
        self._sent = self._held_back = 0

    # -- Life ----------------------------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Listen to the own layers and to the other agents."""
        self.stage, self._timer = Stage.DECIDED, None
        super().on_start()
        channel = self._key.rpartition("/")[2]
        self.listen(join(self.team.name, "*", self.ensemble.name, channel), self._on_update)
        self.every(1 / self.team.lease, lambda _: self._send())
        self.call_later(self.team.lease, self._begin)  # by when this agent has heard of an episode that there is

    def on_running(self) -> None:
        """Go on after a failure."""
        if self._decides:
            self.process.run(running=True)
            self.ensemble.safety.start(self.runtime.now())

    def update_live(self, _link: Link) -> None:
        """Take note of who is live: newcomers get the episode, and nobody waits for who is gone."""
        self._send()
        self._close()

    @property
    def unmet(self) -> bool:
        """Whether it waits for others: never, for each agent decides on its own knowledge."""
        return False

    def pause(self) -> None:
        """Decide on nothing that was begun."""
        self.stage = Stage.DECIDED
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    # -- Episodes ------------------------------------------------------------------------------------------------

    def _begin(self) -> None:
        """Begin the first episode where there is none and nobody was stopped, if this is the first agent that is there.

        One that is refused looks again later: it may not be for long.
        """
        if self.episode is not None or self.stops.last:
            return
        first = next((agent for agent in self._agents if agent in self.link.live), self.agent)
        if self.link.refusal is None and first == self.agent:
            self.request("start", "")
        else:
            self.call_later(self.team.lease, self._begin)

    def request(self, command: str, token: str) -> None:
        """Begin an episode, or end it, at all agents."""
        if command == "stop":
            self.stops.take(self.agent, self.link.transport.incarnation)
        if self.link.refusal is not None:
            if token:
                self.report_void(token, f"{self.agent} takes no part in the team")
            return
        number, running = 0 if self.episode is None else self.episode.number, self._decides
        if command in {"start", "resume"} and running:
            self.commands.done(token)
            return
        assert self.team.period is not None
        behind = self.runtime.now() + round(self.team.deadline * 1e9)  # by when all will have heard of it
        origin = next_tick(behind, 1 / self.team.period)
        decides = command != "stop" and (command != "reset" or running)
        self._enter(Episode(number + 1, origin, self.agent, decides, dict(self.stops.last), token))

    @property
    def _decides(self) -> bool:
        """Whether the agents decide in the present episode."""
        return self.episode is not None and self.stops.allow(self.episode)

    @property
    def still(self) -> bool:
        """Whether nothing is decided here in an episode in which others may decide, since a stop came before it."""
        return self.episode is not None and self.episode.running and not self._decides

    @property
    def holds(self) -> bool:
        """The same: there is no team that decides but the agents, each for itself."""
        return self.still

    @property
    def knows(self) -> object:
        """The stops that this agent knows of."""
        return dict(sorted(self.stops.last.items()))

    @property
    def term(self) -> int:
        """The number of the episode."""
        return 0 if self.episode is None else self.episode.number

    def memory(self) -> bytes | None:
        """Return the episode in which nothing is decided, and the stops that are known."""
        if self._decides or (self.episode is None and self.agent not in self.stops.last):
            return None
        return msgspec.msgpack.encode(Standstill(self.episode, dict(sorted(self.stops.last.items()))))

    def obey(self, memory: bytes) -> None:
        """Be in that episode, until another one that was begun by somebody who knew of these stops."""
        if memory:
            standstill = msgspec.msgpack.decode(memory, type=Standstill)
            self.stops.hear(standstill.stops)
        else:
            standstill = Standstill(None, {})
            self.stops.take(self.agent, self.link.transport.incarnation)
        self.episode = standstill.episode or Episode(1, 0, self.agent, running=False, stops=dict(self.stops.last))

    def _enter(self, episode: Episode) -> None:
        now = self.runtime.now()
        self.episode = episode
        self.pause()
        self.steps.leave()
        self._problem = None
        self.forget()
        decides = self._decides
        self.process.run(running=decides)
        if decides:
            self.ensemble.safety.start(now)
        else:
            self.ensemble.safety.stop(now)
        self.commands.done(episode.token)
        self._publish_commit(0, (), "start" if decides else "stop", None)
        if self.still:
            self._report_void_start(episode)
        self.keep("" if episode.running else episode.by)
        self._send()

    def _receive_stops(self, word: Update) -> None:
        """Take note of the stops that another agent knows of; one that beats the episode's start ends it."""
        decided = self._decides
        self.stops.hear(word.stops)
        self.stops.hear(word.episode.stops)
        if self._decides or self.episode is None:
            return
        self.keep()
        if decided:
            self.pause()
            self.process.run(running=False)
            self.ensemble.safety.stop(self.runtime.now())
            self._report_void_start(self.episode)
            self._send()

    def _report_void_start(self, episode: Episode) -> None:
        """Tell that the start of an episode is void, where it was asked for here."""
        if episode.by == self.agent and episode.token:
            self.report_void(episode.token, "a stop was asked for elsewhere before it was known there")

    def _send(self, experiences: tuple[Experience, ...] = ()) -> bool:
        """Send the episode of this agent, and the experiences that it shares."""
        if self.episode is None:
            return False
        word = Update(self.episode, self._configuration, experiences, self.stops.last)
        return self.link.send(self._key, encode(word), priority="step")

    # -- Steps ---------------------------------------------------------------------------------------------------

    def forget(self) -> None:
        """Discard the observations of another episode."""
        super().forget()
        self._symbol = self.ownership.idle[self.ensemble.agent]

    def _on_tick(self, tick: Tick) -> None:
        self.tick = tick.number
        if self._first_tick is None:
            self._first_tick = tick.number
        if self.link.refusal is not None or self.episode is None or tick.number < self.episode.origin:
            return
        if not self._decides:
            return
        self._decide()
        step, steps = tick.number - self.episode.origin, self.steps
        if steps.begin is None or step - steps.present > _LONGEST_GAP:
            early = steps.arrive(step, self.ensemble.controller.horizon)
            self.forget()
            for agent, experience in early:
                self._receive(agent, (experience,))
        else:
            doing = self._doing()
            [seen] = self._seen
            super().forget()
            if seen is None:
                seen = self._symbol
            elif self.ownership.hold[self.ensemble.agent]:
                self._symbol = seen
            steps.go_on(step, doing if doing == self._did else None, seen)
        self.stage, self._step_at = Stage.LISTENING, (step, tick.time)
        self._timer = self.call_later(self.team.deadline, self._decide)
        self._share()

    def _doing(self) -> int | None:
        """This agent's own component of the real action, by index; None where that is none of the model's."""
        ensemble = self.ensemble
        if ensemble.mode == "safe":
            safe, bindings = ensemble.action.safe, ensemble.action.bindings
            return bindings.index(safe) if safe is not None and safe in bindings else None
        if ensemble.action.barred:
            return self._did
        return self.knowledge.component

    def _share(self, _: None = None) -> None:
        """Ask the communication policy, send its choice, and decide where nothing is to be waited for any more."""
        if self.stage is Stage.DECIDED:
            return
        self.stage = Stage.LISTENING
        assert self._first_tick is not None
        shared = self.steps.share((self.tick - self._first_tick) * (self.team.period or 0.0))
        if shared is not None:
            self._sent += 1
            self._held_back += not self._send(shared)
        self._close()

    def _close(self) -> None:
        """Decide, where nothing is to be waited for any more."""
        if self.stage is not Stage.LISTENING:
            return
        step, _ = self._step_at
        if step and not getattr(self.team.communication, "silent", False):
            for agent in self._agents:
                waited_for = agent != self.agent and agent in self.link.live
                if waited_for and self.steps.last_of.get(agent, 0) < step:
                    return
        self._decide()

    def _decide(self) -> None:
        """Decide by the present knowledge."""
        if self.stage is Stage.DECIDED:
            return
        step, time = self._step_at
        self.pause()
        ensemble, controller = self.ensemble, self.ensemble.controller
        decided = self.knowledge.decide()
        if controller.problem is not None and controller.problem != self._problem:
            self.runtime.faults.publish(Fault(time, ensemble.path, "impossible_observation", controller.problem))
        self._problem = controller.problem
        self.process.announce(decided, time, "tick", self.knowledge.own.observed)
        self._did = self._doing()
        others = (agent for agent in self._agents if agent != self.agent)
        missing = tuple(agent for agent in others if self.steps.last_of.get(agent, 0) < step)
        self._publish_commit(step, missing, None, decided.action)

    def _publish_commit(self, step: int, missing: tuple[str, ...], command: str | None, action: int | None) -> None:
        if self.commits is None or not self.commits.heard or self.episode is None:
            return
        inputs = {}
        if command is None:
            seen = self.knowledge.own.components
            inputs = {
                agent: self.copy.part(0, (value,))
                for agent, value in zip(self._agents, seen, strict=True)
                if value is not None
            }
        episode = self.episode
        term = (episode.number, episode.by, episode.origin)
        self.publish_commit(
            term, step, inputs, missing, command, action=action, digest=of_parts([self.process.snapshot()])
        )

    # -- Receiving -------------------------------------------------------------------------------------

    def _on_update(self, sample: Sample) -> None:
        try:
            word = decode(sample.body)
        except UNREADABLE as error:
            self.drop(sample, f"is no word: {error}")
            return
        if (reason := _is_impossible(word, self.team, self.runtime.now())) is not None:
            self.drop(sample, reason)
            return
        if word.configuration != self._configuration or self.link.refusal is not None:
            return  # the link says so
        agent = sample.owner
        self._receive_stops(word)
        if word.episode.supersedes(self.episode):
            self._enter(word.episode)
        elif word.episode != self.episode:
            self._send()
            return
        if word.experiences and agent in self._agents:
            self._receive(agent, word.experiences)

    def _receive(self, agent: str, experiences: tuple[Experience, ...]) -> None:
        """Take the experiences that another agent shares."""
        try:
            counts, unapplied = self.steps.hear(agent, experiences)
        except ModelError as error:
            self.malformed += 1
            self._report_once("word", agent, f"{agent} says what cannot be: {error}")
            return
        problem = self.knowledge.own.problem
        if unapplied and problem is not None:
            self._report_once("history", agent, f"not everything that {agent} said counts: {problem}")
        if counts and self.stage is Stage.LISTENING:  # and the policy may answer, behind all that has just arrived
            self.stage = Stage.ANSWERING
            turn: Subscription[None] = Subscription(None, self, self._share)
            self.runtime.dispatcher.deliver_behind(turn, None)

    def _report_once(self, kind: str, agent: str, text: str) -> None:
        if (kind, agent) not in self._reported:
            self._reported.add((kind, agent))
            self.report(kind, text)

    # -- Where it stands -----------------------------------------------------------------------------------------

    def statistics(self) -> CommunicatingStatistics:
        """Return where it stands."""
        counts = self.knowledge.own.statistics()
        episode = self.episode
        return CommunicatingStatistics(
            **msgspec.structs.asdict(super().statistics()),
            role="refused" if self.link.refusal is not None else "joining" if episode is None else "talking",
            term=0 if episode is None else episode.number,
            step=self.steps.present,
            digest=of_parts([self.process.snapshot()]),
            members=tuple(self.link.live),
            sent=self._sent,
            held=self._held_back,
            heard=counts.heard + self.steps.before,
            late=counts.late,
            too_late=counts.too_late + self.steps.before,
            refused=counts.too_early + counts.contradictory,
            malformed=self.malformed,
        )


def _is_impossible(word: Update, team: Team, now: int) -> str | None:
    """Return why an update cannot be, if it cannot."""
    episode = word.episode
    assert team.period is not None
    latest = next_tick(now + round((team.deadline + team.lease) * 1e9), 1 / team.period)
    if not can_be(episode.number, now):
        return f"is of episode {episode.number}, which cannot be yet"
    if episode.by not in team.names:
        return f"is of an episode that {episode.by!r} began, who is none of the team"
    if episode.origin > latest:
        return f"is of an episode that begins at tick {episode.origin}, more than a lease ahead"
    if any(number > now + HOUR for stops in (word.stops, episode.stops) for number in stops.values()):
        return "reports a stop that cannot have been yet"
    return None


def _check_options(ensemble: Ensemble, key: str) -> None:
    """Refuse options that an ensemble of a communicating team cannot have."""
    name, status, controller = ensemble.name, ensemble.status(), ensemble.controller
    if status.searches:
        raise ConfigError(
            f"ensemble {name!r} searches, but the agents of a communicating team have to foresee each other's "
            "decisions: give it a policy that was computed",
            key=f"{key}.policy",
        )
    if controller.takes == "state":
        raise ConfigError(
            f"ensemble {name!r} decides on states, but the agents of a communicating team share what they observe: "
            "give it a policy over beliefs",
            key=f"{key}.policy",
        )
    if status.deadline is not None:
        raise ConfigError(
            f"in a communicating team the period and its deadline say when ensemble {name!r} decides: leave its "
            "deadline out",
            key=f"{key}.deadline",
        )
    if controller.on_impossible == "safe_action":
        raise ConfigError(
            "in a communicating team what seems impossible may be what others did unseen: on_impossible is 'predict', "
            "'keep' or 'reset'",
            key=f"{key}.on_impossible",
        )
