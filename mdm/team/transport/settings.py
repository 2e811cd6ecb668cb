"""Settings: how Zenoh is told to carry a team's messages."""

from __future__ import annotations

import ipaddress
import re
import socket
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any, Literal

from msgspec import Meta

from mdm.errors import ConfigError, Error
from mdm.options import Options
from mdm.team.transport.keys import check_expression
from mdm.team.transport.transport import Priority

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

PROTOCOLS = ("tcp", "tls", "quic", "ws", "unixsock-stream")

_ADDRESS = re.compile(r"(?P<host>\[[0-9A-Fa-f:.]+(?:%\w+)?\]|[^\[\]:/\s]+):(?P<port>[0-9]{1,5})")


def check_endpoint(endpoint: object, *, key: str | None = None, connect: bool = False) -> str:
    """Return an endpoint, such as ``tcp/192.168.0.7:7447`` or ``unixsock-stream//tmp/robot1.sock``.

    Args:
        endpoint: The value that is given as one.
        key: Its place in a configuration.
        connect: Whether others connect to it.

    Raises:
        ConfigError: If it is malformed, or nobody can connect to it though others have to.
    """
    form = "an endpoint is a protocol, a host and a port, such as tcp/192.168.0.7:7447"
    if not isinstance(endpoint, str):
        raise ConfigError(f"{form}, not {endpoint!r}", key=key)
    protocol, slash, rest = endpoint.partition("/")
    if slash and protocol == "udp":
        raise ConfigError(
            f"the endpoint {endpoint!r} would lose messages that nobody sends again, so that agents share no steps "
            f"where a few in a hundred are lost: write tcp/{rest}, or tls/ with access",
            key=key,
        )
    if not slash or protocol not in PROTOCOLS:
        raise ConfigError(f"{form}, where the protocol is one of {', '.join(PROTOCOLS)}, not {endpoint!r}", key=key)
    address = re.split(r"[?#]", rest, maxsplit=1)[0]
    if protocol == "unixsock-stream":
        if not address.startswith("/"):
            raise ConfigError(f"the endpoint {endpoint!r} needs the full path of a socket", key=key)
        return endpoint
    found = _ADDRESS.fullmatch(address)
    if found is None or not 0 < int(found["port"]) < 65536:
        raise ConfigError(f"{form} from 1 to 65535, not {endpoint!r}", key=key)
    if connect and _is_any(found["host"].strip("[]")):
        reached = endpoint.replace(found["host"], "robot1.local", 1)
        raise ConfigError(
            f"nobody can connect to {endpoint!r}, every address of a machine at once: an agent may `listen` there, and "
            f"the others `connect` to its host by name or address, such as {reached!r}",
            key=key,
        )
    return endpoint


def _is_any(host: str) -> bool:
    """Return whether a host stands for all addresses of a machine; ``0`` and ``0.0`` are ``0.0.0.0``, too."""
    with suppress(OSError, ValueError):
        found = str(socket.getaddrinfo(host, None, flags=socket.AI_NUMERICHOST)[0][4][0])
        return found.partition("%")[0] in {"0.0.0.0", "::", "::ffff:0.0.0.0"}  # noqa: S104 - it binds nothing
    return False


def address(endpoint: str) -> tuple[str, str, str]:
    """Return the parts that no other program of a machine can have: the kind of the port, the host, and the port."""
    protocol, _, rest = endpoint.partition("/")
    rest = re.split(r"[?#]", rest, maxsplit=1)[0]
    if protocol == "unixsock-stream":
        return protocol, "", rest
    host, _, port = rest.rpartition(":")
    return "udp" if protocol == "quic" else "tcp", re.sub("^localhost$", "127.0.0.1", host.lower()), port


def exposed(endpoints: Iterable[str]) -> str | None:
    """Return in words the risk of a team without certificates at its endpoints; None where it is its own machine's.

    Args:
        endpoints: Where agents listen.
    """
    found = []
    for endpoint in endpoints:
        protocol, _, rest = endpoint.partition("/")
        place = None if protocol == "unixsock-stream" else _ADDRESS.match(rest)
        host = "localhost" if place is None else place["host"].strip("[]").partition("%")[0]
        with suppress(ValueError):
            if ipaddress.ip_address(host).is_loopback:
                continue
        if host != "localhost":
            found.append(endpoint)
    if not found:
        return None
    return (
        f"whoever reaches {', '.join(found)} can speak as any agent of the team, and move its robots: give the team "
        "certificates (`access`), or let nobody else into the network"
    )


