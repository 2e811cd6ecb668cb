"""The correspondent: an agent of a communicating team, which decides on what it knows, and shares what is worth it.

Steps are counted by the ticks of the team's period since its episode began. The agents tell each other which episode
that is; of two, that of the greater number counts, else the earlier.
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import msgspec

from mdm.errors import ConfigError, ModelError
from mdm.messages import Action
from mdm.models.digest import of_parts
from mdm.runtime import ActorStatistics
from mdm.team.communication import Always
from mdm.team.keys import join
from mdm.team.knowledge import Knowledge, SharedHistory
from mdm.team.layer import TeamLayer
from mdm.team.ownership import acting

if TYPE_CHECKING:
    from mdm.actors import Ensemble
    from mdm.messages import Tick
    from mdm.runtime import Timer
    from mdm.team.link import Link
    from mdm.team.placement import Placement
    from mdm.team.team import Team
    from mdm.team.transport import Sample

__all__ = ["Correspondent", "CorrespondentStatistics"]


class Episode(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """Which episode the team is in.

    Args:
        number: Counted from 1, with each command.
        tick: The tick of its first decision.
        running: Whether the team decides in it.
        configuration: A hash of all that must be the same at every agent.
    """

    number: int
    tick: int
    running: bool
    configuration: str


class Shared(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """What an agent shares of its history, and in which episode."""

    episode: int
    history: SharedHistory


class _Versions(msgspec.Struct, frozen=True):
    """An agent's answer to the call ``versions``."""

    result: dict[str, str]


_encode = msgspec.msgpack.Encoder().encode
_episode = msgspec.msgpack.Decoder(Episode).decode
_shared = msgspec.msgpack.Decoder(Shared).decode
_facts = msgspec.json.Decoder(_Versions).decode


class CorrespondentStatistics(ActorStatistics, frozen=True):
    """Where an agent of a communicating team stands.

    Attributes:
        role: ``deciding``, ``joining`` before it knows of an episode, or ``refused``.
        episode: The number of the episode.
        step: The last decision, counted from 1.
        digest: Of what it knows; agents that know the same have the same.
        shared: Messages to all others.
        heard: Messages of others.
        late: Experiences that came too late, and messages of other episodes.
        malformed: Messages that were none.
    """

    role: str
    episode: int
    step: int
    digest: str
    shared: int
    heard: int
    late: int
    malformed: int


