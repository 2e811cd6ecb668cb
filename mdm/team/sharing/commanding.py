"""Commands: their outcomes at an agent, and commands to a whole team from outside, confirmed by each agent."""

from __future__ import annotations

import asyncio
import secrets
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.errors import Error
from mdm.team.sharing.calls import COMMANDS, ask

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mdm.team.team import Team
    from mdm.team.transport.transport import Transport

PENDING = "pending"
DONE = "done"

_MOST_COMMANDS = 32

_ANSWER = 0.8
_PAUSE = 0.1
_WITHOUT_TEAM = frozenset({"waiting", "joining", "refused"})
"""Roles in which a stop holds at an agent, and is nobody else's."""


class Commands:
    """The last commands of one agent, by their tokens, and the outcome of each.

    A token identifies a command; it is the same at all agents that are asked for the same.

    Args:
        agent: Which agent, for the tokens of commands that are asked for here.
        life: Which life of it.

    Attributes:
        outcomes: ``pending``, ``done``, or ``void: `` and the reason, by token; the oldest first.
    """

    def __init__(self, agent: str, life: int) -> None:
        self._name = f"{agent}.{life:x}"
        self._count = 0
        self._names: dict[str, str] = {}
        self.outcomes: dict[str, str] = {}

    def ask(self, command: str, token: str | None) -> str:
        """Take note of a command that is asked for; return its token, which is made here where none is given."""
        if token is None:
            self._count += 1
            token = f"{self._name}.{self._count}"
        self._set(token, PENDING)
        self._names[token] = command
        return token

    def name(self, token: str) -> str:
        """Return which command was asked for here."""
        return self._names.get(token, "a command")

    def done(self, token: str) -> None:
        """Take note of a command that is done here."""
        if token:
            self._set(token, DONE)

    def void(self, token: str, reason: str) -> None:
        """Take note of a command that will not be done."""
        self._set(token, f"void: {reason}")

    def _set(self, token: str, outcome: str) -> None:
        self.outcomes.pop(token, None)
        self.outcomes[token] = outcome
        if len(self.outcomes) > _MOST_COMMANDS:
            oldest = next(iter(self.outcomes))
            del self.outcomes[oldest]
            self._names.pop(oldest, None)


class Confirmation(msgspec.Struct, frozen=True):
    """The state of an agent after a command.

    Args:
        agent: Which agent.
        ensemble: Of which ensemble.
        confirmed: Whether it is in the state that was commanded.
        problem: Why not, in words.
        mode: ``stopped``, ``deciding`` or ``safe``; None where it does not answer, as in the next fields.
        role: Its role in the team.
        term: The number of its term; None where its team has none.
        step: Its last step.
    """

    agent: str
    ensemble: str
    confirmed: bool = False
    problem: str | None = None
    mode: str | None = None
    role: str | None = None
    term: int | None = None
    step: int | None = None


async def command(
    transport: Transport,
    team: Team,
    name: str,
    *,
    ensemble: str = "*",
    agents: Iterable[str] | None = None,
    seconds: float = 5.0,
) -> tuple[Confirmation, ...]:
    """Send a command to every agent of a team, and wait until each confirms it, or the time is over.

    Args:
        transport: A transport of the asker's, open.
        team: The team.
        name: ``start``, ``stop``, ``reset`` or ``release``.
        ensemble: Of which ensemble; by default the only one.
        agents: Who runs it; by default all agents.
        seconds: How long to wait.

    Returns:
        The state of each agent afterwards, in the order of the team.

    Raises:
        Error: If there is no such command.
    """
    if name not in COMMANDS:
        raise Error(f"there is no command {name!r}; there are {', '.join(COMMANDS)}")
    return await _Order(transport, team, name, ensemble, tuple(team.names if agents is None else agents)).carry_out(
        seconds
    )


def _is_known(state: dict[str, Any], others: dict[str, dict[str, Any]]) -> bool:
    """Return whether all agents that one sees know of the same commands: a start that follows is not beaten by one."""
    return all(others[agent].get("knows") == state.get("knows") for agent in state["live"] if agent in others)


