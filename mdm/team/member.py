"""The member: one agent of a team, as the actor that a process runs."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.actors import Ensemble
from mdm.errors import ConfigError, Error
from mdm.messages import Message
from mdm.runtime import Actor, ActorStatistics
from mdm.team.centralised.follower import CentralisedFollower
from mdm.team.centralised.leader import CentralisedLeader
from mdm.team.centralised.messages import CentralisedStatistics, controlling
from mdm.team.communicating import CommunicatingLayer
from mdm.team.decisions import Committed, Decisions
from mdm.team.link import Clocks, Link
from mdm.team.ownership import Placement, placement_of
from mdm.team.replicated import ReplicatedLayer, ReplicatedStatistics
from mdm.team.sharing.calls import Answers
from mdm.team.sharing.predicates import PredicatePublisher, PredicateSubscriber, wanted
from mdm.team.sharing.remote import Exports, Imports, typed
from mdm.team.storage import Storage
from mdm.team.transport.access import Validity, access_settings
from mdm.team.transport.keys import join
from mdm.team.transport.settings import ceiling_settings
from mdm.team.transport.transport import DOUBLE

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
    from pathlib import Path

    from mdm.actors import PredicateManager
    from mdm.runtime import Channel, Runtime
    from mdm.team.communicating import CommunicatingStatistics
    from mdm.team.team import Team
    from mdm.team.transport.access import Access
    from mdm.team.transport.allowance import Allowance
    from mdm.team.transport.session import Session
    from mdm.team.transport.transport import Transport, TransportStatistics

_PATIENCE = 3.0
"""Seconds, beside a lease, within which all agents of a team may start."""
_SEEK_EVERY = 10.0


class Teammates(Message, frozen=True, gc=False):
    """Who of a team is there, as one agent sees it: the live agents, itself included, and those who are lost."""

    agent: str
    live: tuple[str, ...]
    lost: tuple[str, ...]


class MemberStatistics(ActorStatistics, frozen=True):
    """Where a member stands.

    Attributes:
        live: The agents that it sees, itself included.
        lost: Those that were there and have not left in order.
        layers: Where its ensembles stand, by name.
        transport: Counts of its transport.
    """

    live: tuple[str, ...]
    lost: tuple[str, ...]
    layers: dict[str, ReplicatedStatistics | CentralisedStatistics | CommunicatingStatistics]
    transport: TransportStatistics


class Member(Actor):
    """One agent of a team: its ensembles, and their connection to those of the others.

    It publishes a `Committed` for each joint step on ``commits``, and `Teammates` on ``teammates``. When a teammate is
    lost it reports a fault ``lost_teammate``. When it ends it tells the others, who then do not miss it.

    Args:
        team: The team.
        agent: Which agent it is.
        ensembles: Its ensembles; of the same names at every agent.
        transport: The transport of its messages; by default a session of Zenoh.
        placement: Where the layers of ensembles are, by the ensembles' names; a mapping stands for the `Placement` with
            these arguments. One whose control layer is placed at an
            agent is decided there, in any mode of the team.
        exports: Channels of this agent that others may import, such as ``patrol/belief``; a mapping to the types of
            their messages where they are none of an ensemble's own.
        imports: Channels of others, such as ``robot2/patrol/belief``; the same.
        allowance: How much the session may send.
        access: The certificates by which the agents know each other; endpoints are then those of ``tls``.
        decisions: A file to which each joint step that this agent applies is added as a line of JSON.
        state: The folder in which this agent keeps that it was stopped; by default that of the team.

    Raises:
        ConfigError: If there is no such agent, or an ensemble does not fit the team.

    Attributes:
        link: Its connection to the others.
        layers: The team's layer of each of its ensembles, by name.
        placements: Where the layers of each ensemble are, by its name.
        clocks: How far those of the others are ahead.
        decisions: The writer of their file; None where there is none.
    """

    def __init__(
        self,
        team: Team,
        agent: str,
        ensembles: Sequence[Ensemble],
        *,
        transport: Transport | None = None,
        placement: Mapping[str, Placement | Mapping[str, Any]] | None = None,
        exports: Iterable[str] | Mapping[str, type[Any]] = (),
        imports: Iterable[str] | Mapping[str, type[Any]] = (),
        allowance: Allowance | None = None,
        access: Access | None = None,
        decisions: str | Path | None = None,
        state: str | Path | None = None,
    ) -> None:
        super().__init__(team.check_agent(agent))
        self.team = team
        self.agent = agent
        self.ensembles = _by_name(ensembles)
        self._seeks: Callable[[], Awaitable[None]] | None = None
        if transport is None:
            transport = session = _session(team, agent, allowance, access)
            self._seeks = lambda: self._seek_double(session.identity, access)
        elif allowance is not None or access is not None:
            raise ConfigError(
                "an allowance and access are for the session that a member makes: give them to the transport",
                key="transport",
            )
        if transport.agent != agent:
            raise ConfigError(f"the transport is that of agent {transport.agent!r}, not of {agent!r}", key="transport")
        given = {name: placement_of(one) for name, one in (placement or {}).items()}
        self.placements = {name: given.get(name, Placement()) for name in self.ensembles}
        self.link = Link(team, transport, _facts(team, self.ensembles, given))
        self.layers: dict[str, ReplicatedLayer | CentralisedLeader | CentralisedFollower | CommunicatingLayer] = {}
        self.lost: tuple[str, ...] = ()
        self._live: tuple[str, ...] = ()
        self._met: set[str] = set()
        self.managers = _managers(self.ensembles.values())
        self.exports = Exports(self.link, typed(exports, "exports"))
        self.imports = Imports(self.link, typed(imports, "imports"))
        told = PredicatePublisher(self.link, self.managers)
        self.clocks = Clocks(self.link)
        self._followed = _followed(team, self.link, self.managers, told)
        self.decisions = None if decisions is None else Decisions(decisions)
        state = team.state if state is None else state
        storage = None if state is None else Storage(state, team.name, agent, self.ensembles)
        validity = None if access is None else Validity(access, agent, listens=team.router is None)
        # Decisions first: where they cannot be written, nothing else starts, and their writer stops last.
        for actor in (self.decisions, storage, validity, self.link):
            if actor is not None:
                self.add(actor)
        for name, ensemble in self.ensembles.items():
            layer = self.layers[name] = _layer(team, ensemble, self.link, given.pop(name, Placement()))
            layer.storage = storage
            ensemble.add(layer)
            self.add(ensemble)
        answers = Answers(self.link, self.ensembles, self.layers, self.clocks, validity)
        for each in (told, *self._followed, self.exports, self.imports, self.clocks, answers):
            self.add(each)
        if given:
            raise ConfigError(
                f"there is no ensemble {next(iter(given))!r} to place; there are {', '.join(self.ensembles)}",
                key="placement",
            )

    # -- Life ----------------------------------------------------------------------------------------------------

    def prepare(self, runtime: Runtime) -> None:
        """Make predicate managers follow the other agents; call this before starting one of them."""
        for followed in self._followed:
            followed.prepare(runtime)

    def on_start(self) -> None:
        """Make the channels, and have predicate managers follow the other agents."""
        self.prepare(self.runtime)
        commits = self.channel("commits", Committed)
        self._teammates = self.channel("teammates", Teammates, retain=True)
        for layer in self.layers.values():
            layer.commits = commits

    def on_running(self) -> None:
        """Connect with the others: everything here listens by now, and is as an earlier process of this agent was."""
        for layer in self.layers.values():
            layer.bring_back()
        self.link.watch(self._on_live, self)
        self.link.connect()
        self._met.clear()
        self.call_later(_PATIENCE + self.team.lease, self._tell_missing)

    def imported(self, name: str) -> Channel[Any]:
        """Return the channel on which another agent's is published here, such as ``robot2/patrol/belief``."""
        return self.imports.imported(name)

    async def on_stopping(self) -> None:
        """Tell the others that this agent leaves, before anything of it ends."""
        self.link.send_farewell()

    def failings(self) -> list[str]:
        """Return in words the duties that it did not carry out."""
        told = []
        if (refusal := self.link.configuration.last_refusal) is not None:
            told.append(f"agent {self.agent!r} took no part in team {self.team.name!r}: {refusal}")
        if self.decisions is not None and self.decisions.lost:
            told.append(f"{self.decisions.lost} decisions could not be written to {self.decisions.path_of_file}")
        return told

    # -- Teammates -----------------------------------------------------------------------------------------------

    def _on_live(self, link: Link) -> None:
        live = tuple(link.live)
        self._met.update(link.configuration.differing)
        if link.refusal is not None:
            self._live, self.lost = live, ()
            self._teammates.publish(Teammates(self.runtime.now(), self.agent, live, ()))
            return
        lost = [agent for agent in self.team.names if agent in link.joined and agent not in live]
        for agent in lost:
            if agent not in self.lost:
                self.report(
                    "lost_teammate", f"agent {agent!r} of team {self.team.name!r} is lost; there are {', '.join(live)}"
                )
        self._live, self.lost = live, tuple(lost)
        self._met.update(live, link.left)
        self._teammates.publish(Teammates(self.runtime.now(), self.agent, live, self.lost))
        for layer in self.layers.values():
            layer.update_lost(lost)

    def _tell_missing(self) -> None:
        """Report agents that were never seen: where a team goes on without them, nothing else would."""
        if self.link.refusal is not None:
            return
        self._met.update(self.link.configuration.differing)
        missing = [agent for agent in self.team.names if agent not in self._met and agent != self.agent]
        if missing:
            who = f"{' and '.join(map(repr, missing))} of team {self.team.name!r} {'were' if missing[1:] else 'was'}"
            unmet = any(layer.unmet for layer in self.layers.values())
            goes_on = f"until then, or until a start that is asked for here, {self.agent} decides nothing"
            if not unmet:
                goes_on = f"{self.agent} decides on what it knows"
            or_router = "" if self.team.router is None else f" or the router at {self.team.router}"
            self.report(
                "missing_teammate",
                f"{who} never met: no such agent runs, or its endpoint{or_router}, the "
                f"authority of its certificate, or the team's name or the order of its agents there, differ; {goes_on}",
            )
            for layer in self.layers.values():
                layer.miss(f"never met: {', '.join(missing)}")
            if self._seeks is not None:
                self.spawn(self._seeks(), name="seek a double")

    async def _seek_double(self, identity: bytes, access: Access | None) -> None:
        """Ask at all endpoints, until others are met, for a process of this name: they connect to that one alone."""
        from mdm.team.sharing.calls import asking  # noqa: PLC0415 - nobody asks in most processes

        while not self.link.met:
            answers: dict[str, bytes] = {}
            with suppress(Error):
                async with asking(self.team, access, self.agent) as (session, _):
                    answers = await session.ask(join(self.team.name, "*", DOUBLE), identity)
            for where in filter(None, answers.values()):
                self.link.tell_double(self.agent, where.decode(errors="replace"))
            await self.runtime.clock.sleep(_SEEK_EVERY)

    def statistics(self) -> MemberStatistics:
        """Return where it stands."""
        return MemberStatistics(
            **msgspec.structs.asdict(super().statistics()),
            live=self._live,
            lost=self.lost,
            layers={name: layer.statistics() for name, layer in self.layers.items()},
            transport=self.link.transport.statistics(),
        )


