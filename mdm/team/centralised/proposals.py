"""An agent's proposals to the controller, pending until it acknowledges them; and the stop that holds the agent.

A pure state machine: it knows no clock and sends nothing. Proposals are numbered from 1 in the life of the agent, and
one is under way at a time; whoever has the machine sends it again until it is acknowledged.

| event | what follows |
| --- | --- |
| `ask` for a stop | the agent acts no more; starts and resets that were pending are void |
| `follow` another life of the controller | commands that were pending are void; it is told of a stop again, by a hold |
| `acknowledge` | the next proposal is due; one under whose number another has spoken is due under a new number |
| `settle` a decision | a start ends the stop, if the controller knew of that before, in this life or an earlier one |
| `leave`: the controller is lost | commands that were pending are void |
"""

from __future__ import annotations

from collections import deque
from enum import Enum

import msgspec

from mdm.team.agreement.proposals import BARS, HOLD, STOP
from mdm.team.centralised.messages import Proposal

MOST = 64
"""Proposals that wait; of more, the oldest observation but the first is lost."""


class Stop(Enum):
    """How an agent obeys the last stop that it took."""

    NONE = "it carries out the decisions of the controller"
    UNTOLD = "the controller does not know of the stop, and is told of it when it decides next"
    TOLD = "the controller is told of it, under a number"
    TAKEN = "the controller knows of it"


