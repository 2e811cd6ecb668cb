"""Settings: how Zenoh is told to carry a team's messages."""

from __future__ import annotations

import ipaddress
import re
import socket
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Literal

from mdm.errors import ConfigError, Error

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

__all__ = ["PROTOCOLS", "address", "check_endpoint", "exposed", "resolve", "settings"]

PROTOCOLS = ("tcp", "tls", "quic", "ws", "unixsock-stream")

_ADDRESS = re.compile(r"(?P<host>\[[0-9A-Fa-f:.]+(?:%\w+)?\]|[^\[\]:/\s]+):(?P<port>[0-9]{1,5})")


def check_endpoint(endpoint: object, *, key: str | None = None, connect: bool = False) -> str:
    """Return an endpoint, such as ``tcp/192.168.0.7:7447`` or ``unixsock-stream//tmp/robot1.sock``.

    Args:
        endpoint: What is given as one.
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
    """Return what only one program of a machine can have: the kind of an endpoint's port, its host, and the port."""
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
    found = [endpoint for endpoint in endpoints if not _is_local(endpoint)]
    if not found:
        return None
    return (
        f"whoever reaches {', '.join(found)} can speak as any agent of the team, and move its robots: give the team "
        "certificates (`access`), or let nobody else into the network"
    )


def _is_local(endpoint: str) -> bool:
    """Return whether an endpoint is reached from its own machine alone."""
    protocol, _, rest = endpoint.partition("/")
    found = _ADDRESS.match(rest)
    if protocol == "unixsock-stream" or found is None:
        return True
    host = found["host"].strip("[]").partition("%")[0]
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


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
