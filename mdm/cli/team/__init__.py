"""``mdm team``: run a team, and ask for its status: its verbs and their arguments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.cli.robots import add_arguments
from mdm.cli.usage import add_import, add_live_page, add_verb, complete, count, seconds

if TYPE_CHECKING:
    import argparse

__all__ = ["VERBS", "add_team"]

VERBS = {
    "up": "run all agents on this machine",
    "run": "run one agent in this process",
    "status": "how every agent is",
    "start": "have a running team begin to decide",
    "stop": "have a running team decide no more",
    "reset": "have a running team begin a new episode",
    "release": "have a running team leave its safe mode",
    "check": "list everything that keeps an agent from running",
    "decisions": "compare files of decisions",
    "certificates": "make certificates to try a team with",
}
"""The verbs, and a line of help for each."""

_COMMANDS = {
    "start": "Have a running team begin to decide: from the initial belief, in a new episode.",
    "stop": "Have a running team decide no more and end its actions; the processes go on.",
    "reset": "Have a running team begin a new episode now.",
    "release": "Take a person's word that nothing holds any more that made agents safe.",
}


def add_team(verbs: Any, line: str) -> None:
    """Add the verb, its own verbs and their arguments."""
    about = "Run the agents of a team's TOML file, one process per agent, and ask them how they are."
    parser = add_verb(verbs, "team", line, about, "mdm team up examples/team/meeting.toml --seconds 20")
    kinds = parser.add_subparsers(dest="team_verb", metavar="VERB", required=True)
    own = {
        "up": _add_up,
        "run": _add_run,
        "status": _add_status,
        "check": _add_check,
        "decisions": _add_decisions,
        "certificates": _add_certificates,
    }
    for name in VERBS:
        module = "agent" if name == "run" else "commands" if name in _COMMANDS else name
        complete(own.get(name, _add_command)(kinds, name), f"team {name}", f"mdm.cli.team.{module}")


def _add_up(verbs: Any, name: str) -> argparse.ArgumentParser:
    about = (
        "Run all agents of a team on this machine, a process each, until Ctrl-C, SIGTERM or --seconds. A process that "
        "fails is started again, five times within a minute at most; one that cannot start, or that a signal such as "
        "SIGTERM has ended in order, is not, and the others go on without it once more than half of a team have met. "
        "The exit status is 1 if any agent has failed."
    )
    parser = add_verb(
        verbs, name, VERBS[name], about, "mdm team up examples/team/meeting.toml --seconds 20 --decisions decided"
    )
    parser.add_argument("file", metavar="FILE", help="the TOML file")
    parser.add_argument("--seconds", metavar="N", type=seconds, help="end in order after N seconds")
    parser.add_argument(
        "--decisions", metavar="FOLDER", help="write each agent's joint steps to a file of its own in this folder"
    )
    parser.add_argument(
        "--record", metavar="FOLDER", help="record each agent's run to a file of its own in this folder, NAME.mcap"
    )
    _add_fresh(parser)
    add_live_page(parser, "show all agents live on one page", "where the team has access, that of its operator")
    parser.add_argument("--log", choices=("console", "json"), default="console", help="how to write the log")
    return parser


def _add_run(verbs: Any, name: str) -> argparse.ArgumentParser:
    about = "Run one agent of a team until Ctrl-C, SIGTERM, --seconds, or --epochs of its decisions."
    parser = add_verb(verbs, name, VERBS[name], about, "mdm team run examples/team/meeting.toml --agent ada")
    add_arguments(parser, virtual=False)
    _add_fresh(parser)
    return parser


def _add_fresh(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--fresh", action="store_true", help="forget that agents were stopped, or wait for a release, before they start"
    )


def _add_status(verbs: Any, name: str) -> argparse.ArgumentParser:
    about = (
        "Ask every agent of a running team for its mode, for how long it has had nothing to do, where it stands in the "
        "agreement, how late messages reach it (the median, and the worst), by how much the clock that is most off is "
        "ahead of its own, how many messages it dropped, and whom it sees. Times of more than a day are not shown: a "
        "message told them that was forged, or a clock is set wrong (null with --json). Of a team with certificates it "
        "says for how many days each is valid, and warns below seven. The exit status is 1 if an agent does not "
        "answer, is refused or safe, or does not see another one that answers."
    )
    parser = add_verb(verbs, name, VERBS[name], about, "mdm team status examples/team/meeting.toml")
    parser.add_argument("file", metavar="FILE", help="the TOML file")
    parser.add_argument("--json", action="store_true", help="one JSON object")
    return parser


def _add_command(verbs: Any, name: str) -> argparse.ArgumentParser:
    about = (
        f"{_COMMANDS[name]} It is said to every agent of the file, and waits until each says what it is by then. "
        "The exit status is 1 if an agent did not confirm."
    )
    parser = add_verb(verbs, name, VERBS[name], about, f"mdm team {name} examples/team/meeting.toml")
    parser.add_argument("file", metavar="FILE", help="the TOML file")
    parser.add_argument("--ensemble", metavar="NAME", help="this ensemble of the team alone")
    parser.add_argument("--wait", type=seconds, default=5.0, metavar="SECONDS", help="how long to wait (default: 5)")
    return parser


def _add_check(verbs: Any, name: str) -> argparse.ArgumentParser:
    about = (
        "List everything that `mdm team run` would refuse, at every agent. Functions are looked for in the source of "
        "their modules, which are not run, unless --import is given. It notes what other files of the team in the same "
        "folder differ in, and certificates that end within seven days."
    )
    parser = add_verb(verbs, name, VERBS[name], about, "mdm team check examples/team/meeting.toml")
    parser.add_argument("file", metavar="FILE", help="the TOML file")
    add_import(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object")
    return parser


def _add_decisions(verbs: Any, name: str) -> argparse.ArgumentParser:
    about = (
        "Read the files that --decisions has made, and say whether all agents have decided the same, and what was the "
        "longest time without a decision of any of them. The exit status is 1 if a step differs. Agents of a "
        "communicating team decide by themselves, and so their steps may."
    )
    parser = add_verb(verbs, name, VERBS[name], about, "mdm team decisions decided/")
    parser.add_argument("paths", metavar="PATH", nargs="+", help="a file of decisions, or a folder of such files")
    parser.add_argument("--json", action="store_true", help="one JSON object")
    return parser


def _add_certificates(verbs: Any, name: str) -> argparse.ArgumentParser:
    about = (
        "Write the certificate of an authority, and a certificate and key for each agent of a team, and for the "
        "operator, as whom `mdm team status` asks, and the team's router, if it has one. In a folder that has an "
        "authority it signs for those who have none yet. They are for trying; needs mdm[certificates]."
    )
    parser = add_verb(
        verbs, name, VERBS[name], about, "mdm team certificates examples/team/meeting.toml -o certificates"
    )
    parser.add_argument("file", metavar="FILE", help="the TOML file")
    parser.add_argument("-o", "--output", metavar="FOLDER", default="certificates", help="where to (certificates)")
    parser.add_argument("--days", metavar="N", type=count, default=30, help="how long they are valid (30)")
    parser.add_argument(
        "--host",
        metavar="NAME",
        action="append",
        default=[],
        help="a name or address in the operator's certificate, for the page of `mdm team up`; can be given again",
    )
    return parser
