"""The team: who its agents are, and how they decide together, as plain data."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack

from mdm.actors import FixedRate, OnEvent
from mdm.actors.options import drive_of
from mdm.errors import ConfigError
from mdm.logic import similar
from mdm.options import Megabytes, Options, Seconds
from mdm.team.communication import Always
from mdm.team.transport.keys import check_name
from mdm.team.transport.settings import Ceiling, address, ceiling_settings, check_endpoint

if TYPE_CHECKING:
    from mdm.actors import Drive, Ensemble
    from mdm.team.communication import CommunicationPolicy
    from mdm.team.member import Member
    from mdm.team.sharing.commanding import Confirmation
    from mdm.team.transport.access import Access
    from mdm.team.transport.transport import Transport

Mode = Literal["replicated", "centralised", "communicating"]
Quorum = Literal["majority", "continue"]

FIRST_PORT = 7447
"""The port of the first agent on this machine, where nothing is said about endpoints; the others' follow."""


class Agent(Options, frozen=True):
    """An agent of a team.

    Args:
        name: Its name, the same at all agents.
        endpoint: Where it listens and the others reach it, such as ``tcp/192.168.0.7:7450``; None where the transport
            knows.
        listen: Where it listens in place of that, such as ``tcp/0.0.0.0:7450`` in a container.
        connect: Where the others reach it in place of that, such as ``tcp/robot1.local:17450``.
    """

    name: str
    endpoint: str | None = None
    listen: str | None = None
    connect: str | None = None

    @property
    def listens(self) -> str | None:
        """Where it listens for the others."""
        return self.listen or self.endpoint or self.connect

    @property
    def reached(self) -> str | None:
        """Where the others reach it."""
        return self.connect or self.endpoint or self.listen


Given = str | tuple[str, str] | Agent
"""An agent as it is given: its name, its name and its endpoint, or all its addresses."""


class TeamSettings(Options, frozen=True, kw_only=True):
    """How the agents of a team decide together.

    Attributes:
        mode: ``replicated``: each agent holds the whole controller, and all agree on each joint step.
            ``centralised``: one agent decides for all. ``communicating``: each decides by its own knowledge, at a
            period.
        period: Seconds from one joint step to the next, at multiples of the period; without it, each event at any
            agent makes a step.
        drive: In place of ``period``: ``"event"``, or joint steps a second.
        deadline: Seconds that a step waits for the agents' parts, from the first one on (of a communicating team, from
            its tick on); by default half the period, or 0.1 where events make steps. A centralised team in which
            events make steps has none.
        quorum: ``majority``: agents that see no more than half of the team decide nothing; the default for three and
            more. ``continue``: each side goes on by itself; the default for two.
        controller: Of a centralised team, the agent that decides; by default the first.
        communication: Of a communicating team, the policy of sharing; each agent has a copy. By default `Always`.
        lease: Seconds after which an agent that says nothing is taken as lost.
        max_age: Seconds for which the last word of an agent counts that is lost, or late: its state factors, its
            predicates.
        memory: The most megabytes that a model may take at an agent. Ensembles of a file have it unless they say
            something else; those of a program take it as their option of that name.
        ceilings: The most that Zenoh lets through, by key.
        router: The endpoint of a router of Zenoh, which carries all messages: agents then have no addresses.
        state: The folder in which each agent keeps over the end of its process that it was stopped, or waits for a
            release; without one a process that ends forgets. Agents may differ in it.
    """

    mode: Mode = "replicated"
    period: Seconds | None = None
    drive: Any = None
    deadline: Seconds | None = None
    quorum: Quorum | None = None
    controller: str | None = None
    communication: Any = None
    lease: Seconds = 1.0
    max_age: Seconds = 1.0
    memory: Megabytes = 1000.0
    ceilings: Any = ()
    router: str | None = None
    state: Any = None


class TeamOptions(TypedDict, total=False):
    """The keyword arguments of `TeamSettings`."""

    mode: Mode
    period: float | None
    drive: Drive | float | str | None
    deadline: float | None
    quorum: Quorum | None
    controller: str | None
    communication: CommunicationPolicy | None
    lease: float
    max_age: float
    memory: float
    ceilings: Iterable[Ceiling]
    router: str | None
    state: str | Path | None


TeamOptions.__doc__ = TeamSettings.__doc__


