"""The verbs that run robots, and their arguments."""

from __future__ import annotations

from mdm.cli.usage import (
    DISCOUNT,
    FALSE_NEGATIVE,
    JSON,
    Argument,
    Verb,
    count,
    given_file,
    live_page,
    number,
    seconds,
    seed,
)

__all__ = ["RUN", "VERBS", "VIRTUAL"]

VIRTUAL = Argument("--virtual", "in virtual time: without waiting, until nothing is pending")
RUN = (
    Argument("file FILE", "the TOML file"),
    Argument("--agent NAME", "of a team's file, which agent this process is"),
    Argument("--decisions PATH", "add each decision, of a team each joint step, to this file as a line of JSON"),
    Argument(
        "--record PATH",
        "record the run to this file, such as run.mcap, which mdm replay runs again; a record there is kept, and "
        "run.2.mcap written",
    ),
    *live_page("show the run live on a page", "of a team's file the agent's own"),
    Argument("--quiet", "write no log"),
    VIRTUAL,
    Argument("--epochs N", "stop after N decisions of the first ensemble", count),
    Argument("--seconds N", "stop after N seconds", seconds),
    Argument("--attached", "stop when standard input ends, as agents do when `mdm team up` ends"),
    Argument(
        "--why", "write why with each decision that is logged; that takes some milliseconds each, beside the decisions"
    ),
    Argument("--log {console,json}", "how to write the log", choices=("console", "json"), default="console"),
)
"""The arguments of `mdm run`; `mdm team run` has them without virtual time."""

VERBS = {
    "run": Verb(
        "Run the ensembles of a TOML file, of a team's file those of one agent, until Ctrl-C, SIGTERM, --seconds, or "
        "--epochs decisions of the first one. SIGUSR1 releases those that are safe: kill -USR1 PID. The exit status is "
        "1 if something failed that nobody could help, or if of a robot alone every action has failed.",
        "mdm run examples/patrol/patrol.toml --virtual --epochs 20",
        RUN,
        "robots.run",
    ),
    "trace": Verb(
        "Read JSON lines from standard input, one stimulus a line, and print one JSON line a decision. A stimulus has "
        'any of "time" (seconds), "observation", "state", "belief", "predicates" ({"name": true}, or a number for a '
        'threshold), "events" (["name"]) and "control" ("start", "stop", "reset", "release", "decide_again"). Async '
        'functions of the file stand for actions that take time: they end by an event such as "Go.succeeded" or '
        '"Go.failed", and not by themselves.',
        "echo '{\"observation\": 0}' | mdm trace tiger.pomdp tiger.vf",
        (
            *given_file("the TOML file, whose functions are not called"),
            Argument("--drive event|RATE", "decide on events (default), or RATE times a second"),
            DISCOUNT,
            FALSE_NEGATIVE,
            Argument("--horizon H", "decisions in an episode", count),
            Argument(
                "--on-impossible {predict,keep,reset}",
                "reaction to an observation of probability 0 (predict)",
                choices=("predict", "keep", "reset"),
            ),
            Argument("--on-no-observation predict|repeat|NAME", "meaning of a tick without an observation (predict)"),
            Argument("--seed S", "for a stochastic policy", seed),
        ),
        "robots.trace",
    ),
    "ros2": Verb(
        "Look at ROS 2 as a robot's file does.",
        "mdm ros2 doctor examples/ros2/patrol.toml",
        chosen=("ros2_verb", "VERB"),
        verbs={
            "doctor": Verb(
                "Say which rclpy, distribution, middleware and domain there are, and of each topic, service and action "
                "of a file who has its other end, by which type and quality of service, with a message that came. "
                "What is missing is told with the way out, and the exit status is then 1. The file's functions are "
                "imported, and nothing is sent.",
                "mdm ros2 doctor examples/ros2/patrol.toml",
                (
                    Argument("file [FILE]", "the TOML file"),
                    Argument("--agent NAME", "of a team's file, which agent's part"),
                    Argument("--seconds N", "how long to look for what is missing (default: 5)", seconds, default=5.0),
                    JSON,
                ),
                "robots.doctor",
                line="what a file needs, and whether it is there",
            )
        },
    ),
    "latency": Verb(
        "Measure how long decisions take on this machine: from random stimuli, in the event loop, from a thread and "
        "from another process, to the first action that is called; with a record, with the page and, by --burn, beside "
        "busy processes; and say what would make them faster. No task, sensor, link or team of the file runs, and "
        "stamps stand in for its actions; its policies and trackers are its own.",
        "mdm latency examples/patrol/patrol.toml --seconds 10",
        (
            *given_file("the TOML file"),
            Argument("--agent NAME", "of a team's file, the agent whose own ensembles are measured"),
            Argument("--seconds N", "for how long in all, besides the start (50)", seconds, default=50.0),
            Argument(
                "--burn N",
                "measure also beside N busy processes",
                number("a number of processes, 0 to 1000,", 0, 1000, kind=int),
                default=0,
            ),
            Argument("--with-actions", "call the file's own actions, too, many times a second: the robot moves"),
            Argument("--seed S", "of the random stimuli (1)", seed, default=1),
            JSON,
        ),
        "robots.latency",
    ),
}