class Proposals:
    """The proposals of an agent, and whether it acts.

    Args:
        replace: Whether a newer state takes the place of one that was not sent yet, as observations do not.

    Attributes:
        stop: How the agent obeys its last stop.
        due: Whether the first proposal is to be sent now; for the caller to take.
        dropped: Observations that were too many.
        void: Tokens of commands that will not be done, each with the reason; for the caller to take.
    """

    def __init__(self, *, replace: bool) -> None:
        self.stop = Stop.NONE
        self.due = False
        self.dropped = 0
        self.void: list[tuple[str, str]] = []
        self._replace = replace
        self._waiting: deque[Proposal] = deque()
        self._number = 0
        self._life = self._step = 0
        self._told = 0  # the number under which the controller is told of the stop, while it is
        self._since = 0  # the step after which a start ends the stop
        self._known = 0  # the life of the controller that knew of it; 0 where none did

    @property
    def still(self) -> bool:
        """Whether the agent carries out no decisions."""
        return self.stop is not Stop.NONE

    @property
    def settled(self) -> bool:
        """Whether the controller knows of the stop that was asked for here, or there is none."""
        return self.stop in {Stop.NONE, Stop.TAKEN}

    @property
    def first(self) -> Proposal | None:
        """The oldest proposal that is pending."""
        return self._waiting[0] if self._waiting else None

    # -- Of the agent --------------------------------------------------------------------------------------------

    def observe(self, part: bytes) -> None:
        """Take what the agent has seen."""
        self._add(part, None, "")

    def ask(self, command: str, token: str, *, reachable: bool) -> bool:
        """Take a command that is asked of the agent; return whether it is pending.

        Args:
            command: ``"start"``, ``"stop"``, ``"reset"``…
            token: Its identifier.
            reachable: Whether the controller is there, and has decided something.
        """
        if command == STOP:
            self.stop, self._told, self._known = Stop.UNTOLD, 0, 0
            self._discard(
                [each for each in self._commands if each.command not in BARS], "a stop was asked for after it"
            )
        if not reachable:
            return False
        self._add(None, command, token)
        if command == STOP:
            self.stop, self._told = Stop.TOLD, self._number
        return True

    # -- Of the controller ---------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Begin a life of the layer, which has heard of no decision yet."""
        self._step = 0

    def follow(self, life: int, reason: str) -> None:
        """Follow another life of the controller, which knows of nothing that was asked before."""
        self._life, self._step = life, 0
        self.leave(reason)
        if self.still:
            self.stop = Stop.UNTOLD

    def leave(self, reason: str) -> None:
        """Lose the controller: commands that it has not taken were asked for before another decides."""
        self._discard(list(self._commands), reason)
        if self.stop is Stop.TOLD:
            self.stop, self._told = Stop.UNTOLD, 0

    def forget(self) -> int:
        """Discard all that is pending, which is too old for the next controller; return how many it was."""
        count = len(self._waiting)
        self._waiting.clear()
        return count

    def acknowledge(self, taken: int, bar: int) -> None:
        """Take the number of the last proposal that the controller has taken, and of the last stop or hold.

        Where it acknowledges more than was sent, or a command under that number which is none, another has spoken in
        this agent's name: the pending proposals are then due under new numbers.
        """
        first = self.first
        if first is None:
            self._number = max(self._number, taken)
        elif taken >= first.number:
            if taken <= self._number and (bar >= first.number or first.command not in BARS):
                self._waiting.popleft()
            else:
                # Those that wait get the numbers after the last one taken.
                last = max(taken, self._number)
                numbers = {proposal.number: last + place for place, proposal in enumerate(self._waiting, 1)}
                self._waiting = deque(
                    msgspec.structs.replace(proposal, number=numbers[proposal.number]) for proposal in self._waiting
                )
                self._number = last + len(numbers)
                self._told = numbers.get(self._told, self._told)
            self.due = True

    @property
    def standstill(self) -> tuple[int, int] | None:
        """The stop for the next process: the life of the controller that knew of it, and since which step."""
        return (self._known, self._since if self._known else 0) if self.still else None

    def recall(self, known: int, since: int) -> None:
        """Obey the stop of an earlier process."""
        self.stop, self._told, self._known, self._since = Stop.UNTOLD, 0, known, since

    def settle(self, step: int, bar: tuple[int, int], *, running: bool, started: int, called: bool = False) -> None:
        """Take a decision: of stops, and of starts that were asked for after them.

        Args:
            step: Of the decision.
            bar: The number of this agent's last stop or hold that the controller has taken, and the step it became.
            running: Whether the team decides.
            started: The step that started the team last.
            called: Whether somebody has asked this life of the controller for a start.
        """
        self._step = step
        if self.stop is Stop.UNTOLD:
            if running and self._is_over(started, called=called):
                self.stop = Stop.NONE
            else:
                self._add(None, HOLD, "")
                self.stop, self._told = Stop.TOLD, self._number
        elif self.stop is Stop.TOLD:
            if bar[0] >= self._told:
                self.stop, self._told, self._since, self._known = Stop.TAKEN, 0, min(bar[1], step), self._life
        elif not running:
            self.stop, self._since, self._known = Stop.TAKEN, step, self._life
        if self.stop is Stop.TAKEN and running and started > self._since:
            self.stop = Stop.NONE

    def _is_over(self, started: int, *, called: bool) -> bool:
        """Return whether the team was started after a stop of which the controller knew, in this or an earlier life."""
        same = self._known == self._life and started > self._since
        return bool(self._known) and (same or (called and self._known < self._life))

    def doubt(self, step: int) -> None:
        """Count the stop from a step of the controller at most: what it said of later ones was forged."""
        self._since = min(self._since, step)

    # -- The queue -----------------------------------------------------------------------------------------------

    @property
    def _commands(self) -> list[Proposal]:
        return [proposal for proposal in self._waiting if proposal.command is not None]

    def _add(self, part: bytes | None, command: str | None, token: str) -> None:
        waiting = self._waiting
        if self._replace and len(waiting) > 1 and waiting[-1].command is None and command is None:
            waiting.pop()
        elif len(waiting) == MOST:
            del waiting[next((place for place in range(1, len(waiting)) if waiting[place].command is None), 1)]
            self.dropped += 1
        self._number += 1
        waiting.append(Proposal(self._number, 0, part, command, token, self._life, self._step))
        self.due = self.due or len(waiting) == 1

    def _discard(self, gone: list[Proposal], reason: str) -> None:
        for proposal in gone:
            self._waiting.remove(proposal)
            if proposal.command != HOLD:
                self.void.append((proposal.token, reason))