class Team:
    """The agents that decide together, and how. The same at every agent; each runs a `Member` of it.

    Args:
        name: The team's name, which begins the keys of its messages.
        agents: All agents, in the order of the model's agents: names, pairs of a name and an endpoint, or
            each an `Agent` with its addresses.
        options: See `TeamOptions`.

    Raises:
        ConfigError: If a name cannot be part of a key, two agents have one name, or a setting means nothing.

    Example::

        team = mdm.Team("rescue", ["robot1", "robot2"], period=0.5)
        team.names  # ('robot1', 'robot2')
        # robot1 runs team.member("robot1", patrol), robot2 the same with its own name
    """

    def __init__(
        self,
        name: str,
        agents: Iterable[Given],
        **options: Unpack[TeamOptions],
    ) -> None:
        settings = TeamSettings.from_keywords(options, below="team.")
        router, deadline, quorum, controller = settings.router, settings.deadline, settings.quorum, settings.controller
        self.name = check_name(name, "a team", key="team.name")
        self.agents = _agents(agents)
        self.names = tuple(agent.name for agent in self.agents)
        self.router = None if router is None else check_endpoint(router, key="team.router", connect=True)
        if router is not None and any(agent.listens for agent in self.agents):
            raise ConfigError(
                "agents with a router listen nowhere: leave out their addresses, or the router", key="team.agents"
            )
        self.mode = settings.mode
        self.drive = _drive(settings.period, settings.drive)
        self.event_driven = isinstance(self.drive, OnEvent)
        self.period = 1 / self.drive.rate if isinstance(self.drive, FixedRate) else None
        if deadline is not None and self.period is not None and deadline > self.period:
            raise ConfigError(
                f"a step would wait {deadline} s for the agents' parts, but the next begins after {self.period:g} s",
                key="team.deadline",
            )
        if deadline is not None and self.period is None and self.mode == "centralised":
            raise ConfigError(
                "where events make steps, the controller of a centralised team decides on each as it comes, and waits "
                "for nothing: leave out the deadline",
                key="team.deadline",
            )
        self.deadline: float = deadline if deadline is not None else 0.1 if self.period is None else self.period / 2
        if quorum is not None and self.mode != "replicated":
            raise ConfigError(
                f"a quorum is for replicated teams, which agree on each step, but {name!r} is {self.mode}",
                key="team.quorum",
            )
        self.communication = self._communication(settings.communication)
        self.quorum: Quorum = quorum or ("majority" if len(self.agents) > 2 else "continue")
        if controller is not None and self.mode != "centralised":
            raise ConfigError(
                f"a controller is for centralised teams, but {name!r} is {self.mode}", key="team.controller"
            )
        self.controller = self.names[0] if controller is None else self.check_agent(controller, key="team.controller")
        self.lease = settings.lease
        self.max_age = settings.max_age
        self.memory = settings.memory
        self.ceilings = tuple(settings.ceilings)
        ceiling_settings(self.ceilings)  # which refuses what is none
        if settings.state is not None and not isinstance(settings.state, str | Path):
            raise ConfigError(f"state is the name of a folder, not {settings.state!r}", key="team.state")
        self.state = None if settings.state is None else Path(settings.state)

    def __repr__(self) -> str:
        """Return its name, mode and agents."""
        return f"<Team {self.name!r}: {self.mode}, {', '.join(self.names)}>"

    def _communication(self, given: CommunicationPolicy | None) -> CommunicationPolicy:
        """Return the communication policy; refuse one that means nothing in the team's mode."""
        if self.mode != "communicating":
            if given is not None:
                raise ConfigError(
                    f"a communication policy is for communicating teams, but {self.name!r} is {self.mode}",
                    key="team.communication",
                )
        elif self.period is None:
            raise ConfigError(
                "the agents of a communicating team number their steps by the clock: give a period", key="team.period"
            )
        elif given is not None and not callable(getattr(given, "share", None)):
            raise ConfigError(
                f"a communication policy needs a method share, which {given!r} lacks: use mdm.team.Always() or another "
                "of mdm.team",
                key="team.communication",
            )
        return Always() if given is None else given

    def check_agent(self, name: object, *, key: str = "agent") -> str:
        """Return an agent's name.

        Raises:
            ConfigError: If there is no such agent; the message suggests similar ones.
        """
        if name not in self.names:
            hint = similar(str(name), self.names) or f"; the agents are {', '.join(self.names)}"
            raise ConfigError(f"team {self.name!r} has no agent {name!r}{hint}", key=key)
        return str(name)

    def endpoints(self, protocol: str = "tcp") -> dict[str, str]:
        """Return where each agent is reached: by the router; else those that do not say it here, at a port each."""
        return {
            agent.name: agent.reached or self.router or f"{protocol}/127.0.0.1:{FIRST_PORT + number}"
            for number, agent in enumerate(self.agents)
        }

    def addresses(self, agent: str | None = None, protocol: str = "tcp") -> dict[str, Any]:
        """Return where an agent listens, and what it connects to, as arguments of a session.

        Args:
            agent: The agent; None for somebody else, who listens nowhere and connects to all.
            protocol: That of agents which say nothing of their addresses.
        """
        if self.router is not None:
            return {"listen": [], "connect": [self.router], "mode": "client"}
        reached = [*self.endpoints(protocol).values()]
        if agent is None:
            return {"listen": [], "connect": reached}
        place = self.names.index(agent)
        return {"listen": [self.agents[place].listens or reached[place]], "connect": reached[:place]}

    # -- Commands ------------------------------------------------------------------------------------------------

    async def start(self, **options: Any) -> tuple[Confirmation, ...]:
        """Start the team, from outside; see `stop`."""
        return await self._command("start", **options)

    async def stop(self, **options: Any) -> tuple[Confirmation, ...]:
        """Stop the team, from outside: the command goes to every agent.

        Args:
            options: ``ensemble``, by default the only one; ``seconds`` to wait for each agent's state, by
                default 5; the ``access`` of the team's operator, where its agents have certificates; or the
                ``transport`` to ask by, open, in place of a session of its own.

        Returns:
            The state of each agent afterwards; those that did not confirm say why not.

        Example::

            unconfirmed = [one.agent for one in await team.stop() if not one.confirmed]
        """
        return await self._command("stop", **options)

    async def reset(self, **options: Any) -> tuple[Confirmation, ...]:
        """Begin a new episode of the team, from outside; see `stop`."""
        return await self._command("reset", **options)

    async def release(self, **options: Any) -> tuple[Confirmation, ...]:
        """End the safe mode of every agent, from outside; see `stop`."""
        return await self._command("release", **options)

    async def _command(
        self, name: str, *, transport: Transport | None = None, access: Access | None = None, **options: Any
    ) -> tuple[Confirmation, ...]:
        from mdm.team.sharing.calls import asking  # noqa: PLC0415 - it asks for a team
        from mdm.team.sharing.commanding import command  # noqa: PLC0415

        if transport is not None:
            return await command(transport, self, name, **options)
        async with asking(self, access) as (session, _):
            return await command(session, self, name, **options)

    def member(self, agent: str, *ensembles: Ensemble, transport: Transport | None = None, **options: Any) -> Member:
        """Return one agent's part of the team, an actor to run.

        Args:
            agent: Which agent this process is.
            ensembles: Its ensembles; of the same names at every agent.
            transport: The transport of its messages; by default a session of Zenoh.
            options: See `mdm.team.member.Member`.
        """
        from mdm.team.member import Member  # noqa: PLC0415 - a member is made of a team

        return Member(self, agent, ensembles, transport=transport, **options)