def resolve(endpoint: str) -> None:
    """Look a host up, which may take seconds.

    Raises:
        Error: If nobody knows it.
    """
    protocol, _, rest = endpoint.partition("/")
    found = _ADDRESS.match(rest)
    if protocol == "unixsock-stream" or found is None:
        return
    try:
        socket.getaddrinfo(found["host"].strip("[]"), int(found["port"]))
    except OSError:
        raise Error(
            f"no host {found['host']!r} is known, of the endpoint {endpoint}: correct it, or give the host's address"
        ) from None


def settings(
    *,
    listen: Sequence[str],
    connect: Sequence[str],
    lease: float,
    largest: int,
    mode: Literal["peer", "client"] = "peer",
) -> dict[str, Any]:
    """Return the configuration of a Zenoh session: explicit endpoints, and nobody else looked for or let in.

    Args:
        listen: Endpoints at which this agent is reached.
        connect: Endpoints of others.
        lease: After so many seconds of silence this agent is taken for lost.
        largest: The largest message in bytes.
        mode: ``client`` where it connects to a router alone.
    """
    # Microseconds that a put may wait for room, ten times as many where it is cut into parts: the event loop waits.
    longest_wait = 100
    # A peer that hangs while a connection is opened holds the end of the session for so many milliseconds.
    longest_opening = max(round(2000 * lease), 2000)
    sizes = ("control", "real_time", "interactive_high", "interactive_low", "data_high", "data", "data_low")
    return {
        "mode": mode,
        "listen": {"endpoints": list(listen)},
        "connect": {
            "endpoints": list(connect),
            **({"timeout_ms": 1000} if mode == "client" else {}),  # within which it opens, or not at all
            "retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2},
        },
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {
            "unicast": {"open_timeout": longest_opening, "accept_timeout": longest_opening},
            "shared_memory": {"enabled": False},
            "link": {
                "tx": {
                    "lease": max(round(lease * 1000), 1),
                    "queue": {
                        "size": dict.fromkeys((*sizes, "background"), 16),
                        "congestion_control": {
                            "drop": {
                                "wait_before_drop": longest_wait,
                                "max_wait_before_drop_fragments": 10 * longest_wait,
                            },
                            "block": {"wait_before_close": round(lease * 1e6)},
                        },
                    },
                },
                "rx": {"max_message_size": int(max(16 * largest, 64 << 20))},
            },
        },
    }


_PRIORITIES = {"step": "real_time", "value": "data", "bulk": "background"}


class Ceiling(Options, frozen=True):
    """A ceiling on the messages under the keys of an expression, which Zenoh keeps for each link from its opening on.

    A limit that depends on the network, or counts bytes a second, is an agent's `Allowance`.

    Args:
        keys: An expression, such as ``mdm/rescue/*/patrol/belief``.
        rate: Messages a second at most; those between are dropped, and their receivers count them as ``missing``.
        size: Bytes of a message at most, with its envelope; larger ones are dropped.
        priority: How urgent they are, in place of their own priority.
    """

    keys: str
    rate: Annotated[float, Meta(gt=0, le=1e9, extra={"unit": "messages a second"})] | None = None
    size: Annotated[int, Meta(gt=0, extra={"unit": "bytes"})] | None = None
    priority: Priority | None = None


def ceiling_settings(ceilings: Sequence[Ceiling]) -> dict[str, Any]:
    """Return Zenoh's settings for ceilings, which count for the messages of this agent.

    Raises:
        ConfigError: If a ceiling is none, or its keys are malformed.
    """
    for place, ceiling in enumerate(ceilings):
        _check(ceiling, f"ceilings[{place}]")
    return {
        "downsampling": [
            {
                "id": f"rate {place}",
                "flows": ["egress"],
                "messages": ["put"],
                "rules": [{"key_expr": ceiling.keys, "freq": float(ceiling.rate)}],
            }
            for place, ceiling in enumerate(ceilings)
            if ceiling.rate is not None
        ],
        "low_pass_filter": [
            {
                "id": f"size {place}",
                "flows": ["egress"],
                "messages": ["put"],
                "key_exprs": [ceiling.keys],
                "size_limit": int(ceiling.size),
            }
            for place, ceiling in enumerate(ceilings)
            if ceiling.size is not None
        ],
        "qos": {
            "publication": [
                {"key_exprs": [ceiling.keys], "config": {"priority": _PRIORITIES[ceiling.priority]}}
                for ceiling in ceilings
                if ceiling.priority is not None
            ]
        },
    }


def _check(ceiling: Ceiling, key: str) -> None:
    try:
        check_expression(ceiling.keys)
    except Error as error:
        raise ConfigError(str(error), key=f"{key}.keys") from None
    if ceiling.rate is None and ceiling.size is None and ceiling.priority is None:
        raise ConfigError("a ceiling has a rate, a size or a priority", key=key)
