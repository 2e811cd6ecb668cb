"""``mdm team certificates``: certificates to try a team with."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.cli.team.file import team_of
from mdm.team.transport.access import OPERATOR
from mdm.team.transport.certificates import make_certificates

if TYPE_CHECKING:
    import argparse

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Write the certificates; return the exit status."""
    team = team_of(arguments.file)
    hosts = {agent.name: [_host(agent.endpoint or "")] for agent in team.agents}
    hosts.setdefault(OPERATOR, []).extend(arguments.host)
    made = make_certificates(arguments.output, hosts, days=arguments.days)
    print(f"{arguments.output}: certificates of an authority and {', '.join(made)}, valid for {arguments.days} days")
    return 0


def _host(endpoint: str) -> str:
    """Return the host of an endpoint such as ``tls/robot1.local:7447``."""
    return endpoint.partition("/")[2].rpartition(":")[0].strip("[]")
