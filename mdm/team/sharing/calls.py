"""Calls: requests of other programs to an agent's ensembles: start, stop, status.

Each call is a question under the key ``mdm/<team>/<agent>/<ensemble>/<call>``, and its answer one object of JSON, which
has either ``result`` or ``error``.
"""

from __future__ import annotations

import asyncio
import os
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING, Any, cast

import msgspec
import numpy as np

from mdm.errors import Error
from mdm.runtime import Actor, Subscription
from mdm.runtime.statistics import Histogram
from mdm.runtime.supervision import describe
from mdm.stimuli import Commanded
from mdm.team.transport.bounds import UNREADABLE
from mdm.team.transport.keys import join

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Collection, Mapping
    from typing import Literal

    from mdm.actors import Ensemble
    from mdm.team.layer import TeamLayer
    from mdm.team.link import Clocks, Link
    from mdm.team.team import Team
    from mdm.team.transport.access import Access, Validity
    from mdm.team.transport.session import Session
    from mdm.team.transport.transport import Transport

COMMANDS = ("start", "stop", "reset", "release")
"""Calls that do something: the first three at all agents of a team, whichever was asked; a release at the one asked.

Their body is the command's token, the same for all agents that are asked for the same, or empty.
"""

CALLS = (*COMMANDS, "status", "statistics", "wiring", "versions")
"""All calls."""


_LONGEST_TOKEN = 64


class Answers(Actor):
    """Answers the calls of one agent's ensembles.

    Args:
        link: The connection of this agent to the others.
        ensembles: The ensembles by name.
        layers: The team's layer of each of them.
        clocks: How far the clocks of others are ahead.
        validity: For how long the agent's certificates are valid, where it has any.
    """

    def __init__(
        self,
        link: Link,
        ensembles: Mapping[str, Ensemble],
        layers: Mapping[str, TeamLayer],
        clocks: Clocks,
        validity: Validity | None = None,
        *,
        name: str = "calls",
    ) -> None:
        super().__init__(name)
        self._link = link
        self._ensembles = dict(ensembles)
        self._layers = dict(layers)
        self._clocks = clocks
        self._validity = validity
        for ensemble in self._ensembles:
            for call in CALLS:
                link.transport.serve(link.key(ensemble, call), self._answering(ensemble, call))

    def _answering(self, name: str, call: str) -> Callable[[bytes], bytes]:
        function = getattr(self, f"_{call}", None)

        def answer(body: bytes) -> bytes:
            try:
                result = self._command(name, call, _token(body)) if function is None else function(name)
                return _encode({"result": result})
            except Exception as error:  # whoever asks is told; the team goes on
                return _encode({"error": describe(error)})

        return answer

    def _command(self, name: str, call: str, token: str | None) -> str:
        if self.life != "running":
            raise Error(f"agent {self._link.agent!r} is {self.life}")
        if call in {"start", "reset"} and getattr(self._layers[name].statistics(), "role", "") == "refused":
            raise Error(f"agent {self._link.agent!r} takes no part in the team, which refused it when it joined")
        ensemble, layer = self._ensembles[name], self._layers[name]
        if call == "release" or ensemble.life != "running" or ensemble.failing:
            getattr(ensemble, call)()
        else:
            order = cast('Literal["start", "stop", "reset"]', call)

            def carry_out(token: str | None) -> None:
                self.runtime.observers.tell(Commanded, self.runtime.now(), name, order, token)
                layer.command(order, token)

            self.runtime.dispatcher.deliver(Subscription(None, layer, carry_out), token)
        return "done"

    def _status(self, name: str) -> dict[str, Any]:
        ensemble, layer = self._ensembles[name], self._layers[name]
        stands, now = layer.statistics(), ensemble.status()
        status: dict[str, Any] = {
            "agent": self._link.agent,
            "ensemble": name,
            "mode": now.mode,
            "causes": [f"{cause.kind}: {cause.detail}" for cause in now.causes],
            "idle": ensemble.liveness.resting,
            "waiting": [*(f"agent {agent}" for agent in layer.awaited), *now.waiting],
            "action": None if now.action is None else ensemble.controller.symbols.action_name(now.action),
            "epoch": ensemble.controller.epoch,
            "live": list(self._link.live),
            "unmet": [agent for agent in layer.team.names if layer.unmet and agent not in self._link.live],
            "doubles": self._link.doubles,
            "clocks": msgspec.to_builtins(self._clocks.offsets),
            "held": layer.holds,
            "stopped": None if now.mode != "stopped" or layer.stopped is None else str(layer.stopped),
            "unkept": None if layer.storage is None else layer.storage.unkept,
            "knows": layer.knows,
            "commands": layer.commands.outcomes,
            "certificate": None if self._validity is None else round(self._validity.days, 3),
        }
        for key in ("role", "leader", "term", "step", "digest", "members"):
            if hasattr(stands, key):
                status[key] = getattr(stands, key)
        return status

    def _statistics(self, name: str) -> dict[str, Any]:
        ensemble, layer = self._ensembles[name], self._layers[name]
        parts = {"ensemble": ensemble.statistics(), **ensemble.layer_statistics(), "team": layer.statistics()}
        found = {part: msgspec.structs.asdict(parts[part]) for part in ("ensemble", "control", "action", "team")}
        return {**found, "transport": msgspec.structs.asdict(self._link.transport.statistics())}

    def _wiring(self, name: str) -> dict[str, Any]:
        ensemble, ownership = self._ensembles[name], self._layers[name].ownership
        wires = [
            wire for layer in (ensemble.state, ensemble.observation) if layer is not None for wire in layer.wires()
        ]
        return {
            "factors": dict(zip(ownership.names, ownership.owners, strict=True)),
            "symbols": [wire._asdict() for wire in wires],
            "actions": list(ensemble.action.names),
        }

    def _versions(self, name: str) -> dict[str, str]:
        return self._layers[name].copy.facts


