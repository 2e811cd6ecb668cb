"""The verbs of records, and their arguments: ``mdm record``, ``mdm replay``, ``mdm statistics``, ``mdm page``."""

from __future__ import annotations

import argparse

from mdm.cli.usage import (
    DISCOUNT,
    DISCOUNT_OF,
    JSON,
    LATEST,
    Argument,
    Verb,
    count,
    finite,
    moment,
    number,
    page_hosts,
    port,
    seconds,
    seed,
)

__all__ = ["VERBS"]


def _place(text: str) -> float:
    if text.isascii() and text.isdecimal():
        return int(text)
    found = finite(text.removesuffix("s"))
    if found is None or not 0 <= found <= LATEST:
        raise argparse.ArgumentTypeError(
            f"a decision's number such as 12, or a second such as 12.0 or 12s was expected, not {text!r}"
        )
    return found


_FILE = Argument("file FILE", "the record")
_CONFIG = Argument("--config OTHER.toml", "another configuration of the same ensembles")
_within = number("a number above 0 and below 1", 0, 1, apart=(0, 1))

_OF_A_RECORD = {
    "info": Verb(
        "Describe a record: whether it is complete, its time, its topics with the numbers of their messages, the "
        "files attached to it, and its head: versions, clock, seeds. Where a run was split, its first file stands "
        "for all.",
        "mdm record info run.mcap --json",
        (_FILE, JSON),
        "records.cat:info",
        line="what is in a record",
    ),
    "cat": Verb(
        "Print the messages of a record in their order, a JSON object a line: topic, seconds since the record's "
        "first message, sequence number, message. With --stimuli, print what mdm trace reads instead: sensor "
        "input, states, observations, beliefs and commands, which decide as the run did where no action takes "
        "time.",
        "mdm record cat run.mcap --topic decisions --since 10 --until 20",
        (
            _FILE,
            Argument("--topic NAME", "this topic alone; can be given again", action="append"),
            Argument("--since S", "from second S of the record on", moment),
            Argument("--until S", "before second S of the record", moment),
            Argument("--ensemble NAME", "messages of this ensemble alone, and of those below it"),
            Argument("--stimuli", "print the stimuli, as mdm trace reads them"),
        ),
        "records.cat",
        line="print the messages of a record, a line of JSON each",
    ),
    "export": Verb(
        "Write the decisions of a record as a table: time, ensemble, epoch, cause, state, observation and action "
        "with their names, reward, the end of the action, the true state where a simulated world told it, and a "
        "column for each state of a belief. The suffix of the table's file chooses its format: .csv or .parquet "
        "(needs pyarrow).",
        "mdm record export run.mcap -o run.csv",
        (
            _FILE,
            Argument("-o --output TABLE", "the table's file", required=True),
            Argument("--ensemble NAME", "the decisions of this ensemble alone"),
            Argument("--no-beliefs", "leave out the columns of beliefs"),
        ),
        "records.export",
        line="write the decisions of a record as a table",
    ),
    "repair": Verb(
        "Write all that can be read of a record as a complete one: of a robot whose machine has failed, or of a "
        "full disk. Where a run was split, its files become one. The record itself stays as it is.",
        "mdm record repair run.mcap -o whole.mcap",
        (_FILE, Argument("-o --output OUT", "the complete record's file", required=True)),
        "records.export:repair",
        line="write what is left of a torn record as a complete one",
    ),
}

