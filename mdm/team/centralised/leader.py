"""The leader of a centralised team: the layer at the agent that decides for all."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING

import msgspec

from mdm.runtime import Subscription
from mdm.team.agreement.proposals import BARS, HOLD, STARTS, STOP
from mdm.team.centralised.messages import CentralisedStatistics, Decision, decode_proposal, encode
from mdm.team.copy import BEGIN
from mdm.team.layer import TeamLayer
from mdm.team.transport.bounds import UNREADABLE, can_be
from mdm.team.transport.keys import join

if TYPE_CHECKING:
    from mdm.actors import Ensemble
    from mdm.messages import Action
    from mdm.runtime import Timer
    from mdm.team.centralised.messages import Proposal
    from mdm.team.link import Link
    from mdm.team.ownership import Placement
    from mdm.team.team import Team
    from mdm.team.transport.transport import Sample

_MOST_TICKS = 8
"""Ticks for which parts are kept, such as those of an agent ahead of time."""

_NOT_READY = "the configurations of the agents that are there were not compared yet, or most of them differ"


class Beginning(Enum):
    """How far a controller is from its first decision, in the order in which it comes to these."""

    UNSEEN = "it has not seen yet who is there"
    PATIENT = "it waits for agents that are not there"
    IMPATIENT = "it waits only until it is refused no more, and outvoted no more"
    READY = "it decides"


class Asked(Enum):
    """The commands that were asked of this life of the controller."""

    NOTHING = "none"
    VOID_START = "a start that was void, and nothing else"
    COMMAND = "commands, and no start"
    START = "commands, and a start"

    def after(self, command: str, *, void: bool = False) -> Asked:
        """Return what was asked for with one more command."""
        if command in STARTS or self in {Asked.VOID_START, Asked.START}:
            return Asked.VOID_START if void and self in {Asked.NOTHING, Asked.VOID_START} else Asked.START
        return self if void else Asked.COMMAND


class CentralisedLeader(TeamLayer):
    """The layer at the agent that decides: it collects the parts of all.

    At a fixed rate it decides when all live agents have sent their parts since the last tick, or the deadline after
    the tick is over. Else it decides on each part as it comes.

    Attributes:
        beginning: How far it is from its first decision.
        asked: The commands that were asked of this life of it.
    """

    def __init__(self, team: Team, ensemble: Ensemble, link: Link, placement: Placement) -> None:
        super().__init__("centre" if link.transport.protocol == 1 else "leader", team, ensemble, link, placement)
        self._key = link.key(ensemble.name, "decision")
        self._taken: dict[str, tuple[int, int]] = {}
        self._ticks: dict[int, dict[str, bytes | None]] = {}
        self._open: int | None = None
        self._closed = -1
        self._late = 0
        self._last = self._last_sent = Decision(0, False, 0, None, None, {}, (), None, "", {})
        self._on: tuple[dict[str, bytes], tuple[str, ...], str | None, str] = ({}, (), None, "")
        self._started = self._barred = 0
        self._stopped = False
        self.asked = Asked.NOTHING
        self.beginning = Beginning.UNSEEN
        self._bars: dict[str, tuple[int, int, int]] = {}
        self._void: dict[str, str] = {}
        self._timer: Timer | None = None
        self._sending: Subscription[Decision] = Subscription(None, self, self._send_new)
        self._seeing = tuple(agent for agent in team.names if self.ownership.of[agent])

    def on_start(self) -> None:
        """Listen to the own layers and to the other agents."""
        self._open = self._timer = None
        super().on_start()
        self.process.relay(self._publish)
        self.listen(join(self.team.name, "*", self.ensemble.name, "part"), self._on_proposal)
        if self.beginning is Beginning.PATIENT:
            self.beginning = Beginning.UNSEEN
        self.every(4 / self.team.lease, lambda _: self._send_again())

    def on_running(self) -> None:
        """Begin again after a failure; a team that was stopped stays so. At first configurations are compared."""
        if self.beginning is Beginning.READY:
            self._command("stop" if self._stopped else "start" if self.copy.begun else BEGIN)

    def update_live(self, _link: Link) -> None:
        """Update the live agents: a new one is sent the last decision; no step waits for one that is gone."""
        if self.beginning is Beginning.UNSEEN:
            self.beginning = Beginning.PATIENT
            self.call_later(self.team.lease / 2, self._wait_no_more)
        self._begin()
        self._send_again()
        self._close(late=False)
        self.assess(self.runtime.now())

    def _wait_no_more(self) -> None:
        """Wait no longer for agents that are not there."""
        if self.beginning is Beginning.PATIENT:
            self.beginning = Beginning.IMPATIENT
            self._begin()

    def _begin(self) -> None:
        """Begin to decide, once all are there or were waited for, unless most of them have another configuration."""
        if self.beginning is Beginning.READY or self.link.refusal is not None or self._waits or self._outvoted:
            return
        self.beginning = Beginning.READY
        self._command(STOP if self._stopped else BEGIN)

    @property
    def _differing(self) -> int:
        """How many agents of the team are there with another configuration."""
        return sum(agent in self.link.configuration.differing for agent in self.team.names)

    @property
    def _waits(self) -> bool:
        """Whether it waits for agents that are not there."""
        if self.unmet or self.beginning is Beginning.IMPATIENT:
            return self.unmet
        return len(self.link.live) + self._differing < len(self.team.names)

    @property
    def _outvoted(self) -> bool:
        """Whether most of the agents that are there have another configuration."""
        return self._differing > len(self.link.live)

    def pause(self) -> None:
        """Decide on nothing that was begun."""
        self._open = None
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    # -- Receiving -----------------------------------------------------------------------------------------------

    def request(self, command: str, token: str) -> None:
        """Carry out a command at all agents."""
        if self.link.refusal is not None:
            self.asked = self.asked.after(command, void=True)
            self._stopped = self._stopped or command == STOP  # as this agent has by now, whatever the others do
            self.report_void(token, f"{self.agent} takes no part in the team")
        elif self.unmet and command in STARTS:
            self.asked = self.asked.after(command, void=True)
            self.beginning, self._stopped = Beginning.IMPATIENT, False
            self.link.go_without()
            self.commands.done(token)
        elif self.beginning is not Beginning.READY and command not in BARS:
            self.asked = self.asked.after(command, void=True)
            self.report_void(token, _NOT_READY)
        else:
            self.asked = self.asked.after(command)
            self._command(command, token, self.agent)

    @property
    def still(self) -> bool:
        """Whether this agent carries out no decisions: never, for it decides itself."""
        return False

    @property
    def knows(self) -> object:
        """The last decision."""
        return [self.link.transport.incarnation, self._last.step]

    @property
    def term(self) -> int:
        """Its life, in which it decides for all."""
        return self.link.transport.incarnation

    def memory(self) -> bytes | None:
        """Return that it is stopped: nothing more is needed, for it decides for all."""
        return b"" if self._stopped else None

    def obey(self, memory: bytes) -> None:
        """Stop all others, too, as soon as they are there."""
        if memory:
            raise ValueError("it is no controller's")
        self._stopped = True

    def propose(self, part: bytes | None, now: int) -> None:
        """Collect this agent's own part."""
        if self.link.refusal is not None:
            return
        if not self.team.event_driven:
            self._open = self.tick
            if self._timer is not None:
                self._timer.cancel()
            self._timer = self.call_later(self.team.deadline, lambda: self._close(late=True))
            self._collect(self.agent, self.tick, part)
        elif part is not None:
            self._decide({self.agent: part})

    def _on_proposal(self, sample: Sample) -> None:
        if self.link.refusal is not None:
            return
        try:
            proposal = decode_proposal(sample.body)
        except UNREADABLE as error:
            self.drop(sample, f"is none of a centralised team: {error}")
            return
        # Its sender's clock is an hour ahead at most.
        period = round((self.team.period or 1.0) * 1e9)
        if not (can_be(proposal.tick - self.tick, 0, period) and can_be(proposal.number, self._dispatcher.time, 1000)):
            self.drop(sample, f"is of tick {proposal.tick} and number {proposal.number}, which cannot be yet")
            return
        if proposal.tick > self.tick + _MOST_TICKS:
            self._late += 1  # a clock that is ahead of this one; no part waits for so long
            return
        if not self.link.is_live(sample):
            return
        if proposal.number == 0:
            self._collect(sample.owner, proposal.tick, proposal.part)
            return
        life, last = self._taken.get(sample.owner, (0, 0))
        if life == sample.incarnation and last >= proposal.number:
            self._send_again()  # it was taken before, and the word of that was lost
            return
        self._taken[sample.owner] = (sample.incarnation, proposal.number)
        if proposal.command is not None:
            self._receive_command(sample, proposal, proposal.command)
        elif proposal.part is not None:
            self._decide({sample.owner: proposal.part})

    def _receive_command(self, sample: Sample, proposal: Proposal, command: str) -> None:
        """Carry out a command of another agent, unless a stop came between."""
        agent = sample.owner
        if command not in BARS:
            known = proposal.step if proposal.life == self.link.transport.incarnation else -1
            if known < self._barred or self.beginning is not Beginning.READY:
                self._void[agent] = proposal.token
                self._send_again()
            else:
                self.asked = self.asked.after(command)
                self._command(command, proposal.token)
            return
        if command == HOLD and self.asked in {Asked.NOTHING, Asked.VOID_START}:
            command = STOP  # this life of the controller began by itself, and knows of no stop before
        self._bars[agent] = (sample.incarnation, proposal.number, self._last.step + 1)
        self._command(command, proposal.token, agent)

    def _collect(self, agent: str, tick: int, part: bytes | None) -> None:
        """Collect an agent's part of a tick; it counts for that one alone."""
        if tick <= self._closed:
            self._late += 1
            return
        self._ticks.setdefault(tick, {})[agent] = part
        for old in sorted(self._ticks)[:-_MOST_TICKS]:
            del self._ticks[old]
        self._close(late=False)

    def _close(self, *, late: bool) -> None:
        """Decide on the open tick, where all parts have come or it is too late for the others."""
        if self._open is None:
            return
        heard = self._ticks.get(self._open, {})
        waited_for = (agent for agent in self._seeing if agent in self.link.live)
        if not late and any(agent not in heard for agent in waited_for):
            return
        self._closed, self._open = self._open, None
        self._ticks = {tick: parts for tick, parts in self._ticks.items() if tick > self._closed}
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        missing = tuple(agent for agent in self._seeing if agent not in heard)
        self._decide({agent: part for agent, part in heard.items() if part is not None}, missing)

    # -- Decisions -----------------------------------------------------------------------------------------------

    def _decide(self, inputs: dict[str, bytes], missing: tuple[str, ...] | None = None) -> None:
        if missing is None:
            live = self.link.live
            missing = tuple([agent for agent in self._seeing if agent not in live and agent not in inputs])
        self._on = (inputs, missing, None, "")
        known, before = not self.process.blind, self._last.step
        self.copy.step(inputs, missing, self._dispatcher.time)
        if known and self.process.blind:
            self._publish(None)
        elif self._last.step == before:
            self._send_again()  # a search will decide later, or nothing is to be decided

    def _command(self, command: str, token: str = "", by: str = "") -> None:
        self._on = ({}, (), command, token)
        before, runs = self._last.step, self.process.running
        if command in BARS:
            self._barred = before + 1
        if command in STARTS:
            self._started, self._stopped = before + 1, False
        if command != HOLD:
            self._open = None
            self._stopped = self._stopped or command == STOP
            self.apply_command(command, token, self.runtime.now(), by)
        if self._last.step == before and runs and (command == HOLD or command in STARTS):
            self._publish_again()
        elif self._last.step == before:
            self._publish(None)

    def _publish(self, action: Action | None) -> None:
        """Send a decision to all, behind this agent's callback."""
        controller = self.ensemble.controller
        inputs, missing, command, token = self._on
        self._last = Decision(
            step=self._last.step + 1,
            running=self.process.running,
            epoch=0 if action is None else action.epoch,
            action=None if action is None else action.index,
            impossible=controller.problem if controller.on_impossible == "safe_action" else None,
            inputs=inputs,
            missing=missing,
            command=command,
            digest="",
            taken={},
            token=token,
            started=self._started,
            called=self._called,
        )
        # Behind this agent's callback, which does not wait for what is for the others.
        self._dispatcher.deliver(self._sending, self._last)

    @property
    def _called(self) -> bool:
        """Whether somebody has asked this life of the controller for a start."""
        return self.asked in {Asked.VOID_START, Asked.START}

    def _publish_again(self) -> None:
        """Send a command to all that changes no decision."""
        _, _, command, token = self._on
        told = {"step": self._last.step + 1, "inputs": {}, "missing": (), "command": command, "token": token}
        self._last = msgspec.structs.replace(self._last, started=self._started, called=self._called, **told)
        self._dispatcher.deliver(self._sending, self._last)

    def _send_new(self, decision: Decision) -> None:
        """Send a new decision to all, and publish it here."""
        decision = msgspec.structs.replace(decision, digest=self.copy.digest())
        if self._last.step == decision.step:
            self._last = decision
        self._last_sent = decision
        self._send(decision)
        life = (1, self.agent, self.link.transport.incarnation)
        self.publish_commit(
            *(life, decision.step, decision.inputs, decision.missing, decision.command),
            action=decision.action,
            digest=decision.digest,
        )

    def _send_again(self) -> None:
        """Send the last decision once more; not one that waits to be sent, for they are sent in order."""
        self._send(self._last_sent)

    def _send(self, decision: Decision) -> None:
        """Send a decision, with the acknowledgements of each agent."""
        live = self.link.live
        taken = {agent: number for agent, (life, number) in self._taken.items() if live.get(agent, life) == life}
        told = msgspec.structs.replace(decision, taken=taken, bars=self._bars, void=self._void)
        self.link.send(self._key, encode(told), priority="step")

    def statistics(self) -> CentralisedStatistics:
        """Return where it stands."""
        ready = self.beginning is Beginning.READY
        role = "leading" if ready else "waiting" if self.unmet else "joining"
        refused = self.link.refusal is not None or not (ready or self._waits or not self._outvoted)
        return CentralisedStatistics(
            **msgspec.structs.asdict(super().statistics()),
            role="refused" if refused else role,
            leader=self.agent,
            step=self._last.step,
            digest=self._last.digest,
            late=self._late,
            malformed=self.malformed + self.copy.malformed,
        )