def _token(body: bytes) -> str | None:
    """Return a command's token, if it has one."""
    return body.decode() if 0 < len(body) <= _LONGEST_TOKEN and body.isalnum() else None


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    return repr(value)


_encode = msgspec.json.Encoder(enc_hook=_plain).encode


class _Clock(msgspec.Struct):
    seconds: float


class _Status(msgspec.Struct):
    """The fields of a status that a program relies on."""

    ensemble: str
    mode: str
    causes: list[str]
    live: list[str]
    held: bool = False
    stopped: str | None = None
    unkept: str | None = None
    unmet: list[str] = []
    doubles: dict[str, str] = {}
    certificate: float | None = None
    clocks: dict[str, _Clock] = {}
    commands: dict[str, str] = {}


class _Traffic(msgspec.Struct):
    messages: int
    bytes: int


class _Carried(msgspec.Struct):
    lateness: Histogram
    sent: dict[str, _Traffic]
    received: dict[str, _Traffic]
    dropped: dict[str, int]


class _Statistics(msgspec.Struct):
    """The fields of statistics that a program relies on."""

    transport: _Carried


_SHAPES: dict[str, Any] = {"status": _Status, "statistics": _Statistics}


async def ask(
    transport: Transport,
    team: Team,
    call: str,
    *,
    agent: str = "*",
    ensemble: str = "*",
    seconds: float = 1.0,
    body: bytes = b"",
) -> dict[str, Any]:
    """Ask agents of a team, and return the answer of each.

    Args:
        transport: A transport of the asker's, open; its agent is none of the team's, or one of them.
        team: The team.
        call: One of `CALLS`.
        agent: Who is asked; by default all.
        ensemble: Of which ensemble; by default the only one.
        seconds: How long to wait.
        body: The argument of the request: of commands, the token.

    Returns:
        By agent, the result, or an `Error` with its sentence; agents that do not answer are left out.

    Raises:
        Error: If there is no such call or agent.
    """
    if call not in CALLS:
        raise Error(f"there is no call {call!r}; there are {', '.join(CALLS)}")
    if agent != "*":
        team.check_agent(agent)
    answers = await transport.ask(join(team.name, agent, ensemble, call), body, timeout=seconds)
    found: dict[str, Any] = {}
    for who in team.names:
        if who in answers:
            try:
                answer = msgspec.json.decode(answers[who])
                found[who] = answer["result"] if "result" in answer else Error(str(answer["error"]))
                if "result" in answer and call in _SHAPES:
                    msgspec.convert(answer["result"], _SHAPES[call])
            except (*UNREADABLE, TypeError, KeyError):
                found[who] = Error(f"agent {who!r} answers in another form: {answers[who][:40]!r}")
    return found


_FIRST, _REST = 0.8, 0.4
_OPENING = 3.0
"""Seconds for which a router is waited for."""


@asynccontextmanager
async def asking(
    team: Team, access: Access | None = None, who: str = ""
) -> AsyncIterator[tuple[Session, Collection[str]]]:
    """Yield a session, none of the team's, that asks its agents, and those that were there within about a second.

    Args:
        team: The team.
        access: The certificates of the team's operator, where its agents have any; or of an agent.
        who: That agent.
    """
    from mdm.team.transport.access import OPERATOR, access_settings  # noqa: PLC0415 - nobody asks in most processes
    from mdm.team.transport.session import Session  # noqa: PLC0415 - the one that needs Zenoh

    configuration: dict[str, Any] = {}
    if access is not None:
        routed = team.router is not None
        configuration = access_settings(access, team.name, who or OPERATOR, team.names, routed=routed)
    # An agent that hangs holds the end of the session for so many milliseconds; and who is there is waited for here.
    configuration.setdefault("transport", {})["unicast"] = {"open_timeout": 700}
    configuration["open"] = {"return_conditions": {"connect_scouted": False, "declares": False}}
    session = Session(
        team.name,
        f"asker-{os.getpid()}",
        **team.addresses(protocol="tcp" if access is None else "tls"),
        lease=team.lease,
        configuration=configuration,
    )
    try:
        yield session, await _meet(session, team)
    finally:
        await session.close()


async def _meet(session: Session, team: Team) -> Collection[str]:
    """Open a session; return the agents that were there within about a second."""
    live: set[str] = set()
    complete = asyncio.Event()

    def see(seen: Mapping[str, int]) -> None:
        live.clear()
        live.update(name for name in team.names if name in seen)
        if len(live) == len(team.names):
            complete.set()

    session.watch(see)
    try:
        async with asyncio.timeout(None if team.router is None else _OPENING):
            await session.open()
    except TimeoutError:
        raise Error(f"no router answers at {team.router}: start it, or correct the team's `router`") from None
    for seconds in (_FIRST, _REST):
        with suppress(TimeoutError):
            await asyncio.wait_for(complete.wait(), seconds)
        if not live:
            break
    return live