def _layer(
    team: Team, ensemble: Ensemble, link: Link, placement: Placement
) -> ReplicatedLayer | CentralisedLeader | CentralisedFollower | CommunicatingLayer:
    """Return the layer that connects an ensemble with those of its name at the other agents."""
    if team.mode == "centralised" or placement.control is not None:
        decides = controlling(team, ensemble, placement) == link.agent
        return (CentralisedLeader if decides else CentralisedFollower)(team, ensemble, link, placement)
    return (CommunicatingLayer if team.mode == "communicating" else ReplicatedLayer)(team, ensemble, link, placement)


def _facts(team: Team, ensembles: Iterable[str], placement: Mapping[str, Placement]) -> dict[str, str]:
    """Return the facts that must be the same at all agents for them to decide together."""
    told = {"team's agents": ", ".join(team.names), "team's mode": team.mode}
    for name in sorted({*ensembles, *placement}):
        control = placement.get(name, Placement()).control
        if control is not None or team.mode == "centralised":
            told[f"who decides ensemble {name!r}"] = control or team.controller
    return told


def _session(team: Team, agent: str, allowance: Allowance | None, access: Access | None) -> Session:
    """Return a session of Zenoh, which connects to the agents declared before this one, or to the team's router."""
    from mdm.team.transport.session import Session  # noqa: PLC0415 - the one that needs Zenoh

    configuration = ceiling_settings(team.ceilings)
    endpoints = team.endpoints("tcp" if access is None else "tls")
    for name, endpoint in endpoints.items():
        if endpoint.startswith(("tls/", "quic/")) == (access is None):
            needs = "access needs endpoints that begin with tls/, but"
            if access is None:
                needs = "endpoints that begin with tls/ or quic/ need access, the folder of certificates, and"
            raise ConfigError(f"{needs} {name!r} has {endpoint}", key="team.agents")
    if access is not None:
        configuration |= access_settings(access, team.name, agent, team.names, routed=team.router is not None)
    return Session(
        *(team.name, agent),
        **team.addresses(agent, "tcp" if access is None else "tls"),
        lease=team.lease,
        allowance=allowance,
        configuration=configuration,
    )


