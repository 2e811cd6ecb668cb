"""The verbs of records, and their arguments: ``mdm record``, ``mdm replay``, ``mdm statistics``, ``mdm page``."""

from __future__ import annotations

import argparse
from typing import Any

from mdm.cli.usage import (
    LATEST,
    add_discount,
    add_discount_of,
    add_page_hosts,
    add_verb,
    complete,
    count,
    finite,
    moment,
    port,
    seconds,
    seed,
)

__all__ = ["VERBS", "add_explain", "add_page", "add_record", "add_replay", "add_statistics", "add_watch"]

VERBS = {
    "info": "what is in a record",
    "cat": "print the messages of a record, a line of JSON each",
    "export": "write the decisions of a record as a table",
    "repair": "write what is left of a torn record as a complete one",
}
"""The verbs, and a line of help for each."""


def add_record(verbs: Any, line: str) -> None:
    """Add the verb, its own verbs and their arguments."""
    about = "Look into the record of a run, an MCAP file, which Foxglove and other programs open, too."
    parser = add_verb(verbs, "record", line, about, "mdm record info run.mcap")
    kinds = parser.add_subparsers(dest="record_verb", metavar="VERB", required=True)
    for name, add in {"info": _add_info, "cat": _add_cat, "export": _add_export, "repair": _add_repair}.items():
        complete(add(kinds, name), f"record {name}", f"mdm.cli.records.{name}")


def add_replay(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "Run what a record has once more, in virtual time and as fast as it goes, with the configuration in the "
        "record, and compare every decision: exactly in the same environment, else actions exactly and numbers to "
        "1e-9. The first difference is told with what led to it. No function of the configuration is called. With "
        "--config, another configuration is compared: which decisions it would have made otherwise, also each by "
        "itself, in the same state or on the same belief, as a table by state. Of a folder, each agent's record is "
        "replayed, and what it received compared with what the replays of the others sent; with --config, it tells "
        "what the team would have decided otherwise, and from when on that cannot be told. The exit status is 1 where "
        "a decision or a message differs, or something cannot be told."
    )
    parser = add_verb(verbs, "replay", line, about, "mdm replay run.mcap")
    parser.add_argument("file", metavar="FILE", help="the record, or a folder with those of a team's agents")
    parser.add_argument("--config", metavar="OTHER.toml", help="another configuration of the same ensembles")
    told = "tell at most N differences (1; with --config, of one robot, 20)"
    parser.add_argument("--most", metavar="N", type=count, help=told)
    parser.add_argument("--json", action="store_true", help="one JSON object")
    complete(parser, "replay", "mdm.cli.records.replay")


def add_page(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "Show the record of a run on a page for this machine's browsers: at any time of the run, with steps to the "
        "next decision, fault and mode. Open the address that is printed; Ctrl-C ends it. What a record does not keep, "
        "as predicates, is had from a replay, where the record has its configuration. A run that goes on is shown by "
        "mdm run FILE.toml --page."
    )
    parser = add_verb(verbs, "page", line, about, "mdm page run.mcap")
    parser.add_argument("file", metavar="FILE", help="the record")
    parser.add_argument("--port", metavar="PORT", type=port, default=8765, help="where the page is (8765)")
    add_page_hosts(parser, prefix="--")
    parser.add_argument("--no-replay", action="store_true", help="begin at once, without the values of predicates")
    complete(parser, "page", "mdm.cli.records.page")


def add_watch(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "Watch a system that runs with a page, by the address that it has printed, or the record of a run, in this "
        "terminal: the tree of ensembles, modes, live actions, predicates, beliefs as bars, and the last events. Keys: "
        "q ends, up and down choose an ensemble; of a record, space plays, left and right move, d, f and m step to the "
        "next decision, fault and mode, with shift to the one before."
    )
    parser = add_verb(verbs, "watch", line, about, "mdm watch run.mcap")
    parser.add_argument("source", metavar="URL|FILE", help="the address of a page, or a record")
    parser.add_argument("--once", action="store_true", help="print one picture, of a record its end, and stop")
    parser.add_argument("--at", metavar="S", type=moment, help="of a record, begin at second S")
    parser.add_argument(
        "--authority",
        metavar="FILE",
        help="of a page with TLS, who has signed its certificate, such as authority.pem; by default whom this machine "
        "trusts",
    )
    complete(parser, "watch", "mdm.cli.records.watch")


def add_explain(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "Say in words why a decision in a record was made: the values of all actions, by how much the chosen one was "
        "ahead, the observation that moved that most, the smallest change that would have decided otherwise, and what "
        "was expected next. The model and the policy are those in the record, or of --config: of others it is "
        "explained what they would decide. No function of the configuration is called."
    )
    parser = add_verb(verbs, "explain", line, about, "mdm explain run.mcap --at 12.5s")
    parser.add_argument("file", metavar="FILE", help="the record")
    parser.add_argument(
        "--at",
        metavar="EPOCH|TIME",
        type=_place,
        help="the decision of that number, such as 12, or the last one by a second of the record, such as 12.0 or 12s "
        "(the last one of all)",
    )
    parser.add_argument("--ensemble", metavar="PATH", help="the ensemble; by default the one that decided then")
    parser.add_argument("--last", metavar="N", type=count, help="look at the last N observations (10)")
    parser.add_argument("--config", metavar="OTHER.toml", help="a configuration of the same ensembles")
    parser.add_argument("--json", action="store_true", help="one JSON object")
    complete(parser, "explain", "mdm.cli.records.explain")


