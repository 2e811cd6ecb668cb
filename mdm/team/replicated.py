"""The replica: one agent's copy of an ensemble behind the agreement of its team.

It proposes its agent's input, applies the steps that the team agrees on, and reports the effects on the safety of
its agent. Everything happens in turns of the event loop, and nothing waits.
"""

from __future__ import annotations

from asyncio import get_running_loop
from enum import Enum
from typing import TYPE_CHECKING, Literal

import msgspec

from mdm.errors import ConfigError, Error
from mdm.runtime import ActorStatistics, Subscription
from mdm.runtime.supervision import describe
from mdm.stimuli import Acknowledged
from mdm.team.agreement import Agreement, decode, encode
from mdm.team.agreement.messages import Applied, Command, Component, Entries, Snapshot, is_possible
from mdm.team.agreement.proposals import HOLD, Held, Standstill
from mdm.team.copy import BEGIN
from mdm.team.layer import TeamLayer
from mdm.team.transport.keys import join

if TYPE_CHECKING:
    from mdm.actors import Ensemble
    from mdm.runtime.dispatcher import Alarm
    from mdm.team.agreement import Commit, Send, Standing
    from mdm.team.link import Link
    from mdm.team.ownership import Placement
    from mdm.team.team import Team
    from mdm.team.transport.transport import Sample

_PATIENCE = 1.0
_ALL = "all"
_MAJORITY = frozenset({"lost_majority"})
_STEADY = frozenset({"leading", "following"})
_OFFERS = (Command, Component)
"""Messages that say besides that their sender has applied the step before."""
_AWAITED = (Component, Applied)
"""Messages that a leader awaits; until the last of them has come, each changes only the number that it awaits."""
_BEHIND = (Entries, Snapshot)
"""Messages with steps that others took before."""


class Stage(Enum):
    """The work that a step has left for later: its end, in the same turn, and its acknowledgement, a turn later.

    | | nothing follows | the turn ends later | the last step is acknowledged later | both |
    | --- | --- | --- | --- | --- |
    | a step is processed | ``ENDING`` | ``ENDING`` | ``OVERLAPPING`` | ``OVERLAPPING`` |
    | the turn ends, with an acknowledgement to send | | ``ACKNOWLEDGING`` | | ``ACKNOWLEDGING`` |
    | the turn ends without one | | ``IDLE`` | | ``ACKNOWLEDGING`` |
    | the acknowledgement is due | ``IDLE`` | ``ENDING`` | ``IDLE`` | ``ENDING`` |
    | the layer stops | ``IDLE`` | ``IDLE`` | ``IDLE`` | ``IDLE`` |
    """

    IDLE = "nothing is left to do"
    ENDING = "the turn ends later"
    ACKNOWLEDGING = "the last step is acknowledged later"
    OVERLAPPING = "the last step is acknowledged later, and the turn of the next one ends later"


class ReplicatedStatistics(ActorStatistics, frozen=True):
    """Where a replica stands in the agreement.

    Attributes:
        role: ``leading``, ``following``, ``joining``, ``waiting`` (no majority) or ``refused``.
        term: The number of the present term.
        leader: Who leads it, if anybody.
        step: The last step that was applied.
        digest: Of the copy after it.
        members: Who takes part.
        commits: Steps applied in this process.
        unsaid: Events that were seen while there was no majority, where events make steps; they are discarded.
        late: Messages that came too late for their step or term.
        malformed: Messages and parts that were none.
    """

    role: Standing | Literal["refused"]
    term: int
    leader: str | None
    step: int
    digest: str
    members: tuple[str, ...]
    commits: int
    unsaid: int
    late: int
    malformed: int


