"""The arguments of the verbs that run robots."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.cli.usage import (
    add_discount,
    add_false_negative,
    add_file,
    add_live_page,
    add_verb,
    complete,
    count,
    seconds,
    seed,
)

if TYPE_CHECKING:
    import argparse


def add_run(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "Run the ensembles of a TOML file, of a team's file those of one agent, until Ctrl-C, SIGTERM, --seconds, or "
        "--epochs decisions of the first one. SIGUSR1 releases those that are safe: kill -USR1 PID. The exit status is "
        "1 if something failed that nobody could help, or if of a robot alone every action has failed."
    )
    parser = add_verb(verbs, "run", line, about, "mdm run examples/patrol/patrol.toml --virtual --epochs 20")
    add_arguments(parser)
    complete(parser, "run", "mdm.cli.robots.run")


def add_arguments(parser: argparse.ArgumentParser, *, virtual: bool = True) -> None:
    """Add the verb's arguments; without ``virtual`` time is real."""
    parser.add_argument("file", metavar="FILE", help="the TOML file")
    parser.add_argument("--agent", metavar="NAME", help="of a team's file, which agent this process is")
    parser.add_argument(
        "--decisions",
        metavar="PATH",
        help="add each decision, of a team each joint step, to this file as a line of JSON",
    )
    parser.add_argument(
        "--record",
        metavar="PATH",
        help="record the run to this file, such as run.mcap, which mdm replay runs again; a record there is kept, and "
        "run.2.mcap written",
    )
    add_live_page(parser, "show the run live on a page", "of a team's file the agent's own")
    parser.add_argument("--quiet", action="store_true", help="write no log")
    if virtual:
        parser.add_argument(
            "--virtual", action="store_true", help="in virtual time: without waiting, until nothing is pending"
        )
    else:
        parser.set_defaults(virtual=False)
    parser.add_argument("--epochs", metavar="N", type=count, help="stop after N decisions of the first ensemble")
    parser.add_argument("--seconds", metavar="N", type=seconds, help="stop after N seconds")
    parser.add_argument(
        "--attached", action="store_true", help="stop when standard input ends, as agents do when `mdm team up` ends"
    )
    parser.add_argument(
        "--why",
        action="store_true",
        help="write why with each decision that is logged; that takes some milliseconds each, beside the decisions",
    )
    parser.add_argument("--log", choices=("console", "json"), default="console", help="how to write the log")


def add_trace(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "Read JSON lines from standard input, one stimulus a line, and print one JSON line a decision. A stimulus "
        'has any of "time" (seconds), "observation", "state", "belief", "predicates" ({"name": true}, or a number '
        'for a threshold), "events" (["name"]) and "control" ("start", "stop", "reset", "release"). Async '
        'functions of the file stand for actions that take time: they end by an event such as "Go.succeeded" or '
        '"Go.failed", and not by themselves.'
    )
    parser = add_verb(verbs, "trace", line, about, "echo '{\"observation\": 0}' | mdm trace tiger.pomdp tiger.vf")
    add_file(parser, "the TOML file, whose functions are not called")
    parser.add_argument("--drive", metavar="event|RATE", help="decide on events (default), or RATE times a second")
    add_discount(parser)
    add_false_negative(parser)
    parser.add_argument("--horizon", metavar="H", type=count, help="decisions in an episode")
    parser.add_argument(
        "--on-impossible",
        choices=("predict", "keep", "reset"),
        help="reaction to an observation of probability 0 (predict)",
    )
    parser.add_argument(
        "--on-no-observation",
        metavar="predict|repeat|NAME",
        help="meaning of a tick without an observation (predict)",
    )
    parser.add_argument("--seed", metavar="S", type=seed, help="for a stochastic policy")
    complete(parser, "trace", "mdm.cli.robots.trace")