def _place(text: str) -> float:
    if text.isascii() and text.isdecimal():
        return int(text)
    moment = finite(text.removesuffix("s"))
    if moment is None or not 0 <= moment <= LATEST:
        raise argparse.ArgumentTypeError(
            f"a decision's number such as 12, or a second such as 12.0 or 12s was expected, not {text!r}"
        )
    return float(moment)


def add_statistics(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "Count what the decisions of records tell of a model, of one ensemble, over several runs: probabilities with "
        "intervals, and rows that differ from the model, by evidence and by the loss of value; rates and how long "
        "states last; where states are hidden, what is most likely, by expectation maximisation. The model estimated "
        "anew, and how long actions take, can be written, solved and evaluated."
    )
    parser = add_verb(
        verbs,
        "statistics",
        line,
        about,
        "mdm statistics run.mcap --model top.pomdpx --ensemble top -o new.npz --durations times.npz",
    )
    parser.add_argument(
        "files", metavar="FILE", nargs="+", help="the record; several are runs, or agents, that are pooled"
    )
    parser.add_argument("--model", metavar="M", required=True, help="the model that the ensemble had")
    told = "the ensemble, where several have decided: robot is each .../robot, in all records"
    parser.add_argument("--ensemble", metavar="PATH", help=told)
    parser.add_argument("-o", "--output", metavar="NEW_MODEL", help="write the model estimated anew")
    parser.add_argument(
        "--durations", metavar="OUT.npz", help="write how long actions take, for --durations of mdm solve"
    )
    parser.add_argument(
        "--step",
        metavar="S",
        type=seconds,
        help="the seconds of the model's time step: rates of changes of the state become its probabilities",
    )
    parser.add_argument("--level", metavar="P", type=_share, default=0.95, help="the level of the intervals (0.95)")
    add_discount(parser)
    add_discount_of(parser)
    parser.add_argument("--seed", metavar="N", type=seed, help="of the intervals where states are hidden (0)")
    parser.add_argument("--json", action="store_true", help="one JSON object, with all rows")
    complete(parser, "statistics", "mdm.cli.records.statistics")


def _add_info(verbs: Any, name: str) -> argparse.ArgumentParser:
    about = (
        "Describe a record: whether it is complete, its time, its topics with the numbers of their messages, the files "
        "attached to it, and its head: versions, clock, seeds. Where a run was split, its first file stands for all."
    )
    parser = add_verb(verbs, name, VERBS[name], about, "mdm record info run.mcap --json")
    parser.add_argument("file", metavar="FILE", help="the record")
    parser.add_argument("--json", action="store_true", help="one JSON object")
    return parser


def _add_cat(verbs: Any, name: str) -> argparse.ArgumentParser:
    about = (
        "Print the messages of a record in their order, a JSON object a line: topic, seconds since the record's first "
        "message, sequence number, message. With --stimuli, print what mdm trace reads instead: sensor input, states, "
        "observations, beliefs and commands, which decide as the run did where no action takes time."
    )
    parser = add_verb(
        verbs, name, VERBS[name], about, "mdm record cat run.mcap --topic decisions --since 10 --until 20"
    )
    parser.add_argument("file", metavar="FILE", help="the record")
    parser.add_argument("--topic", metavar="NAME", action="append", help="this topic alone; can be given again")
    parser.add_argument("--since", metavar="S", type=moment, help="from second S of the record on")
    parser.add_argument("--until", metavar="S", type=moment, help="before second S of the record")
    parser.add_argument("--ensemble", metavar="NAME", help="messages of this ensemble alone, and of those below it")
    parser.add_argument("--stimuli", action="store_true", help="print the stimuli, as mdm trace reads them")
    return parser


def _add_export(verbs: Any, name: str) -> argparse.ArgumentParser:
    about = (
        "Write the decisions of a record as a table: time, ensemble, epoch, cause, state, observation and action with "
        "their names, reward, the end of the action, the true state where a simulated world told it, and a column for "
        "each state of a belief. The suffix of the table's file chooses its format: .csv or .parquet (needs "
        "mdm[parquet])."
    )
    parser = add_verb(verbs, name, VERBS[name], about, "mdm record export run.mcap -o run.csv")
    parser.add_argument("file", metavar="FILE", help="the record")
    parser.add_argument("-o", "--output", metavar="TABLE", required=True, help="the table's file")
    parser.add_argument("--ensemble", metavar="NAME", help="the decisions of this ensemble alone")
    parser.add_argument("--no-beliefs", action="store_true", help="leave out the columns of beliefs")
    return parser


def _add_repair(verbs: Any, name: str) -> argparse.ArgumentParser:
    about = (
        "Write all that can be read of a record as a complete one: of a robot whose machine has failed, or of a full "
        "disk. Where a run was split, its files become one. The record itself stays as it is."
    )
    parser = add_verb(verbs, name, VERBS[name], about, "mdm record repair run.mcap -o whole.mcap")
    parser.add_argument("file", metavar="FILE", help="the record")
    parser.add_argument("-o", "--output", metavar="OUT", required=True, help="the complete record's file")
    return parser


def _share(text: str) -> float:
    number = finite(text)
    if number is None or not 0 < number < 1:
        raise argparse.ArgumentTypeError(f"a number above 0 and below 1 was expected, not {text!r}")
    return number
