"""``mdm team certificates``: certificates to try a team with."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mdm.cli.team.file import team_of
from mdm.team.transport.access import OPERATOR, ROUTER, access_of
from mdm.team.transport.certificates import make_certificates

if TYPE_CHECKING:
    import argparse

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Write the certificates; return the exit status."""
    team = team_of(arguments.file)
    hosts = {agent.name: [] if agent.reached is None else [_host(agent.reached)] for agent in team.agents}
    if team.router is not None:
        hosts[ROUTER] = [_host(team.router)]
    hosts.setdefault(OPERATOR, []).extend(arguments.host)
    kept = [name for name in hosts if Path(access_of(Path(arguments.output), name).certificate).exists()]
    made = [name for name in make_certificates(arguments.output, hosts, days=arguments.days) if name not in kept]
    print(f"{arguments.output}: certificates of an authority and {', '.join(made)}, valid for {arguments.days} days")
    if kept:
        print(f"{arguments.output}: those of {', '.join(kept)} stay as they are")
    return 0


def _host(endpoint: str) -> str:
    """Return the host of an endpoint such as ``tls/robot1.local:7447``."""
    return endpoint.partition("/")[2].rpartition(":")[0].strip("[]")