class ReplicatedLayer(TeamLayer):
    """The last layer of an ensemble in a replicated team: all of its agents have the same controller.

    Raises:
        ConfigError: If the ensemble cannot be replicated.

    Attributes:
        agreement: The state machine that this agent agrees by.
        stage: The work that its last step has left for later.
    """

    def __init__(self, team: Team, ensemble: Ensemble, link: Link, placement: Placement) -> None:
        if ensemble.status().searches:
            raise ConfigError(
                f"ensemble {ensemble.name!r} searches, which takes each agent another time: a replicated team needs a "
                "policy that decides the same everywhere; centralised, one agent searches for all",
                key=f"ensembles.{ensemble.name}.policy",
            )
        super().__init__("replica", team, ensemble, link, placement)
        self.digest, self.snapshot = self.copy.digest, self.copy.snapshot
        deadline = round(team.deadline * 1e9)
        self.agreement = Agreement(
            self.agent,
            team.names,
            self,
            incarnation=link.transport.incarnation,
            mode=team.quorum,
            event_driven=team.event_driven,
            deadline_ns=deadline,
            retry_ns=max(10_000_000, min(50_000_000, deadline // 2)),
        )
        self._keys = {to: link.key(ensemble.name, "agreement", to or _ALL) for to in (None, *team.names)}
        self._applied = 0
        self._unsaid = 0
        self.stage = Stage.IDLE
        self._role: Standing = "joining"
        self._term = 0
        self._alone: tuple[str, str] | None = None
        self._saved: bytes | None = None  # a copy by which the ensemble has yet to start or stop
        self._complaint: tuple[str, int] | None = None
        self._timer: Alarm | None = None
        self._age: Alarm | None = None
        self._sending: Subscription[list[Send]] = Subscription(None, self, self._send_all)
        self._unsent = 0
        self._ending_turn: Subscription[None] = Subscription(None, self, self._end_turn)
        self._acknowledging: Subscription[None] = Subscription(None, self, self._acknowledge)
        self._acknowledgement: Send | None = None

    # -- Life ----------------------------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Listen to the own layers and to the other agents."""
        self._timer = self._age = None
        self._unsent = 0
        if self._saved is not None:  # the ensemble has failed, and begins again: the team has gone on
            self.restore(self._saved)
            self._resume(self.runtime.now())
        super().on_start()
        for to in (_ALL, self.agent):
            self.listen(join(self.team.name, "*", self.ensemble.name, "agreement", to), self._on_message)
        self.call_later(_PATIENCE, self._on_patience)

    def on_stop(self) -> None:
        """Keep the copy for the next start."""
        super().on_stop()
        self.stage, self._acknowledgement = Stage.IDLE, None
        self._saved = self.copy.snapshot()

    # -- Sending -------------------------------------------------------------------------------------------------

    def propose(self, part: bytes | None, now: int) -> None:
        """Propose this agent's part of the next step; without a majority it would be too old when a step took it."""
        if self._role == "waiting" and self.team.event_driven:
            self._unsaid += 1
            return
        agreement, step = self.agreement, self.agreement.log.position.step
        sends = agreement.propose(part, now)
        if self._unsent or agreement.log.position.step != step:
            self._process(sends, now)
            return
        # No callback follows from it, and nothing else has changed: it is on the wire before anything is noted of it.
        for send in sends:
            self._send(send)
        self._set_timer()

    def request(self, command: str, token: str) -> None:
        """Propose a command, for a step of its own; a start of one that was never met waits until it decides alone."""
        if command in {"start", "resume"} and self._is_kept_out:
            self._alone = command, token
            self.link.go_without()
            return
        now = self.runtime.now()
        self._process(self.agreement.propose(None, now, command, token), now)

    @property
    def still(self) -> bool:
        """Whether this agent carries out no decisions."""
        return self.agreement.hold.still

    @property
    def knows(self) -> object:
        """The last step."""
        position = self.agreement.log.position
        return [position.term.number, position.term.leader, position.term.incarnation, position.step]

    @property
    def term(self) -> int:
        """The number of its term."""
        return self.agreement.term.number

    def memory(self) -> bytes | None:
        """Return the stop that it obeys, and where that stands in the history."""
        standstill = self.agreement.hold.standstill
        return None if standstill is None else msgspec.msgpack.encode(standstill)

    def obey(self, memory: bytes) -> None:
        """Obey the stop, until a start behind it in the history that counts."""
        if memory:
            standstill = msgspec.msgpack.decode(memory, type=Standstill)
        else:
            standstill = Standstill(f"{self.agent}.{self.link.transport.incarnation:x}.stored")
        self.agreement.hold.recall(standstill)

    def _process(self, sends: list[Send], now: int) -> None:
        """Send the agreement's outgoing messages and apply its state to the ensemble.

        Both come after this agent's callback, except changes that may prevent the callback.
        """
        agreement = self.agreement
        role = agreement.state.role
        if self.process.catching_up or agreement.reports or agreement.proposals.void or role != self._role:
            self._follow_up(now)
        if sends:
            self._unsent += 1
            self._dispatcher.deliver(self._sending, sends)
        stage = self.stage
        if stage is Stage.IDLE or stage is Stage.ACKNOWLEDGING:
            self.stage = Stage.ENDING if stage is Stage.IDLE else Stage.OVERLAPPING
            self._dispatcher.deliver_behind(self._ending_turn, None)

    def _send_all(self, sends: list[Send]) -> None:
        self._unsent -= 1
        for send in sends:
            self._send(send)

    def _send(self, send: Send) -> None:
        """Put a message on the wire; an acknowledgement at the end of the turn, where nothing says the same by then."""
        if isinstance(send.message, Applied):
            self._acknowledgement = send
            return
        if isinstance(send.message, _OFFERS):
            self._acknowledgement = None
        self.link.send(self._keys[send.to], encode(send.message), priority="step")

    def repeat_acknowledgement(self) -> None:
        """Acknowledge the last step, where the record of a run does."""
        self._dispatcher.deliver(self._acknowledging, None)

    def _acknowledge(self, _: None) -> None:
        """Acknowledge the last step, unless a proposal has done so meanwhile."""
        if self._dispatcher.observed:
            self._dispatcher.observers.stimulus(Acknowledged(self._now(), self.path))
        if self.stage is Stage.ACKNOWLEDGING:
            self.stage = Stage.IDLE
        elif self.stage is Stage.OVERLAPPING:
            self.stage = Stage.ENDING
        send, self._acknowledgement = self._acknowledgement, None
        if send is not None:
            self.link.send(self._keys[send.to], encode(send.message), priority="step")

    def _end_turn(self, _: None) -> None:
        """Do the work of a step that may wait until the end of the turn."""
        if self.stage is Stage.IDLE or self.stage is Stage.ACKNOWLEDGING:  # the layer has stopped meanwhile
            return
        self.stage = Stage.IDLE if self.stage is Stage.ENDING else Stage.ACKNOWLEDGING
        self._follow_up(self._dispatcher.time)
        self.copy.digest()  # for which the next step then need not wait
        stage = self.stage
        if self._acknowledgement is not None and (stage is Stage.IDLE or stage is Stage.ENDING):
            # Who observes something as soon as it was called offers it to the next step, and says the same by that.
            self.stage = Stage.ACKNOWLEDGING if stage is Stage.IDLE else Stage.OVERLAPPING
            if not self._dispatcher.choices.repeats:
                get_running_loop().call_soon(self._dispatcher.deliver, self._acknowledging, None)

    # -- Receiving -----------------------------------------------------------------------------------------------

    def _on_message(self, sample: Sample) -> None:
        try:
            message = decode(sample.body)
        except Error as error:
            self.drop(sample, str(error))
            return
        now = self._dispatcher.time
        agreement = self.agreement
        if message.term != agreement.state.term and not is_possible(message, agreement.order, now):
            self.drop(sample, "is of a term that cannot be")
            return
        if isinstance(message, _BEHIND) and not self.process.catching_up:
            self.process.catch_up(now, over=False)
        sends = agreement.receive(sample.owner, sample.incarnation, message, now)
        if sends or not isinstance(message, _AWAITED) or message.term != agreement.state.term:
            self._process(sends, now)
        else:
            self._set_timer()

    def update_live(self, link: Link) -> None:
        """Take note of who is live."""
        barred = link.refusal is not None or self._is_kept_out
        now = self.runtime.now()
        self._process(self.agreement.members(link.live, now, barred=barred), now)

    @property
    def _is_kept_out(self) -> bool:
        """Whether it takes part in no term, where it could alone, since it has not met the others."""
        return self.unmet and self.agreement.majority == 1

    def _on_time(self) -> None:
        now = self._dispatcher.time
        self._process(self.agreement.tick(now), now)

    # -- Where it stands -----------------------------------------------------------------------------------------

    def _follow_up(self, now: int) -> None:
        agreement = self.agreement
        if self._saved is not None and self.process.catching_up:
            self._resume(now)
        if agreement.proposals.void:
            self._report_void()
        if agreement.hold.held is not Held.ACTING or self.reported_held:
            self.report_held(settled=not agreement.hold.waits)
        if agreement.reports:
            self._report_all()
        if agreement.state.role != self._role:
            self._role = agreement.role
        if self.process.catching_up and agreement.state.fetching is None:
            self.process.catch_up(now, over=True)
        self._set_timer()
        ensemble, steady = self.ensemble, self._role in _STEADY
        if not steady or self.lost or ensemble.safety.modes.causes or ensemble.action.barred:
            self.assess(now)
        if steady and (self._alone is not None or not self.copy.begun):
            self._begin()
        if self.ownership.takes == "state" and self.team.event_driven:
            self._propose_again(now)

    def _begin(self) -> None:
        """Ask for the start that waited until this agent may decide alone; or for the first one of a team."""
        if self._alone is not None:
            (command, token), self._alone = self._alone, None
            self.request(command, token)
            return
        waits = any(asked.command == BEGIN for asked in self.agreement.proposals.commands)
        if self._role == "leading" and not (self.copy.begun or self.still or waits):
            self.request(BEGIN, "")

    def _report_void(self) -> None:
        """Report the commands, asked for here, that will be no step."""
        void, self.agreement.proposals.void = self.agreement.proposals.void, []
        for asked, reason in void:
            if asked.command not in {BEGIN, HOLD}:
                self.report_void(asked.token, reason)

    def _report_all(self) -> None:
        """Report the events of the agreement to a person."""
        agreement = self.agreement
        reports, agreement.reports = agreement.reports, []
        for kind, text in reports:
            if kind == "majority":
                gone = [agent for agent in agreement.state.members if agent not in self.link.live]
                self.report_loss(gone, "lost_majority", text, lambda: self._role == "waiting")
            else:
                self.report(kind, text)

    def _set_timer(self) -> None:
        times = self.agreement.state.timers
        if times:  # a timer that is too early finds nothing to do, and the next is set then
            if self._timer is None:
                self._timer = self.call_at(min(times.values()), self._on_time)
            else:
                self._timer.set(min(times.values()))

    def _propose_again(self, now: int) -> None:
        """Where events alone make steps: propose again values that the team has lost, and let other values expire."""
        agreement, copy = self.agreement, self.copy
        if self._role in _STEADY and not self.process.catching_up:
            waiting, number = agreement.proposals.components, agreement.state.term.number
            said: tuple[int | None, ...] | None = self.own
            if not waiting:  # steps without this agent may have been taken too long after its last word
                said = copy.last_values(self.agent)
            elif number != self._term:  # proposals may be older than the values that it saw without a majority
                said = copy.values_of(waiting[-1])
            self._term = number
            if said != self.own:
                self.propose_values(self.own, now)
        if self._role == "leading" and copy.aging and self._age is None:
            self._age = self.call_at(now + round(self.team.max_age * 1e9) + 1, self._on_age)

    def _on_age(self) -> None:
        self._age = None
        if self._role == "leading" and self.copy.aging:
            self.propose_values(self.own, self._dispatcher.time)

    def _on_patience(self) -> None:
        waits = self._role in {"joining", "waiting"} and not self._is_kept_out  # of which the member tells
        if waits and not self.copy.begun and self.link.refusal is None:
            here, needed = self.link.live or {self.agent: 0}, self.agreement.majority
            who = (
                f"of team {self.team.name!r} {len(here)} of {len(self.team.names)} agents are here ({', '.join(here)})"
            )
            others = " and ".join(agent for agent in here if agent != self.agent)
            if len(here) < needed:
                why = f"and it takes {needed}"
            elif others:
                why = f"which is enough, but {others} did not answer yet"
            else:
                why = "which is enough, but the link to the others is not open yet"
            self.report("waiting", f"cannot decide: {who}, {why}")

    def assess(self, now: int) -> None:
        """Go safe, hold or go on, by who is there."""
        safety = self.ensemble.safety
        if self._role == "waiting" and self.copy.begun:
            safety.endanger("lost_majority", f"{self.agent} is without a majority of team {self.team.name!r}", now)
        elif self._role != "joining":
            safety.reopen(_MAJORITY, now)
        super().assess(now)

    # -- The agreement's copy ------------------------------------------------------------------------------------

    def apply(self, commit: Commit) -> None:
        """Apply a step."""
        now = self._dispatcher.time
        if now < 0:  # what the program asks for between turns makes a step at once where nobody else is awaited
            now = self._now()
        self._applied += 1
        try:
            if commit.command is not None:
                self._apply_command(commit, now)
            else:
                self.copy.step(commit.inputs, commit.missing, now)
        except Exception as error:  # a policy or tracker of the user's: the step counts, and this agent fails
            self.fail(error)
        if self.commits is not None and self.commits.heard:
            term = (commit.term.number, commit.term.leader, commit.term.incarnation)
            self.publish_commit(
                *(term, commit.step, commit.inputs, commit.missing, commit.command),
                action=self.process.acted,
                digest=self.copy.digest(),
                caught_up=self.process.catching_up,
            )

    def _apply_command(self, commit: Commit, now: int) -> None:
        """Carry out the command of a step; a hold of one agent orders nothing."""
        command = commit.command
        if command is None or command == HOLD:
            self.keep()
            return
        alone = self.process.running and self.ensemble.mode == "stopped"
        self.apply_command(command, commit.token, now, commit.by)
        if alone and self.ensemble.mode == "deciding":
            self.process.repeat(now)  # it acts on the decision that was made while it alone was stopped

    @property
    def running(self) -> bool:
        """Whether the copy decides."""
        return self.process.running

    def restore(self, snapshot: bytes) -> None:
        """Become another copy."""
        now = self.runtime.now()
        try:
            self.copy.restore(snapshot)
        except Exception as error:
            # It comes again and again, and is told once a second at most.
            text = describe(error)
            if self._complaint is None or (self._complaint[0] != text and now - self._complaint[1] >= 1_000_000_000):
                self._complaint = text, now
                self.report("snapshot", text)
            return
        self._complaint = None
        self._saved = snapshot

    def _resume(self, now: int) -> None:
        """Start or stop acting, by the copy that was restored and the commands of this agent."""
        self._saved = None
        if self.process.running and not self.still:
            self.ensemble.safety.start(now)
        else:
            self.ensemble.safety.stop(now)
        self.keep()

    def statistics(self) -> ReplicatedStatistics:
        """Return where it stands."""
        agreement = self.agreement
        return ReplicatedStatistics(
            **msgspec.structs.asdict(super().statistics()),
            role="refused" if self.link.refusal is not None else "waiting" if self.unmet else agreement.role,
            term=agreement.state.term.number,
            leader=agreement.leader,
            step=agreement.step,
            digest=self.copy.digest(),
            members=agreement.state.members,
            commits=self._applied,
            unsaid=self._unsaid,
            late=agreement.late,
            malformed=self.malformed + self.copy.malformed,
        )
