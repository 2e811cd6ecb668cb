"""Centralised teams: one agent decides for all, and each carries out its component.

The agents send what they see, each with a number of its own, again and again until the controller says that it has it.
The controller decides, and sends what it has decided to all; the last decision once more every now and then, so that
none is lost for long.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import msgspec

from mdm.messages import Action, Fault
from mdm.runtime import ActorStatistics
from mdm.team.copy import BEGIN
from mdm.team.keys import join
from mdm.team.layer import TeamLayer

if TYPE_CHECKING:
    from mdm.actors import Ensemble
    from mdm.runtime import Timer
    from mdm.team.link import Link
    from mdm.team.placement import Placement
    from mdm.team.team import Team
    from mdm.team.transport import Sample

__all__ = ["CentralisedStatistics", "Centre", "Outpost", "controlling"]

_RETRY = 0.05
_PATIENCE = 1.0
_MOST_WAITING = 64
_CONTROLLER = frozenset({"lost_controller"})


class Said(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """What an agent says to the controller.

    Args:
        number: Counted from 1 in the life of the agent, where the controller is to say that it has it; else 0.
        tick: The number of the tick that it belongs to; 0 where events make steps.
        part: What the agent saw, None where it saw nothing.
        command: In place of a part, what was asked for at the agent.
    """

    number: int
    tick: int
    part: bytes | None
    command: str | None


class Decided(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """The last decision of the controller.

    Args:
        step: Counted from 1, in the life of the controller.
        running: Whether the team decides, or is stopped.
        epoch: Of the decision in its episode.
        action: The joint action; None where there is none.
        impossible: Why what was observed makes every agent safe; None where it does not.
        inputs: What it was decided on, by agent.
        missing: Agents of which it is not known what they saw.
        command: In place of these, the command.
        digest: Of the controller after it.
        taken: The last number taken from each agent, by its name.
    """

    step: int
    running: bool
    epoch: int
    action: int | None
    impossible: str | None
    inputs: dict[str, bytes]
    missing: tuple[str, ...]
    command: str | None
    digest: str
    taken: dict[str, int]


_encode = msgspec.msgpack.Encoder().encode
_said = msgspec.msgpack.Decoder(Said).decode
_decided = msgspec.msgpack.Decoder(Decided).decode
_facts = msgspec.msgpack.Decoder(dict[str, str]).decode


class CentralisedStatistics(ActorStatistics, frozen=True):
    """Where an agent of a centralised team stands.

    Attributes:
        role: ``leading`` at the controller; else ``following``, ``joining`` before the first decision, ``waiting``
            where the controller is not there, or ``refused``.
        leader: The controller.
        step: The last decision, counted from 1.
        digest: Of the controller after it.
        late: Parts that came after their step.
        malformed: Messages that were none.
    """

    role: str
    leader: str
    step: int
    digest: str
    late: int
    malformed: int


def controlling(team: Team, ensemble: Ensemble, placement: Placement) -> str:
    """Return the agent that decides.

    Raises:
        ConfigError: If the placement names none of the team's.
    """
    if placement.control is None:
        return team.controller
    return team.check_agent(placement.control, key=f"ensembles.{ensemble.name}.placement.control")


class Centre(TeamLayer):
    """The layer at the agent that decides: it collects what all have seen.

    At a fixed rate it decides when all live agents have said what they saw since the last tick, or the deadline after
    the tick is over. Else it decides on what each agent sees, as it comes.

    Args:
        team: The team.
        ensemble: The ensemble, whose control layer it leads.
        link: What connects this agent with the others.
        placement: Where the ensemble's layers are.
    """

    def __init__(self, team: Team, ensemble: Ensemble, link: Link, placement: Placement) -> None:
        super().__init__("centre", team, ensemble, link, placement)
        self._key = link.key(ensemble.name, "decision")
        self._taken: dict[str, tuple[int, int]] = {}
        self._ticks: dict[int, dict[str, bytes | None]] = {}
        self._open: int | None = None
        self._closed = -1
        self._late = 0
        self._last = Decided(0, False, 0, None, None, {}, (), None, "", {})
        self._on: tuple[dict[str, bytes], tuple[str, ...], str | None] = ({}, (), None)
        self._timer: Timer | None = None
        self._serves = False

    def on_start(self) -> None:
        """Listen to the own layers and to the other agents."""
        self._open = self._timer = None
        super().on_start()
        self.ensemble.control.relay(self._publish)
        self.hear(join(self.team.name, "*", self.ensemble.name, "part"), self._on_said)
        if not self._serves:
            self._serves = True
            facts = _encode(self.copy.facts)
            self.link.serve(self.link.key(self.ensemble.name, "configuration"), lambda _: facts)
        self.every(4 / self.team.lease, lambda _: self._put())

    def on_running(self) -> None:
        """Begin to decide, or begin anew after a failure."""
        self._command("start" if self.copy.begun else BEGIN)

    def take_live(self, _link: Link) -> None:
        """Take note of who is live: who has just come is told what is decided; nobody waits for who is gone."""
        self._put()
        self._close(late=False)

    # -- What the agents say -------------------------------------------------------------------------------------

    def ask_for(self, command: str) -> None:
        """Do what was asked for, at all agents."""
        self._command(command)

    def offer(self, part: bytes | None) -> None:
        """Take what this agent has seen."""
        if not self.team.event_driven:
            self._open = self.tick
            if self._timer is not None:
                self._timer.cancel()
            self._timer = self.call_later(self.team.deadline, lambda: self._close(late=True))
            self._collect(self.agent, self.tick, part)
        elif part is not None:
            self._decide({self.agent: part})

    def _on_said(self, sample: Sample) -> None:
        try:
            said = _said(sample.body)
        except (msgspec.MsgspecError, ValueError):
            self.malformed += 1
            return
        if said.number == 0:
            self._collect(sample.owner, said.tick, said.part)
            return
        life, last = self._taken.get(sample.owner, (0, 0))
        if (life, last) >= (sample.incarnation, said.number):
            self._put()  # it was taken before, and the word of that was lost
            return
        self._taken[sample.owner] = (sample.incarnation, said.number)
        if said.command is not None:
            self._command(said.command)
        elif said.part is not None:
            self._decide({sample.owner: said.part})

    def _collect(self, agent: str, tick: int, part: bytes | None) -> None:
        """Take what an agent saw until a tick; it counts for that one alone."""
        if tick <= self._closed:
            self._late += 1
            return
        self._ticks.setdefault(tick, {})[agent] = part
        for old in sorted(self._ticks)[:-8]:  # ticks that nobody decides on, such as those of an agent ahead of time
            del self._ticks[old]
        self._close(late=False)

    def _close(self, *, late: bool) -> None:
        """Decide on the open tick, where all have said what they saw or it is too late for the others."""
        if self._open is None:
            return
        said = self._ticks.get(self._open, {})
        if not late and any(self.parts.of[agent] and agent not in said for agent in self.link.live):
            return
        self._closed, self._open = self._open, None
        self._ticks = {tick: parts for tick, parts in self._ticks.items() if tick > self._closed}
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        missing = tuple(agent for agent in self.team.names if agent not in said and self.parts.of[agent])
        self._decide({agent: part for agent, part in said.items() if part is not None}, missing)

    # -- Decisions -----------------------------------------------------------------------------------------------

    def _decide(self, inputs: dict[str, bytes], missing: tuple[str, ...] | None = None) -> None:
        if missing is None:
            gone = self.team.names if not self.link.live else [a for a in self.team.names if a not in self.link.live]
            missing = tuple(agent for agent in gone if self.parts.of[agent] and agent not in inputs)
        self._on = (inputs, missing, None)
        known, before = not self.ensemble.control.blind, self._last.step
        self.copy.step(inputs, missing, self.runtime.clock.now())
        if known and self.ensemble.control.blind:
            self._publish(None)
        elif self._last.step == before:
            self._put()  # a search will decide later, or nothing is to be decided

    def _command(self, command: str) -> None:
        self._on = ({}, (), command)
        before = self._last.step
        self._open = None
        self.take_command(command, self.runtime.clock.now())
        if self._last.step == before:
            self._publish(None)

    def _publish(self, action: Action | None) -> None:
        """Send a decision to all."""
        controller = self.ensemble.controller
        inputs, missing, command = self._on
        self._last = Decided(
            step=self._last.step + 1,
            running=self.copy.running,
            epoch=0 if action is None else action.epoch,
            action=None if action is None else action.index,
            impossible=controller.problem if controller.on_impossible == "safe_action" else None,
            inputs=inputs,
            missing=missing,
            command=command,
            digest=self.copy.digest(),
            taken={},
        )
        self._put()
        told = None if action is None else action.index
        life = (1, self.agent, self.link.transport.incarnation)
        self.tell(life, self._last.step, inputs, missing, command, action=told, digest=self._last.digest)

    def _put(self) -> None:
        """Send the last decision, with what was taken from each agent."""
        taken = {agent: number for agent, (_, number) in self._taken.items()}
        self.link.put(self._key, _encode(msgspec.structs.replace(self._last, taken=taken)), priority="step")

    def statistics(self) -> CentralisedStatistics:
        """Return where it stands."""
        return CentralisedStatistics(
            **msgspec.structs.asdict(super().statistics()),
            role="leading",
            leader=self.agent,
            step=self._last.step,
            digest=self._last.digest,
            late=self._late,
            malformed=self.malformed + self.copy.malformed,
        )


class Outpost(TeamLayer):
    """The layer at an agent for which another one decides: it says what is seen here, and has its part carried out.

    Where the controller is not there, the ensemble is safe, until it decides again.

    Args:
        team: The team.
        ensemble: The ensemble, whose control layer it leads.
        link: What connects this agent with the others.
        placement: Where the ensemble's layers are.
    """

    def __init__(self, team: Team, ensemble: Ensemble, link: Link, placement: Placement) -> None:
        super().__init__("outpost", team, ensemble, link, placement)
        self._key = link.key(ensemble.name, "part")
        self._controller = controlling(team, ensemble, placement)
        self._waiting: deque[Said] = deque()
        self._number = 0
        self._retry: Timer | None = None
        self._life = 0
        self._last: Decided | None = None
        self._here = False
        self._checked: int | None = None
        self._refusal: str | None = None

    def on_start(self) -> None:
        """Listen to the own layers and to the controller."""
        self._retry = None
        self._last = None
        super().on_start()
        self.hear(join(self.team.name, self._controller, self.ensemble.name, "decision"), self._on_decided)
        self.call_later(_PATIENCE, self._on_patience)

    # -- What this agent says ------------------------------------------------------------------------------------

    def ask_for(self, command: str) -> None:
        """Ask the controller for it."""
        self._queue(None, command)

    def offer(self, part: bytes | None) -> None:
        """Say what this agent has seen."""
        if not self.team.event_driven:
            self.link.put(self._key, _encode(Said(0, self.tick, part, None)), priority="step")
        elif part is not None:
            self._queue(part, None)

    def _queue(self, part: bytes | None, command: str | None) -> None:
        """Say something until the controller says that it has it; of states what was not said yet gives way."""
        waiting = self._waiting
        if self.parts.takes == "state" and len(waiting) > 1 and waiting[-1].command is None and command is None:
            waiting.pop()
        elif len(waiting) == _MOST_WAITING:
            del waiting[1]
        self._number += 1
        waiting.append(Said(self._number, 0, part, command))
        if len(waiting) == 1:
            self._say()

    def _say(self) -> None:
        if self._retry is not None:
            self._retry.cancel()
            self._retry = None
        if self._waiting:
            self.link.put(self._key, _encode(self._waiting[0]), priority="step")
            self._retry = self.call_later(_RETRY, self._say)

    # -- What the controller says --------------------------------------------------------------------------------

    def _on_decided(self, sample: Sample) -> None:
        try:
            decided = _decided(sample.body)
        except (msgspec.MsgspecError, ValueError):
            self.malformed += 1
            return
        if sample.incarnation != self._life:
            self._life = sample.incarnation
            self._last = None
            self.spawn(self._compare(sample.incarnation), name="compare")
            if self.parts.takes == "state" and self.team.event_driven:
                self.say(self.own)  # a controller that has just begun knows nothing
        if self._waiting and decided.taken.get(self.agent, 0) >= self._waiting[0].number:
            self._waiting.popleft()
            self._say()
        if self._checked == sample.incarnation and self._refusal is None:
            self._obey(decided)

    def _obey(self, decided: Decided) -> None:
        """Carry out this agent's component of what was decided, once."""
        now = self.runtime.clock.now()
        last, self._last = self._last, decided
        control, safety = self.ensemble.control, self.ensemble.safety
        if last is not None and decided.step <= last.step:
            safety.reopen(_CONTROLLER, now)
            return
        control.running = decided.running
        if decided.command is not None:
            self.forget()
        if not decided.running:
            safety.stop(now)
        elif self.ensemble.mode == "stopped":
            safety.start(now)
        action = decided.action
        if decided.running and action is not None and 0 <= action < control.controller.policy.num_actions:
            if decided.impossible is not None:
                safety.alarm(Fault(now, self.ensemble.path, "impossible_observation", decided.impossible))
            control.carry_out(Action(now, decided.epoch, action))
        elif decided.running and self.parts.takes == "state":
            safety.blind(now)
        safety.reopen(_CONTROLLER, now)
        term = (1, self._controller, self._life)
        self.tell(
            *(term, decided.step, decided.inputs, decided.missing, decided.command),
            action=decided.action,
            digest=decided.digest,
        )
        self.assess(now)

    async def _compare(self, life: int) -> None:
        """Compare the controller's configuration with this agent's; carry out nothing before."""
        key = join(self.team.name, self._controller, self.ensemble.name, "configuration")
        while self._life == life:
            answers = await self.link.ask(key)
            try:
                theirs = _facts(answers[self._controller])
            except (KeyError, msgspec.MsgspecError, ValueError):
                await self.runtime.clock.sleep(_RETRY)
                continue
            self._refusal = self._difference(theirs)
            self._checked = life
            if self._refusal is not None:
                self.report("refused", f"{self.agent} cannot take part in the team: {self._refusal}")
            return

    def _difference(self, theirs: dict[str, str]) -> str | None:
        own = self.copy.facts
        for fact in sorted(own.keys() | theirs.keys()):
            here, there = own.get(fact), theirs.get(fact)
            if here != there:
                return f"{fact} is {here or 'nothing'} at {self.agent} and {there or 'nothing'} at {self._controller}"
        return None

    # -- Who is there --------------------------------------------------------------------------------------------

    def take_live(self, link: Link) -> None:
        """Take note of whether the controller is live."""
        was, self._here = self._here, self._controller in link.live
        if was and not self._here:
            self.report("lost_controller", f"agent {self._controller!r}, which decides, is gone")
        self.assess(self.runtime.clock.now())

    def assess(self, now: int) -> None:
        """Go safe, hold or go on, by who is there; the way back from a lost controller is its next decision."""
        if not self._here:
            self.ensemble.safety.endanger("lost_controller", f"agent {self._controller!r} is not there", now)
        super().assess(now)

    def _on_patience(self) -> None:
        if self._last is None and self._refusal is None:
            self.report("waiting", f"cannot act: agent {self._controller!r}, which decides, is not there")

    def statistics(self) -> CentralisedStatistics:
        """Return where it stands."""
        role = "following" if self._last is not None else "joining"
        return CentralisedStatistics(
            **msgspec.structs.asdict(super().statistics()),
            role="refused" if self._refusal is not None else role if self._here else "waiting",
            leader=self._controller,
            step=0 if self._last is None else self._last.step,
            digest="" if self._last is None else self._last.digest,
            late=0,
            malformed=self.malformed,
        )
