"""The centre of a centralised team: the layer at the agent that decides for all."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from mdm.runtime import Subscription
from mdm.team import centralised
from mdm.team.centralised import CentralisedStatistics, Decided, encode
from mdm.team.copy import BEGIN
from mdm.team.layer import TeamLayer
from mdm.team.transport.keys import join

if TYPE_CHECKING:
    from mdm.actors import Ensemble
    from mdm.messages import Action
    from mdm.runtime import Timer
    from mdm.team.link import Link
    from mdm.team.placement import Placement
    from mdm.team.team import Team
    from mdm.team.transport.transport import Sample

__all__ = ["Centre"]


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
        self._saying: Subscription[Decided] = Subscription(None, self, self._spread)
        self._seeing = tuple(agent for agent in team.names if self.parts.of[agent])

    def on_start(self) -> None:
        """Listen to the own layers and to the other agents."""
        self._open = self._timer = None
        super().on_start()
        self.ensemble.control.output.relay(self._publish)
        self.hear(join(self.team.name, "*", self.ensemble.name, "part"), self._on_said)
        if not self._serves:
            self._serves = True
            facts = encode(self.copy.facts)
            self.link.serve(self.link.key(self.ensemble.name, "configuration"), lambda _: facts)
        self.every(4 / self.team.lease, lambda _: self._put())

    def on_running(self) -> None:
        """Begin to decide, or begin anew after a failure."""
        self._command("start" if self.copy.begun else BEGIN)

    def take_live(self, _link: Link) -> None:
        """Take note of who is live: who has just come is told what is decided; nobody waits for who is gone."""
        self._put()
        self._close(late=False)
        self.assess(self.runtime.clock.now())

    def retire(self, reason: str) -> None:
        """Decide nothing more."""
        self._open = None
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        super().retire(reason)

    # -- What the agents say -------------------------------------------------------------------------------------

    def ask_for(self, command: str) -> None:
        """Do what was asked for, at all agents."""
        if self.refusal is None:
            self._command(command)

    def offer(self, part: bytes | None) -> None:
        """Take what this agent has seen."""
        if self.refusal is not None:
            return
        if not self.team.event_driven:
            self._open = self.tick
            if self._timer is not None:
                self._timer.cancel()
            self._timer = self.call_later(self.team.deadline, lambda: self._close(late=True))
            self._collect(self.agent, self.tick, part)
        elif part is not None:
            self._decide({self.agent: part})

    def _on_said(self, sample: Sample) -> None:
        if self.refusal is not None:
            return
        try:
            said = centralised.said(sample.body)
        except (msgspec.MsgspecError, ValueError):
            self.malformed += 1
            return
        if said.number == 0:
            self._collect(sample.owner, said.tick, said.part)
            return
        life, last = self._taken.get(sample.owner, (0, 0))
        if life == sample.incarnation and last >= said.number:
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
        missing = tuple(agent for agent in self._seeing if agent not in said)
        self._decide({agent: part for agent, part in said.items() if part is not None}, missing)

    # -- Decisions -----------------------------------------------------------------------------------------------

    def _decide(self, inputs: dict[str, bytes], missing: tuple[str, ...] | None = None) -> None:
        if missing is None:
            live = self.link.live
            missing = tuple([agent for agent in self._seeing if agent not in live and agent not in inputs])
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
        """Have a decision sent to all."""
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
            digest="",
            taken={},
        )
        # Behind this agent's callback, which does not wait for what is for the others.
        self.runtime.dispatcher.deliver(self._saying, self._last)

    def _spread(self, decided: Decided) -> None:
        """Send a new decision to all, and tell of it here."""
        self._last = decided = msgspec.structs.replace(decided, digest=self.copy.digest())
        self._say(decided)
        life = (1, self.agent, self.link.transport.incarnation)
        self.tell(
            *(life, decided.step, decided.inputs, decided.missing, decided.command),
            action=decided.action,
            digest=decided.digest,
        )

    def _put(self) -> None:
        """Send the last decision once more."""
        self._say(self._last)

    def _say(self, decided: Decided) -> None:
        """Send a decision, with what was taken from each agent."""
        taken = {agent: number for agent, (_, number) in self._taken.items()}
        self.link.put(self._key, encode(msgspec.structs.replace(decided, taken=taken)), priority="step")

    def statistics(self) -> CentralisedStatistics:
        """Return where it stands."""
        return CentralisedStatistics(
            **msgspec.structs.asdict(super().statistics()),
            role="leading" if self.refusal is None else "refused",
            leader=self.agent,
            step=self._last.step,
            digest=self._last.digest,
            late=self._late,
            malformed=self.malformed + self.copy.malformed,
        )
