"""The outpost of a centralised team: the layer at each agent for which another one decides."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import msgspec

from mdm.messages import Action, Fault
from mdm.team.agreement.proposals import BARS, HOLD, STARTS, STOP
from mdm.team.centralised.messages import (
    CentralisedStatistics,
    Decision,
    Proposal,
    controlling,
    decode_decision,
    encode,
)
from mdm.team.layer import TeamLayer
from mdm.team.sharing.commanding import PENDING
from mdm.team.transport.bounds import UNREADABLE, can_be
from mdm.team.transport.keys import join

if TYPE_CHECKING:
    from mdm.actors import Ensemble
    from mdm.runtime import Timer
    from mdm.team.link import Link
    from mdm.team.ownership import Placement
    from mdm.team.team import Team
    from mdm.team.transport.transport import Sample

__all__ = ["CentralisedFollower"]

_RETRY = 0.05
_RETRY_NS = round(_RETRY * 1e9)
_PATIENCE = 1.0
_MOST_WAITING = 64
_CONTROLLER = frozenset({"lost_controller"})


class CentralisedFollower(TeamLayer):
    """The layer at an agent for which another one decides: it proposes its input, and has its part of decisions done.

    Where the controller is not there, the ensemble is safe, until it decides again.

    Args:
        team: The team.
        ensemble: The ensemble, whose control layer it leads.
        link: The connection of this agent to the others.
        placement: Where the ensemble's layers are.
    """

    def __init__(self, team: Team, ensemble: Ensemble, link: Link, placement: Placement) -> None:
        super().__init__("outpost", team, ensemble, link, placement)
        self._key = link.key(ensemble.name, "part")
        self._controller = controlling(team, ensemble, placement)
        self._pending: deque[Proposal] = deque()
        self._number = 0
        self._retry: Timer | None = None
        self._sent_at = 0
        self._life = 0
        self._last: Decision | None = None
        self._here = False
        self._still = False
        self._waits: int | None = None
        """The number under which the controller is told of the stop that was taken here; 0 before it can be."""
        self._since = 0
        """The step of the controller after which a start ends the stop that was taken here."""
        self._unsaid = 0

    def on_start(self) -> None:
        """Listen to the own layers and to the controller."""
        self._retry = None
        self._last = None
        super().on_start()
        self.listen(join(self.team.name, self._controller, self.ensemble.name, "decision"), self._on_decision)
        self.call_later(_PATIENCE, self._on_patience)

    # -- Sending -------------------------------------------------------------------------------------------------

    def request(self, command: str, token: str) -> None:
        """Ask the controller for it, if it is there; a stop holds here until a start that was asked for after it."""
        if command == STOP:
            self._still, self._waits = True, 0
            self._discard("a stop was asked for after it")
        if not self._here or self._last is None:
            self.report_void(token, f"agent {self._controller!r}, which decides, is not there")
            return
        self._queue(None, command, token)
        if command == STOP:
            self._waits = self._number

    @property
    def still(self) -> bool:
        """Whether this agent carries out no decisions."""
        return self._still

    @property
    def knows(self) -> object:
        """The last decision of the controller that is known here."""
        return [self._life, 0 if self._last is None else self._last.step]

    def _discard(self, reason: str) -> None:
        """Discard the pending commands, but for stops, and report that."""
        for proposal in [
            proposal for proposal in self._pending if proposal.command is not None and proposal.command not in BARS
        ]:
            self._pending.remove(proposal)
            self.report_void(proposal.token, reason)

    def propose(self, part: bytes | None) -> None:
        """Send this agent's part of the next step."""
        if not self.team.event_driven:
            self.link.send(self._key, encode(Proposal(0, self.tick, part, None)), priority="step")
        elif part is not None and (self._here or self.ownership.takes == "state"):
            self._queue(part, None)
        elif part is not None:
            self._unsaid += 1

    def _queue(self, part: bytes | None, command: str | None, token: str = "") -> None:
        """Send a proposal until the controller acknowledges it; of states, one that was not sent yet is replaced."""
        waiting = self._pending
        if self.ownership.takes == "state" and len(waiting) > 1 and waiting[-1].command is None and command is None:
            waiting.pop()
        elif len(waiting) == _MOST_WAITING:
            del waiting[next((place for place in range(1, len(waiting)) if waiting[place].command is None), 1)]
            self._unsaid += 1
        self._number += 1
        step = 0 if self._last is None else self._last.step
        waiting.append(Proposal(self._number, 0, part, command, token, self._life, step))
        if len(waiting) == 1:
            self._send()

    def _send(self) -> None:
        """Send the oldest pending proposal, now and every 50 ms until the controller acknowledges it."""
        if self._pending:
            self.link.send(self._key, encode(self._pending[0]), priority="step")
            self._sent_at = self.runtime.clock.now()
            if self._retry is None:
                self._retry = self.call_at(self._sent_at + _RETRY_NS, self._resend)

    def _resend(self) -> None:
        due, self._retry = self._sent_at + _RETRY_NS, None
        if self._pending and due > self.runtime.clock.now():  # it is another one, said since
            self._retry = self.call_at(due, self._resend)
        else:
            self._send()

    # -- Receiving -----------------------------------------------------------------------------------------------

    def _on_decision(self, sample: Sample) -> None:
        try:
            decision = decode_decision(sample.body)
        except UNREADABLE as error:
            self.malformed += 1
            self.link.refuse_sample(sample, f"is no decision: {error}")
            return
        if decision.action is not None and decision.action >= self.ensemble.controller.policy.num_actions:
            self.malformed += 1
            self.link.refuse_sample(sample, f"decides on action {decision.action}, which the model has not")
            return
        if decision.started > decision.step:
            self.malformed += 1
            self.link.refuse_sample(sample, f"tells at step {decision.step} of a start at step {decision.started}")
            return
        if not self.link.is_live(sample):
            return  # it is not there yet, or has another configuration
        if sample.incarnation != self._life:
            self._life = sample.incarnation
            self._last = None
            self._leave_term()
            if self._still:
                self._waits = 0  # it knows of no stop that a life of the controller before it decided
            if self.ownership.takes == "state" and self.team.event_driven:
                self.propose_values(self.own)  # a controller that has just begun knows nothing
        self._receive_acknowledgement(decision)
        if (void := decision.void.get(self.agent)) and self.commands.outcomes.get(void) == PENDING:
            self.report_void(void, "a stop came before it")
        self._apply(decision)

    def _receive_acknowledgement(self, decision: Decision) -> None:
        """Discard the proposal that the controller acknowledges, and send the next.

        Where it acknowledges more than was sent, or a command under that number which is none, another has spoken in
        this agent's name: the pending proposals are then sent under new numbers.
        """
        taken, waiting = decision.taken.get(self.agent, 0), self._pending
        if not can_be(taken, self.runtime.clock.now(), 1000):
            return
        if not waiting:
            self._number = max(self._number, taken)
        elif taken >= waiting[0].number:
            first = waiting[0]
            life, number, _ = decision.bars.get(self.agent, (0, 0, 0))
            barred = life == self.link.transport.incarnation and number >= first.number
            if taken <= self._number and (barred or first.command not in BARS):
                waiting.popleft()
            else:
                self._renumber(max(taken, self._number))
            self._send()

    def _renumber(self, last: int) -> None:
        """Give the pending proposals the numbers after another."""
        numbers = {proposal.number: last + place for place, proposal in enumerate(self._pending, 1)}
        self._pending = deque(
            msgspec.structs.replace(proposal, number=numbers[proposal.number]) for proposal in self._pending
        )
        self._number = last + len(numbers)
        if self._waits is not None:
            self._waits = numbers.get(self._waits, self._waits)

    def _apply(self, decision: Decision) -> None:
        """Carry out this agent's component of a decision, once.

        The messages of a life come in order. Where the controller is at an earlier step than it said before, or has
        decided something else at the same, it did not say that: its decision counts as when it is heard first.
        """
        now = self.runtime.clock.now()
        last, self._last = self._last, decision
        if last is not None and (
            decision.step < last.step or (decision.step == last.step and not _same(decision, last))
        ):
            last = None
            self._since = min(self._since, decision.step)
        control, safety = self.ensemble.control, self.ensemble.safety
        held = self._still
        self._settle(decision)
        if last is not None and decision.step == last.step:
            safety.reopen(_CONTROLLER, now)
            return
        control.running = decision.running
        self.report_held(settled=self._waits is None)
        if decision.command is not None:
            self.forget()
            self.commands.done(decision.token)
        if not decision.running:
            safety.stop(now)
        elif self.ensemble.mode == "stopped" and not self._still:
            safety.start(now)
        action = decision.action
        goes_on = last is not None and last.running and decision.command in {HOLD, *STARTS} and not held
        if self._still or goes_on:
            pass  # nothing new is decided, or nothing of it is for this agent
        elif decision.running and action is not None:
            if decision.impossible is not None:
                safety.alarm(Fault(now, self.ensemble.path, "impossible_observation", decision.impossible))
            self.process.carry_out(Action(now, decision.epoch, action))
        elif decision.running and self.ownership.takes == "state":
            safety.blind(now)
        safety.reopen(_CONTROLLER, now)
        term = (1, self._controller, self._life)
        self.publish_commit(
            *(term, decision.step, decision.inputs, decision.missing, decision.command),
            action=decision.action,
            digest=decision.digest,
        )
        self.assess(now)

    def _settle(self, decision: Decision) -> None:
        """Take note of stops, and of starts that were asked for after them."""
        life, number, step = decision.bars.get(self.agent, (0, 0, 0))
        if self._waits is not None:
            if self._waits == 0:
                self._queue(None, HOLD)
                self._waits = self._number
            elif life == self.link.transport.incarnation and number >= self._waits:
                self._waits, self._since = None, min(step, decision.step)
        elif not decision.running:
            self._still, self._since = True, decision.step
        if self._still and self._waits is None and decision.running and decision.started > self._since:
            self._still = False

    # -- Liveness ------------------------------------------------------------------------------------------------

    def update_live(self, link: Link) -> None:
        """Update whether the controller is live."""
        was, self._here = self._here, self._controller in link.live
        if was and not self._here:
            self._leave_term()
            self._forget_events()
            text = f"agent {self._controller!r}, which decides, is gone"
            self.report_loss([self._controller], "lost_controller", text, lambda: not self._here)
        self.assess(self.runtime.clock.now())

    def _forget_events(self) -> None:
        """Discard the pending observations, which are too old for the next controller."""
        if self.ownership.takes != "state":
            self._unsaid += len(self._pending)
            self._pending.clear()

    def _leave_term(self) -> None:
        """Drop the commands that the controller has not taken: they were asked for before it was lost."""
        reason = f"agent {self._controller!r}, which decides, was lost before it had it"
        void = [proposal for proposal in self._pending if proposal.command is not None]
        self._pending = deque(proposal for proposal in self._pending if proposal.command is None)
        for proposal in void:
            if proposal.command != HOLD:
                self.report_void(proposal.token, reason)
        if self._waits is not None:
            self._waits = 0

    def assess(self, now: int) -> None:
        """Go safe, hold or go on, by who is there; the way back from a lost controller is its next decision."""
        if self.refusal is None and not self._here:
            self.ensemble.safety.endanger("lost_controller", f"agent {self._controller!r} is not there", now)
        super().assess(now)

    def _on_patience(self) -> None:
        if self._last is None and self.refusal is None and self._controller not in self.link.configuration.differing:
            self.report("waiting", f"cannot act: agent {self._controller!r}, which decides, is not there")

    def statistics(self) -> CentralisedStatistics:
        """Return where it stands."""
        role = "following" if self._last is not None else "joining"
        return CentralisedStatistics(
            **msgspec.structs.asdict(super().statistics()),
            role="refused" if self.refusal is not None else role if self._here else "waiting",
            leader=self._controller,
            step=0 if self._last is None else self._last.step,
            digest="" if self._last is None else self._last.digest,
            late=self._unsaid,
            malformed=self.malformed,
        )


def _same(one: Decision, other: Decision) -> bool:
    """Return whether two decisions of the same step are the same, apart from their acknowledgements."""
    return (one.running, one.epoch, one.action, one.command, one.token, one.started) == (
        *(other.running, other.epoch, other.action),
        *(other.command, other.token, other.started),
    )