class Correspondent(TeamLayer):
    """The last layer of an ensemble in a communicating team.

    At each tick it takes what the agent has observed, shares what the team's communication policy chooses, hears the
    others until the deadline after the tick, and then decides.

    Args:
        team: The team; it has a period.
        ensemble: The ensemble, for which it decides.
        link: What connects this agent with the others.
        placement: Where the ensemble's layers are.

    Raises:
        ConfigError: If the ensemble cannot be decided so.
    """

    def __init__(self, team: Team, ensemble: Ensemble, link: Link, placement: Placement) -> None:
        super().__init__("correspondent", team, ensemble, link, placement)
        self._order = acting(team, ensemble, placement)
        _check_parts(team, ensemble, self._order, self.parts.owners, self.agent, takes=self.parts.takes)
        self._knowledge = self._made()
        self._configuration = of_parts([_encode(sorted(self.copy.facts.items()))])
        self._key = link.key(ensemble.name, "history")
        self._clock_key = link.key(ensemble.name, "episode")
        self._now: Episode | None = None
        self._held_value: int | None = None
        self._observed: bytes | None = None
        self._patience = 0
        self._timer: Timer | None = None
        self._refused = False
        self._differing: set[tuple[str, int]] = set()
        self._decided = 0
        self._shared = self._heard = self._late = 0

    def _made(self) -> Knowledge:
        controller = self.ensemble.controller
        kept = controller.snapshot()
        controller.start()
        belief = controller.belief
        controller.restore(kept)
        assert controller.model is not None
        return Knowledge(
            controller.policy,
            controller.model,
            self._order.index(self.agent),
            copy.deepcopy(self.team.communication or Always()),
            initial_belief=belief,
            on_impossible=controller.on_impossible,
        )

    # -- Life ----------------------------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Listen to the own layers and to the other agents."""
        self._now = self._timer = None
        self._patience = self.runtime.clock.now() + round(self.team.lease * 1e9)
        super().on_start()
        for channel, handler in (("episode", self._on_episode), ("history", self._on_history)):
            self.hear(join(self.team.name, "*", self.ensemble.name, channel), handler)
        self.every(4 / self.team.lease, lambda _: self._put_episode())

    def take_live(self, _link: Link) -> None:
        """Tell who has just come which episode it is."""
        self._put_episode()
        self.assess(self.runtime.clock.now())

    # -- Episodes ------------------------------------------------------------------------------------------------

    def ask_for(self, command: str) -> None:
        """Begin an episode at all agents, in which they decide or do not."""
        if self._refused:
            return
        number = 0 if self._now is None else self._now.number
        self._begin(Episode(number + 1, self._next_tick, command != "stop", self._configuration))

    @property
    def _next_tick(self) -> int:
        """The number of the next tick; before the first one it goes by the clock."""
        assert self.team.period is not None
        return 1 + (self.tick or int(self.runtime.clock.time() / self.team.period))

    def _begin(self, episode: Episode) -> None:
        now = self.runtime.clock.now()
        self._now = episode
        self._decided = 0
        self._knowledge.start()
        self.forget()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self.ensemble.control.running = episode.running
        if not episode.running:
            self.ensemble.safety.stop(now)
        elif self.ensemble.mode == "stopped":
            self.ensemble.safety.start(now)
        self._put_episode()

    def _put_episode(self) -> None:
        if self._now is not None:
            self.link.put(self._clock_key, _encode(self._now), priority="step")

    def _on_episode(self, sample: Sample) -> None:
        try:
            theirs = _episode(sample.body)
        except (msgspec.MsgspecError, ValueError):
            self.malformed += 1
            return
        if theirs.configuration != self._configuration:
            self._part_with(sample.owner, sample.incarnation)
            return
        ours = self._now
        if self._refused:
            return
        if ours is None or (theirs.number, -theirs.tick) > (ours.number, -ours.tick):
            self._begin(theirs)

    def _part_with(self, agent: str, life: int) -> None:
        """Hear no more of an agent with another configuration; who has no episode yet takes no part itself."""
        if self._now is None:
            self._refused = True
        if (agent, life) not in self._differing:
            self._differing.add((agent, life))
            self.spawn(self._compare(agent), name="compare")

    async def _compare(self, agent: str) -> None:
        """Report the first difference between an agent's configuration and this one's."""
        answers = await self.link.ask(join(self.team.name, agent, self.ensemble.name, "versions"))
        try:
            theirs = _facts(answers[agent]).result
        except (KeyError, msgspec.MsgspecError):
            theirs = {}
        ours = self.copy.facts
        difference = next(
            (
                f"{fact} is {ours.get(fact, 'nothing')} at {self.agent} and {theirs.get(fact, 'nothing')} at {agent}"
                for fact in sorted({*ours, *theirs})
                if theirs and ours.get(fact) != theirs.get(fact)
            ),
            f"{self.agent} and {agent} have other models, policies or settings",
        )
        who = self.agent if self._refused else agent
        self.report("refused", f"{who} cannot take part in the team: {difference}")

    # -- Steps ---------------------------------------------------------------------------------------------------

    def _on_tick(self, tick: Tick) -> None:
        self.tick = tick.number
        if self._refused:
            return
        if self._now is None:
            live = [agent for agent in self._order if agent in self.link.live]
            if live[:1] == [self.agent] and self.runtime.clock.now() >= self._patience:
                self._begin(Episode(1, tick.number + 1, True, self._configuration))
            return
        step = tick.number - self._now.tick
        if not self._now.running or step < 0:
            return
        if self._timer is not None:  # the tick before was late
            self._timer.cancel()
            self._decide()
        if not self._catch_up(step - 1):
            return
        if self._knowledge.step < step:
            self._knowledge.observe(self._observation())
            self._share()
        self._timer = self.call_later(self.team.deadline, self._decide)

    def _catch_up(self, step: int) -> bool:
        """Take steps of which nothing was seen here; return whether that is done, which may take several ticks."""
        knowledge, now = self._knowledge, self.runtime.clock.now
        until = now() + round(self.team.deadline * 0.5e9)
        while knowledge.step < step:
            if now() > until:
                self.forget()
                return False
            knowledge.observe(None)
        return True

    def _observation(self) -> int | None:
        """Return what the agent has observed since the last tick; its idle or held symbol where it saw nothing."""
        (place,), (value,) = self._places, self._seen
        self._observed = None if value is None else self.copy.part(self.runtime.clock.now(), (value,))
        if value is None:
            value = self._held_value if self._held_value is not None else self.parts.idle[place]
        elif self.parts.hold[place]:
            self._held_value = value
        self.forget()
        return value

    def _share(self) -> None:
        assert self._now is not None
        history = self._knowledge.share(self.runtime.clock.now() / 1e9)
        if history is not None and self.link.put(self._key, _encode(Shared(self._now.number, history))):
            self._shared += 1

    def _on_history(self, sample: Sample) -> None:
        try:
            shared = _shared(sample.body)
        except (msgspec.MsgspecError, ValueError):
            self.malformed += 1
            return
        if self._now is None or shared.episode != self._now.number:
            self._late += 1
            return
        if sample.owner not in self._order or self._order.index(sample.owner) != shared.history.agent:
            self.malformed += 1
            return
        try:
            self._late += self._knowledge.hear(shared.history)
        except ModelError:
            self.malformed += 1
            return
        self._heard += 1
        if self._timer is not None:
            self._share()

    def _decide(self) -> None:
        assert self._now is not None
        self._timer = None
        now = self.runtime.clock.now()
        step = self._knowledge.decide()
        self._decided = self._knowledge.step + 1
        self.ensemble.control.carry_out(Action(now, self._knowledge.step, step.action))
        inputs = {} if self._observed is None else {self.agent: self._observed}
        self.tell(
            *((self._now.number, self.agent, self.link.transport.incarnation), self._decided, inputs, (), None),
            action=step.action,
            digest=self._knowledge.own.controller.digest(),
        )
        self._observed = None

    def statistics(self) -> CorrespondentStatistics:
        """Return where it stands."""
        known = self._now is not None
        return CorrespondentStatistics(
            **msgspec.structs.asdict(super().statistics()),
            role="refused" if self._refused else "deciding" if known else "joining",
            episode=0 if self._now is None else self._now.number,
            step=self._decided,
            digest=self._knowledge.own.controller.digest(),
            shared=self._shared,
            heard=self._heard,
            late=self._late,
            malformed=self.malformed,
        )


