"""``mdm team``: run a team, and ask for its status: its verbs and their arguments."""

from __future__ import annotations

from mdm.cli.robots import RUN, VIRTUAL
from mdm.cli.usage import IMPORT, JSON, Argument, Verb, count, live_page, seconds

__all__ = ["VERBS"]

_FILE = Argument("file FILE", "the TOML file")
_FRESH = Argument("--fresh", "forget that agents were stopped, or wait for a release, before they start")


def _command(name: str, line: str, about: str) -> Verb:
    """Return a command to a running team."""
    return Verb(
        f"{about} It is said to every agent of the file, and waits until each says what it is by then. The exit status "
        "is 1 if an agent did not confirm.",
        f"mdm team {name} examples/team/meeting.toml",
        (
            _FILE,
            Argument("--ensemble NAME", "this ensemble of the team alone"),
            Argument("--wait SECONDS", "how long to wait (default: 5)", seconds, default=5.0),
        ),
        "team.status:command",
        line=line,
    )


_VERBS = {
    "up": Verb(
        "Run all agents of a team on this machine, a process each, until Ctrl-C, SIGTERM or --seconds. A process "
        "that fails is started again, five times within a minute at most; one that cannot start, or that a signal "
        "such as SIGTERM has ended in order, is not, and the others go on without it once more than half of a team "
        "have met. The exit status is 1 if any agent has failed.",
        "mdm team up examples/team/meeting.toml --seconds 20 --decisions decided",
        (
            _FILE,
            Argument("--seconds N", "end in order after N seconds", seconds),
            Argument("--decisions FOLDER", "write each agent's joint steps to a file of its own in this folder"),
            Argument("--record FOLDER", "record each agent's run to a file of its own in this folder, NAME.mcap"),
            _FRESH,
            *live_page("show all agents live on one page", "where the team has access, that of its operator"),
            Argument("--log {console,json}", "how to write the log", choices=("console", "json"), default="console"),
        ),
        "team.up",
        line="run all agents on this machine",
    ),
    "run": Verb(
        "Run one agent of a team until Ctrl-C, SIGTERM, --seconds, or --epochs of its decisions.",
        "mdm team run examples/team/meeting.toml --agent ada",
        (*(each for each in RUN if each is not VIRTUAL), _FRESH),
        "team.up:run_agent",
        settings={"virtual": False},
        line="run one agent in this process",
    ),
    "status": Verb(
        "Ask every agent of a running team for its mode, for how long it has had nothing to do, where it stands in "
        "the agreement, how late messages reach it (the median, and the worst), by how much the clock that is most "
        "off is ahead of its own, how many messages it dropped, and whom it sees. Times of more than a day are not "
        "shown: a message told them that was forged, or a clock is set wrong (null with --json). Of a team with "
        "certificates it says for how many days each is valid, and warns below seven. The exit status is 1 if an "
        "agent does not answer, is refused or safe, or does not see another one that answers.",
        "mdm team status examples/team/meeting.toml",
        (_FILE, JSON),
        "team.status",
        line="how every agent is",
    ),
    "start": _command(
        "start",
        "have a running team begin to decide",
        "Have a running team begin to decide: from the initial belief, in a new episode.",
    ),
    "stop": _command(
        "stop",
        "have a running team decide no more",
        "Have a running team decide no more and end its actions; the processes go on.",
    ),
    "reset": _command(
        "reset", "have a running team begin a new episode", "Have a running team begin a new episode now."
    ),
    "release": _command(
        "release",
        "have a running team leave its safe mode",
        "Take a person's word that nothing holds any more that made agents safe.",
    ),
    "check": Verb(
        "List everything that `mdm team run` would refuse, at every agent. Functions are looked for in the source "
        "of their modules, which are not run, unless --import is given. It notes what other files of the team in "
        "the same folder differ in, and certificates that end within seven days.",
        "mdm team check examples/team/meeting.toml",
        (_FILE, IMPORT, JSON),
        "team.check",
        line="list everything that keeps an agent from running",
    ),
    "decisions": Verb(
        "Read the files that --decisions has made, and say whether all agents have decided the same, and what was "
        "the longest time without a decision of any of them. The exit status is 1 if a step differs. Agents of a "
        "communicating team decide by themselves, and so their steps may.",
        "mdm team decisions decided/",
        (Argument("paths PATH...", "a file of decisions, or a folder of such files"), JSON),
        "team.decisions",
        line="compare files of decisions",
    ),
    "certificates": Verb(
        "Write the certificate of an authority, and a certificate and key for each agent of a team, and for the "
        "operator, as whom `mdm team status` asks, and the team's router, if it has one. In a folder that has an "
        "authority it signs for those who have none yet. They are for trying; needs cryptography.",
        "mdm team certificates examples/team/meeting.toml -o certificates",
        (
            _FILE,
            Argument("-o --output FOLDER", "where to (certificates)", default="certificates"),
            Argument("--days N", "how long they are valid (30)", count, default=30),
            Argument(
                "--host NAME",
                "a name or address in the operator's certificate, for the page of `mdm team up`; can be given again",
                action="append",
                default=[],
            ),
        ),
        "team.file:certificates",
        line="make certificates to try a team with",
    ),
}

VERBS = {
    "team": Verb(
        "Run the agents of a team's TOML file, one process per agent, and ask them how they are.",
        "mdm team up examples/team/meeting.toml --seconds 20",
        chosen=("team_verb", "VERB"),
        verbs=_VERBS,
    )
}