def _managers(ensembles: Iterable[Ensemble]) -> tuple[PredicateManager, ...]:
    """Return the predicate managers of ensembles and of those below them, each once."""
    found: dict[PredicateManager, None] = {}
    for ensemble in ensembles:
        if ensemble.predicates is not None:
            found[ensemble.predicates] = None
        found.update(dict.fromkeys(_managers(ensemble.subensembles)))
    return tuple(found)


def _followed(
    team: Team, link: Link, managers: Sequence[PredicateManager], told: PredicatePublisher
) -> list[PredicateSubscriber]:
    """Return the subscribers to other agents' predicates and events, one for each manager and agent."""
    found = []
    for number, manager in enumerate(managers):
        for name in manager.declared.used:
            agent, slash, _ = name.partition("/")
            if slash and manager.declared.knows(name) == "predicate" and name not in manager.declared.names:
                team.check_agent(agent, key=f"predicates.{name}")
        for agent, names in wanted(manager, team.names).items():
            found.append(
                PredicateSubscriber(link, agent, manager, names, told, name=f"{agent} for {manager.name} {number}")
            )
    return found


def _by_name(ensembles: Iterable[Ensemble]) -> dict[str, Ensemble]:
    found: dict[str, Ensemble] = {}
    for ensemble in ensembles:
        if not isinstance(ensemble, Ensemble):
            raise ConfigError(f"a member of a team has ensembles, not {ensemble!r}", key="ensembles")
        if ensemble.name in found:
            raise ConfigError(f"two ensembles are called {ensemble.name!r}", key="ensembles")
        found[ensemble.name] = ensemble
    if not found:
        raise ConfigError("a member of a team has at least one ensemble", key="ensembles")
    return found