class _Order:
    """A command on its way to all agents."""

    def __init__(self, transport: Transport, team: Team, name: str, ensemble: str, agents: tuple[str, ...]) -> None:
        self._transport = transport
        self._team = team
        self._name = name
        self._ensemble = ensemble
        self._tokens: dict[str, str] = {}
        self._token = secrets.token_hex(8)
        self._open = list(agents)
        self._found = {agent: Confirmation(agent, ensemble, problem="it does not answer") for agent in agents}

    async def carry_out(self, seconds: float) -> tuple[Confirmation, ...]:
        clock = asyncio.get_running_loop()
        until = clock.time() + seconds
        while True:
            left = min(_ANSWER, max(until - clock.time(), _PAUSE))
            await self._send(left)
            late = clock.time() >= until
            await self._look(left, late=late)
            if not self._open or late:
                return tuple(self._found.values())
            await asyncio.sleep(_PAUSE)

    async def _send(self, seconds: float) -> None:
        """Say it to those who have not answered so far, each time as a command of its own where it is a stop."""
        untold = [agent for agent in self._open if agent not in self._tokens]
        token = secrets.token_hex(8) if self._name == "stop" else self._token
        everybody = "*" if len(untold) == len(self._found) else None

        async def send(agent: str) -> dict[str, Any]:
            given: dict[str, Any] = {"agent": agent, "ensemble": self._ensemble, "seconds": seconds}
            return await ask(self._transport, self._team, self._name, body=token.encode(), **given)

        for answers in await asyncio.gather(*map(send, untold if everybody is None else [everybody])):
            for agent in untold:
                if isinstance(answer := answers.get(agent), Error):
                    self._found[agent] = self._confirmation(agent, problem=str(answer))
                    self._open.remove(agent)
                elif answer is not None:
                    self._tokens[agent] = token

    async def _look(self, seconds: float, *, late: bool) -> None:
        """Ask those who were told how they are."""
        states = await ask(self._transport, self._team, "status", ensemble=self._ensemble, seconds=seconds)
        told = {agent: state for agent, state in states.items() if isinstance(state, dict)}
        for agent in tuple(self._open):
            state = told.get(agent)
            if state is not None and agent in self._tokens:
                confirmed, problem = self._judge(state, self._tokens[agent], late=late)
                self._found[agent] = self._confirmation(agent, state, confirmed=confirmed, problem=problem)
                if confirmed and (late or _is_known(state, told)):
                    self._open.remove(agent)
            elif agent in self._tokens:
                self._found[agent] = self._confirmation(agent, problem="it does not say what it is")

    def _confirmation(self, agent: str, state: dict[str, Any] | None = None, **found: Any) -> Confirmation:
        facts: dict[str, Any] = {key: (state or {}).get(key) for key in ("mode", "role", "term", "step")}
        return Confirmation(agent, (state or {}).get("ensemble", self._ensemble), **facts, **found)

    def _judge(self, state: dict[str, Any], token: str, *, late: bool) -> tuple[bool, str | None]:
        """Return whether an agent is in the state that was commanded, and else why not."""
        mode, outcome = state["mode"], state.get("commands", {}).get(token, "")
        settled = outcome != PENDING
        if self._name == "stop":
            done = mode == "stopped" and (settled or late or state.get("role") in _WITHOUT_TEAM)
        elif self._name == "release":
            done = mode != "safe"
        else:
            done = settled and not outcome.startswith("void") and (self._name == "reset" or mode == "deciding")
        if done and (unkept := state.get("unkept")) is not None:
            return False, f"it is {mode}, which is {unkept}"
        if done:
            return True, None
        if outcome.startswith("void") and self._name != "stop":
            return False, outcome
        causes = ", ".join(state.get("causes", ()))
        waits = f"; the {self._name} is pending, since it is {state.get('role')}" if outcome == PENDING else ""
        return False, f"it is {mode}{f' ({causes})' if causes else ''}{waits}"
