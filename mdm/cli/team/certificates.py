"""``mdm team certificates``: certificates to try a team with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.cli.usage import count

if TYPE_CHECKING:
    import argparse

__all__ = ["add_parser", "run"]


def add_parser(verbs: Any, name: str) -> argparse.ArgumentParser:
    """Add the verb and its arguments."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        name,
        help="make certificates to try a team with",
        description=(
            "Write the certificate of an authority, and a certificate and key for each agent of a team, and for the "
            "operator, as whom `mdm team status` asks. They are for trying; needs mdm[certificates]."
        ),
        epilog="example: mdm team certificates examples/team/meeting.toml -o certificates",
    )
    parser.add_argument("file", metavar="FILE", help="the TOML file")
    parser.add_argument("-o", "--output", metavar="FOLDER", default="certificates", help="where to (certificates)")
    parser.add_argument("--days", metavar="N", type=count, default=30, help="how long they are valid (30)")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Write the certificates; return the exit status."""
    from mdm.cli.team.file import team_of  # noqa: PLC0415 - `mdm --help` needs no numpy
    from mdm.team.transport.access import OPERATOR  # noqa: PLC0415
    from mdm.team.transport.certificates import make_certificates  # noqa: PLC0415

    team = team_of(arguments.file)
    hosts = {agent.name: [_host(agent.endpoint or "")] for agent in team.agents}
    hosts.setdefault(OPERATOR, [])
    made = make_certificates(arguments.output, hosts, days=arguments.days)
    print(f"{arguments.output}: certificates of an authority and {', '.join(made)}, valid for {arguments.days} days")
    return 0


def _host(endpoint: str) -> str:
    """Return the host of an endpoint such as ``tls/robot1.local:7447``."""
    return endpoint.partition("/")[2].rpartition(":")[0].strip("[]")