VERBS = {
    "replay": Verb(
        "Run what a record has once more, in virtual time and as fast as it goes, with the configuration in the "
        "record, and compare every decision: exactly in the same environment, else actions exactly and numbers to "
        "1e-9. The first difference is told with what led to it. No function of the configuration is called. With "
        "--config, another configuration is compared: which decisions it would have made otherwise, also each by "
        "itself, in the same state or on the same belief, as a table by state. Of a folder, each agent's record is "
        "replayed, and what it received compared with what the replays of the others sent; with --config, it tells "
        "what the team would have decided otherwise, and from when on that cannot be told. The exit status is 1 where "
        "a decision or a message differs, or something cannot be told.",
        "mdm replay run.mcap",
        (
            Argument("file FILE", "the record, or a folder with those of a team's agents"),
            _CONFIG,
            Argument("--most N", "tell at most N differences (1; with --config, of one robot, 20)", count),
            JSON,
        ),
        "records.replay",
    ),
    "explain": Verb(
        "Say in words why a decision in a record was made: the values of all actions, by how much the chosen one was "
        "ahead, the observation that moved that most, the smallest change that would have decided otherwise, and what "
        "was expected next. The model and the policy are those in the record, or of --config: of others it is "
        "explained what they would decide. No function of the configuration is called.",
        "mdm explain run.mcap --at 12.5s",
        (
            _FILE,
            Argument(
                "--at EPOCH|TIME",
                "the decision of that number, such as 12, or the last one by a second of the record, such as 12.0 or "
                "12s (the last one of all)",
                _place,
            ),
            Argument("--ensemble PATH", "the ensemble; by default the one that decided then"),
            Argument("--last N", "look at the last N observations (10)", count),
            Argument("--config OTHER.toml", "a configuration of the same ensembles"),
            JSON,
        ),
        "records.replay:explain",
    ),
    "statistics": Verb(
        "Count what the decisions of records say about a model, of one ensemble, over several runs: probabilities with "
        "intervals, and rows that differ from the model, by evidence and by the loss of value; rates and how long "
        "states last; where states are hidden, what is most likely, by expectation maximisation. The model estimated "
        "again, and how long actions take, can be written, solved and evaluated.",
        "mdm statistics run.mcap --model top.pomdpx --ensemble top -o new.npz --durations times.npz",
        (
            Argument("files FILE...", "the record; several are runs, or agents, that are pooled"),
            Argument("--model M", "the model that the ensemble had (that of the record)"),
            Argument(
                "--ensemble PATH",
                "the ensemble, where several have decided: robot is each .../robot, in all records",
            ),
            Argument("-o --output NEW_MODEL", "write the re-estimated model"),
            Argument("--durations OUT.npz", "write how long actions take, for --durations of mdm solve"),
            Argument(
                "--step S",
                "the seconds of the model's time step: rates of changes of the state become its probabilities",
                seconds,
            ),
            Argument("--level P", "the level of the intervals (0.95)", _within, default=0.95),
            DISCOUNT,
            DISCOUNT_OF,
            Argument("--seed N", "of the intervals where states are hidden (0)", seed),
            Argument("--json", "one JSON object, with all rows"),
        ),
        "records.statistics",
    ),
    "record": Verb(
        "Look into the record of a run, an MCAP file, which Foxglove and other programs open, too.",
        "mdm record info run.mcap",
        chosen=("record_verb", "VERB"),
        verbs=_OF_A_RECORD,
    ),
    "page": Verb(
        "Show the record of a run on a page for this machine's browsers: at any time of the run, with steps to the "
        "next decision, fault and mode. Open the address that is printed; Ctrl-C ends it. What a record does not keep, "
        "as predicates, is had from a replay, where the record has its configuration. A run that goes on is shown by "
        "mdm run FILE.toml --page.",
        "mdm page run.mcap",
        (
            Argument("file FILE", "the record, or a folder with those of a team's agents"),
            Argument("--port PORT", "where the page is (8765)", port),
            *page_hosts(prefix="--"),
            Argument("--no-replay", "begin at once, without the values of predicates"),
            Argument("-o --output OUT.html", "write the page to one file, which a browser opens without a server"),
            Argument("--from S", "of --output, from second S of the record on", moment, dest="first"),
            Argument("--to S", "of --output, to second S of the record", moment, dest="last"),
        ),
        "records.page",
    ),
    "watch": Verb(
        "Watch a system that runs with a page, by the address that it has printed, or the record of a run, in this "
        "terminal: the tree of ensembles, modes, live actions, predicates, beliefs as bars, and the last events. Keys: "
        "q ends, up and down choose an ensemble; of a record, space plays, left and right move, d, f and m step to the "
        "next decision, fault and mode, with shift to the one before.",
        "mdm watch run.mcap",
        (
            Argument(
                "source URL|FILE", "the address of a page, or a record, or a folder with those of a team's agents"
            ),
            Argument("--once", "print one picture, of a record its end, and stop"),
            Argument("--at S", "of a record, begin at second S", moment),
            Argument(
                "--authority FILE",
                "of a page with TLS, who has signed its certificate, such as authority.pem; by default whom this "
                "machine trusts",
            ),
        ),
        "records.watch",
    ),
}
