"""The follower of a centralised team: the layer at each agent for which another one decides."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from mdm.messages import Action, Fault
from mdm.team.agreement.proposals import HOLD, STARTS
from mdm.team.centralised.messages import (
    CentralisedStatistics,
    Decision,
    Proposal,
    controlling,
    decode_decision,
    encode,
)
from mdm.team.centralised.proposals import Proposals
from mdm.team.layer import TeamLayer
from mdm.team.sharing.commanding import PENDING
from mdm.team.transport.bounds import UNREADABLE, Life, Number, can_be
from mdm.team.transport.keys import join

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mdm.actors import Ensemble
    from mdm.runtime.dispatcher import Alarm
    from mdm.team.link import Link
    from mdm.team.ownership import Placement
    from mdm.team.team import Team
    from mdm.team.transport.transport import Sample

_RETRY = 0.05
_RETRY_NS = round(_RETRY * 1e9)
_PATIENCE = 1.0
_CONTROLLER = frozenset({"lost_controller"})


class CentralisedFollower(TeamLayer):
    """The layer at an agent for which another one decides: it proposes its input, and has its part of decisions done.

    Where the controller is not there, the ensemble is safe, until it decides again.
    """

    def __init__(self, team: Team, ensemble: Ensemble, link: Link, placement: Placement) -> None:
        super().__init__("outpost" if link.transport.protocol == 1 else "follower", team, ensemble, link, placement)
        self._key = link.key(ensemble.name, "part")
        self._controller = controlling(team, ensemble, placement)
        self.proposals = Proposals(replace=self.ownership.takes == "state")
        self._retry: Alarm | None = None
        self._sent_at = 0
        self._life = 0
        self._last: Decision | None = None
        self._live: Mapping[str, int] = {}
        self._unsaid = 0

    def on_start(self) -> None:
        """Listen to the own layers and to the controller."""
        self._retry = None
        self._last = None
        self.proposals.begin()
        super().on_start()
        self.listen(join(self.team.name, self._controller, self.ensemble.name, "decision"), self._on_decision)
        self.call_later(_PATIENCE, self._on_patience)

    # -- Sending -------------------------------------------------------------------------------------------------

    def request(self, command: str, token: str) -> None:
        """Ask the controller for it, if it is there; a stop holds here until a start that was asked for after it."""
        pending = self.proposals.ask(command, token, reachable=self._here and self._last is not None)
        self._send_due()
        if not pending:
            self.report_void(token, f"agent {self._controller!r}, which decides, is not there")

    @property
    def still(self) -> bool:
        """Whether this agent carries out no decisions."""
        return self.proposals.still

    @property
    def knows(self) -> object:
        """The last decision of the controller that is known here."""
        return [self._life, 0 if self._last is None else self._last.step]

    @property
    def term(self) -> int:
        """The life of the controller that decides."""
        return self._life

    def memory(self) -> bytes | None:
        """Return which life of the controller knows of the stop, and since when."""
        standstill = self.proposals.standstill
        return None if standstill is None else msgspec.msgpack.encode(standstill)

    def obey(self, memory: bytes) -> None:
        """Obey the stop, until the controller has decided a start that was asked for after it."""
        self.proposals.recall(*(msgspec.msgpack.decode(memory, type=tuple[Life, Number]) if memory else (0, 0)))

    def propose(self, part: bytes | None, now: int) -> None:
        """Send this agent's part of the next step."""
        if not self.team.event_driven:
            self.link.send(self._key, encode(Proposal(0, self.tick, part, None)), priority="step")
        elif part is not None and (self._controller in self._live or self.ownership.takes == "state"):
            self.proposals.observe(part)
            self._send_due()
        elif part is not None:
            self._unsaid += 1

    def _send_due(self) -> None:
        """Report the commands that are void, and send the proposal that is due."""
        void, self.proposals.void = self.proposals.void, []
        for token, reason in void:
            self.report_void(token, reason)
        if self.proposals.due:
            self.proposals.due = False
            self._send()

    def _send(self) -> None:
        """Send the oldest pending proposal, now and every 50 ms until the controller acknowledges it."""
        first = self.proposals.first
        if first is not None:
            self.link.send(self._key, encode(first), priority="step")
            self._sent_at = self._now()
            if self._retry is None:
                self._retry = self.call_at(self._sent_at + _RETRY_NS, self._resend)
            else:
                self._retry.set(self._sent_at + _RETRY_NS)

    def _resend(self) -> None:
        due = self._sent_at + _RETRY_NS
        assert self._retry is not None
        if self.proposals.first is not None and due > self._dispatcher.time:  # it is another one, said since
            self._retry.set(due)
        else:
            self._send()

    # -- Receiving -----------------------------------------------------------------------------------------------

    def _on_decision(self, sample: Sample) -> None:
        try:
            decision = decode_decision(sample.body)
        except UNREADABLE as error:
            self.drop(sample, f"is no decision: {error}")
            return
        if decision.action is not None and decision.action >= self.ensemble.controller.policy.num_actions:
            self.drop(sample, f"decides on action {decision.action}, which the model has not")
            return
        if decision.started > decision.step:
            self.drop(sample, f"tells at step {decision.step} of a start at step {decision.started}")
            return
        if not self.link.is_live(sample):
            return  # it is not there yet, or has another configuration
        if sample.incarnation != self._life:
            self._life = sample.incarnation
            self._last = None
            self.proposals.follow(self._life, self._lost)
            self._send_due()
            if self.ownership.takes == "state" and self.team.event_driven:
                self.propose_values(self.own, self._dispatcher.time)  # a controller that begins knows nothing
        taken, bar = decision.taken.get(self.agent, 0), self._bar(decision)
        if can_be(taken, self._dispatcher.time, 1000):
            self.proposals.acknowledge(taken, bar[0])
            self._send_due()
        if (void := decision.void.get(self.agent)) and self.commands.outcomes.get(void) == PENDING:
            self.report_void(void, "a stop came before it")
        self._apply(decision, bar)

    def _bar(self, decision: Decision) -> tuple[int, int]:
        """Return the number of this agent's last stop or hold that the controller has taken, and the step it became."""
        life, number, step = decision.bars.get(self.agent, (0, 0, 0))
        return (number, step) if life == self.link.transport.incarnation else (0, 0)

    def _apply(self, decision: Decision, bar: tuple[int, int]) -> None:
        """Carry out this agent's component of a decision, once.

        The messages of a life come in order. Where the controller is at an earlier step than it said before, or has
        decided something else at the same, it did not say that: its decision counts as when it is heard first.
        """
        now = self._dispatcher.time
        last, self._last = self._last, decision
        if last is not None and (
            decision.step < last.step or (decision.step == last.step and not _same(decision, last))
        ):
            last = None
            self.proposals.doubt(decision.step)
        safety = self.ensemble.safety
        held = self.still
        self._settle(decision, bar)
        self._send_due()
        if last is not None and decision.step == last.step:
            safety.reopen(_CONTROLLER, now)
            return
        self.process.run(running=decision.running)
        still = self.still
        self.report_held(settled=self.proposals.settled)
        if decision.command is not None:
            self.forget()
            self.commands.done(decision.token)
        if not decision.running:
            safety.stop(now)
        elif self.ensemble.mode == "stopped" and not still:
            safety.reopen(_CONTROLLER, now)
            safety.start(now)
        action = decision.action
        goes_on = last is not None and last.running and decision.command in {HOLD, *STARTS} and not held
        if still or goes_on:
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

    def _settle(self, decision: Decision, bar: tuple[int, int]) -> None:
        """Obey the stops and starts of a decision."""
        proposals = self.proposals
        before = proposals.standstill if proposals.still else None
        running, started, called = decision.running, decision.started, decision.called
        proposals.settle(decision.step, bar, running=running, started=started, called=called)
        if (proposals.still or before is not None) and proposals.standstill != before:
            self.keep(self._controller if before is None else "")

    # -- Liveness ------------------------------------------------------------------------------------------------

    def update_live(self, link: Link) -> None:
        """Update whether the controller is live."""
        was, self._live = self._here, link.live
        if was and not self._here:
            self.proposals.leave(self._lost)
            self._send_due()
            if self.ownership.takes != "state":  # what was observed is too old for the next controller
                self._unsaid += self.proposals.forget()
            text = f"agent {self._controller!r}, which decides, is gone"
            self.report_loss([self._controller], "lost_controller", text, lambda: not self._here)
        self.assess(self.runtime.now())

    @property
    def _here(self) -> bool:
        """Whether the controller was there when it looked last."""
        return self._controller in self._live

    @property
    def _lost(self) -> str:
        """Why commands are void that the controller has not taken."""
        return f"agent {self._controller!r}, which decides, was lost before it had it"

    def assess(self, now: int) -> None:
        """Go safe, hold or go on, by who is there; the way back from a lost controller is its next decision."""
        ensemble = self.ensemble
        if self.link.refusal is None:
            if self._here and not (self.lost or ensemble.safety.modes.causes or ensemble.action.barred):
                return  # as at nearly each decision
            if not self._here and self._last is not None:
                ensemble.safety.endanger("lost_controller", f"agent {self._controller!r} is not there", now)
        super().assess(now)

    def _on_patience(self) -> None:
        link = self.link
        if self._last is None and link.refusal is None and self._controller not in link.configuration.differing:
            self.report("waiting", f"cannot act: agent {self._controller!r}, which decides, is not there")

    def statistics(self) -> CentralisedStatistics:
        """Return where it stands."""
        role = "following" if self._last is not None else "joining"
        return CentralisedStatistics(
            **msgspec.structs.asdict(super().statistics()),
            role="refused" if self.link.refusal is not None else role if self._here else "waiting",
            leader=self._controller,
            step=0 if self._last is None else self._last.step,
            digest="" if self._last is None else self._last.digest,
            late=self._unsaid + self.proposals.dropped,
            malformed=self.malformed,
        )


def _same(one: Decision, other: Decision) -> bool:
    """Return whether two decisions of the same step are the same, apart from their acknowledgements."""
    return (one.running, one.epoch, one.action, one.command, one.token, one.started) == (
        *(other.running, other.epoch, other.action),
        *(other.command, other.token, other.started),
    )