def _check_parts(
    team: Team, ensemble: Ensemble, order: tuple[str, ...], owners: tuple[str, ...], agent: str, *, takes: str
) -> None:
    key, name = f"ensembles.{ensemble.name}", ensemble.name
    if team.period is None:
        raise ConfigError("a communicating team decides at a fixed rate: give it a period", key="team.period")
    if takes == "state" or ensemble.controller.model is None:
        raise ConfigError(
            f"a communicating team decides on beliefs, and the policy of {name!r} on states", key=f"{key}.policy"
        )
    if agent not in order or owners != order:
        raise ConfigError(
            f"in a communicating team each agent tells the observation factor of its own: those of {name!r} are of "
            f"{', '.join(owners)}, and the model's agents are {', '.join(order)}",
            key=f"{key}.observations",
        )
    if ensemble.control.planner is not None:
        raise ConfigError(
            f"ensemble {name!r} searches, but in a communicating team each agent has to know what the others decide: "
            "give it a policy that was computed",
            key=f"{key}.policy",
        )
    if ensemble.control.deadline is not None:
        raise ConfigError(
            f"in a communicating team the period and its deadline say when ensemble {name!r} decides: leave its "
            "deadline out",
            key=f"{key}.deadline",
        )
    if ensemble.controller.on_impossible == "safe_action":
        raise ConfigError(
            "in a communicating team what seems impossible may be what others did unseen: on_impossible is 'predict', "
            "'keep' or 'reset'",
            key=f"{key}.on_impossible",
        )
    if getattr(ensemble.controller.model, "false_negative", None) is not None:
        raise ConfigError("a communicating team has no false negatives: leave it out", key=f"{key}.false_negative")
    if ensemble.controller.horizon is not None:
        raise ConfigError("a communicating team has no horizon: leave it out", key=f"{key}.horizon")