def _agents(given: Iterable[Given]) -> tuple[Agent, ...]:
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise ConfigError(f"agents are a list of names, or of (name, endpoint), not {given!r}", key="team.agents")
    agents: list[Agent] = []
    taken: dict[tuple[str, str, str], str] = {}
    for place, one in enumerate(given):
        key = f"team.agents.{place}"
        pair: Any = one if isinstance(one, tuple) and len(one) == 2 else (one,)
        agent = one if isinstance(one, Agent) else Agent(*pair)
        name = check_name(agent.name, "an agent", key=key)
        if any(name == other.name for other in agents):
            raise ConfigError(f"two agents are called {name!r}: each has a name of its own", key=key)
        for end in (agent.endpoint, agent.listen, agent.connect):
            if end is not None:
                check_endpoint(end, key=key)
        if agent.reached is not None:
            other = taken.setdefault(address(check_endpoint(agent.reached, key=key, connect=True)), name)
            if other != name:
                raise ConfigError(
                    f"{other!r} and {name!r} are both reached at {agent.reached}: each has an address of its own",
                    key=key,
                )
        agents.append(agent)
    if not agents:
        raise ConfigError("a team has at least one agent", key="team.agents")
    return tuple(agents)


def _drive(period: float | None, drive: Drive | float | str | None) -> Drive:
    if period is not None and drive is not None:
        raise ConfigError("give a period or a drive, not both", key="team.drive")
    if period is not None:
        return FixedRate(1 / period)
    return drive_of(drive)
