"""Steps within a term: components to the leader, commits from it, and what is said again."""

from __future__ import annotations

from mdm.team.agreement.entries import Applied, Begin, Command, Commit, Component, Fetch, Position
from mdm.team.agreement.hold import BARS
from mdm.team.agreement.standing import Standing

__all__ = ["Steps"]

_INSISTS = 4
"""Messages one after the other by which a member says that it is ahead of its leader."""


class Steps(Standing):
    """What an agent proposes, commits and applies within a term."""

    def _offer(self, now: int) -> None:
        """Offer what this agent has to say to the next step; a leader then commits what is ready."""
        proposals, hold = self.proposals, self.hold
        while self.begun:
            step = self.history.position.step + 1
            if hold.waits and not proposals.holds(hold.waits):
                proposals.hold(hold.waits, self.term)
            if proposals.commands and proposals.commanded is None:
                proposals.commanded = (self.term, step)
                self._say(self._command(step), now)
            if proposals.components and proposals.offered is None:
                proposals.offered = (self.term, step)
                self._say(Component(self.term, step, proposals.components[0]), now)
            if self.ballot is None or not self._is_ready():
                return
            self._commit(now)

    def _say(self, message: Component | Command, now: int) -> None:
        if self.ballot is None:
            self._send(self.term.leader, message)
            self.timers["retry"] = now + self.retry
            return
        if isinstance(message, Component):
            self.components[self.agent] = message.body
        else:
            self._keep(self.agent, message)
        self._wait(now)

    def _wait(self, now: int) -> None:
        """Limit how long the next step waits for others."""
        if not self.overdue:
            self.timers.setdefault("close", now + self.deadline)

    def _on_component(self, sender: str, message: Component, now: int) -> None:
        if self._hears(sender, message.step, now):
            self.components.setdefault(sender, message.body)
        self._offer(now)

    def _on_command(self, sender: str, message: Command, now: int) -> None:
        if self._hears(sender, message.step, now):
            self._keep(sender, message)
        self._offer(now)

    def _command(self, step: int) -> Command:
        asked = self.proposals.commands[0]
        return Command(self.term, step, asked.command, asked.token)

    def _keep(self, sender: str, message: Command) -> None:
        """Keep a command for the next step; a stop in place of what its agent was asked for before it."""
        if sender not in self.commands or message.command in BARS:
            self.commands[sender] = message.command, message.token

    def _hears(self, sender: str, step: int, now: int) -> bool:
        """Return whether what a member says counts for the next step; it has applied the step before its own."""
        if not self._is_led(sender) or self._is_ahead(sender, step - 1, now):
            return False
        self.applied[sender] = max(self.applied.get(sender, 0), step - 1)
        if step != self.history.position.step + 1:
            self.late += 1
            return False
        self._wait(now)
        return True

    def _is_ahead(self, sender: str, step: int, now: int) -> bool:
        """Return whether a member says that it has more than its leader; where it goes on so, all say what they have.

        Nobody has. Either another has spoken in its name, or it took another history than this one for its leader's,
        and would take no further step.
        """
        if step <= self.history.position.step:
            if self.ahead:
                self.ahead.pop(sender, None)
            return False
        self.ahead[sender] = self.ahead.get(sender, 0) + 1
        if self.ahead[sender] >= _INSISTS:
            told = f"{sender} says that it has applied step {step}, and {self.agent}, which leads, {self.step}"
            self._report("history", f"{told}: all say anew what they have")
            self._call(now)
        return True

    def _call(self, now: int) -> None:
        """Call a new term."""
        raise NotImplementedError

    def _on_applied(self, sender: str, message: Applied, now: int) -> None:
        if self._is_led(sender) and not self._is_ahead(sender, message.step, now):
            self.applied[sender] = max(self.applied.get(sender, 0), message.step)
            self._offer(now)

    def _is_ready(self) -> bool:
        """Return whether the next step can be committed: a majority has applied the last one, and nobody is awaited."""
        if not self.components and not self.commands:
            return False
        step, applied = self.history.position.step, self.applied
        if list(applied.values()).count(step) < self.majority:
            return False
        if self.overdue:
            return True
        members, present, components = self.members_now, self.present, self.components
        if self.commands or self.event_driven:
            awaited = [agent for agent in members if agent in present and applied.get(agent) != step]
        else:
            awaited = [agent for agent in members if agent in present and agent not in components]
        return not awaited

    def _commit(self, now: int) -> None:
        last = self.history.position
        inputs: dict[str, bytes] = {}
        missing: tuple[str, ...] = ()
        command, by, token = None, "", ""
        if self.commands:
            by = min(self.commands, key=lambda agent: self.commands[agent][0] not in BARS)  # of equals the first
            command, token = self.commands[by]
        else:
            components = self.components
            inputs = {agent: body for agent in self.agents if (body := components.get(agent)) is not None}
            if self.event_driven:
                missing = tuple([agent for agent in self.agents if self.applied.get(agent) != last.step])
            else:
                missing = tuple([agent for agent in self.agents if agent not in components])
        digest = self.replica.digest()
        commit = Commit(self.term, last.step + 1, last.term, inputs, missing, command, by, digest, token)
        self._take(commit)
        self.applied[self.agent] = commit.step
        self._new_step()
        self.timers.pop("close", None)
        if self.event_driven:
            self.timers["close"] = now + self.deadline
        if len(self.members_now) > 1:
            self._send(None, commit)
            self.timers["retry"] = now + self.retry

    def _take(self, commit: Commit) -> None:
        if commit.command is not None:
            self.hold.take(commit, Position(commit.term, commit.step))
        self.replica.apply(commit)
        self.history.append(commit)
        self.proposals.settle(commit)

    def _apply(self, commit: Commit, now: int) -> bool:
        """Apply the next step, unless this agent's copy is not what it should be."""
        digest = self.replica.digest()
        if commit.digest != digest:
            self._doubt(digest, now)
            return False
        self._take(commit)
        return True

    def _on_commit(self, _sender: str, commit: Commit, now: int) -> None:
        if not self.sound or self.ballot is not None:
            return
        if not self.history.follows(commit):
            if self.begun and commit.step <= self.step:
                self._send(self.term.leader, Applied(self.term, self.step))
            elif self.fetching is None:
                self._fetch(self.term.leader, now)
        elif self._apply(commit, now):
            if not self.begun:
                self._place()
            self.fetching = None
            self._acknowledge(now, always=self.event_driven or commit.command is not None)

    def _acknowledge(self, now: int, *, always: bool = True) -> None:
        """Tell the leader what was applied: by the next component, or else by a word of its own."""
        said = len(self._out)
        self._offer(now)
        if always and len(self._out) == said:
            self._send(self.term.leader, Applied(self.term, self.step))

    def _begin(self) -> Begin:
        return Begin(self.term, self.history.position, self.replica.digest(), self.members_now)

    def _on_begin(self, _sender: str, begin: Begin, now: int) -> None:
        self.members_now = begin.members
        if not self.sound:
            return
        if self.begun and begin.position.step <= self.step:
            self._send(self.term.leader, Applied(self.term, self.step))
        elif begin.position != self.history.position:
            if self.fetching is None:
                self._fetch(self.term.leader, now)
        elif begin.digest != (digest := self.replica.digest()):
            self._doubt(digest, now)
        else:
            self._place()
            self._acknowledge(now)

    def _fetch(self, target: str, now: int) -> None:
        self.fetching = target
        self._send(target, self._request())
        self.timers["retry"] = now + self.retry

    def _request(self) -> Fetch:
        return Fetch(self.term, self.history.position, None if self.sound else self.replica.digest())

    def _doubt(self, digest: str, now: int) -> None:
        source = self.fetching or self.term.leader
        self._stop()
        self.sound = False
        self._report("digest", f"the copy of {self.agent} after step {self.step} is {digest}, another than at {source}")
        self._fetch(source, now)

    def _remind(self) -> None:
        """Send the last step again to those of whom it is not known that they have applied it."""
        step, commits = self.step, self.history.commits
        for agent in self.members_now:
            known = self.applied.get(agent)
            if known == step or agent not in self.present:
                continue
            last = commits[-1] if known == step - 1 and commits else None
            self._send(agent, self._begin() if last is None or last.term != self.term else last)

    def _insist(self) -> None:
        """Send again what this agent has to say to the next step."""
        proposals, leader = self.proposals, self.term.leader
        if proposals.commanded is not None:
            self._send(leader, self._command(proposals.commanded[1]))
        if proposals.offered is not None:
            self._send(leader, Component(*proposals.offered, proposals.components[0]))
