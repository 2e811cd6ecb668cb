"""``mdm examples`` and ``mdm new``: examples, to list and to copy, and small projects that run and have a test."""

from __future__ import annotations

import difflib
import re
import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import mdm
from mdm.cli.usage import UsageError
from mdm.errors import Error

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator


class Example(NamedTuple):
    """An example.

    Args:
        line: Its subject.
        paths: Its files and folders, below the folder of examples.
        command: How to run it, in the folder to which it was copied.
    """

    line: str
    paths: tuple[str, ...]
    command: str


_TIGER = ("tiger.pomdp", "tiger.vf")
_FLOOR = ("patrol/floor.pgm", "patrol/floor.xml", "patrol/floor.yaml", "patrol/labels.png")

EXAMPLES = {
    "first": Example("a model from functions, its policy, and a sensor that changes", ("first.py",), "python first.py"),
    "tiger": Example(
        "a POMDP at a fixed rate, as a program and a TOML file", ("tiger.py", "tiger.toml", *_TIGER), "python tiger.py"
    ),
    "stairs": Example("a robot beside stairs, and a shield that keeps it off", ("stairs.py",), "python stairs.py"),
    "from_arrays": Example(
        "an MDP and a POMDP from arrays, solved and run by a controller", ("from_arrays.py",), "python from_arrays.py"
    ),
    "embedding": Example(
        "an ensemble beside other tasks of a program, with a sensor in a thread",
        ("embedding.py",),
        "python embedding.py",
    ),
    "external_belief": Example(
        "beliefs from a particle filter of your own", ("external_belief.py",), "python external_belief.py"
    ),
    "tree_search": Example(
        "a tree search at each decision, in a process of its own", ("tree_search.py", *_TIGER), "python tree_search.py"
    ),
    "rooms": Example(
        "places of a map as predicates and its ways as actions, in virtual time", ("rooms.py",), "python rooms.py"
    ),
    "actions": Example(
        "behaviour trees and state machines of five libraries as actions", ("actions",), "python ensemble_within.py"
    ),
    "tutorial": Example(
        "the tutorial's steps, from predicates to a model's statistics (needs mcap, navground, pillow and pyyaml)",
        ("tutorial", "patrol"),
        "python tutorial/step1_predicates.py",
    ),
    "patrol": Example(
        "the demo: a robot patrols a simulated building, in two levels (needs navground, pillow and pyyaml)",
        ("patrol",),
        "python patrol.py",
    ),
    "foxglove": Example(
        "a record of the demo for Foxglove: the floor with the robot, and a layout (needs mcap and navground)",
        ("foxglove", "patrol"),
        "mdm run patrol/patrol.toml --record run.mcap --seconds 60 && python foxglove/to_foxglove.py run.mcap",
    ),
    "grafana": Example(
        "a dashboard of Grafana for /metrics of a robot's page, and what Prometheus is told to read it",
        ("grafana",),
        "prometheus --config.file prometheus.yml",
    ),
    "ros2": Example(
        "a robot of ROS 2: rooms as predicates, Nav2's actions, and a launch file (needs rclpy and nav2_msgs)",
        ("ros2",),
        "python robot.py & mdm run patrol.toml",
    ),
    "team": Example(
        "teams, a process an agent: replicated, centralised, communicating (needs eclipse-zenoh)",
        ("team", *_TIGER, *_FLOOR),
        "mdm team up team/meeting.toml --seconds 20",
    ),
}
"""The examples, by name."""


def run(arguments: argparse.Namespace) -> int:
    """List the examples, or copy one; return the exit status."""
    if arguments.name is None:
        if arguments.output is not None:
            raise UsageError("-o goes with the name of an example")
        width = max(map(len, EXAMPLES)) + 2
        for name, example in EXAMPLES.items():
            print(f"{name:{width}}{example.line}")
        return 0
    name = arguments.name.removesuffix(".py").strip("/").replace("-", "_")
    if name not in EXAMPLES:
        close = difflib.get_close_matches(name, EXAMPLES, n=1, cutoff=0.4)
        hint = f"did you mean {close[0]}?" if close else "`mdm examples` lists them"
        raise UsageError(f"there is no example {arguments.name!r}; {hint}")
    target = Path(arguments.output or name)
    with making(target) as made:
        _copy(EXAMPLES[name], folder(), made)
    print(f"{target}: {EXAMPLES[name].line}\nRun it there: {EXAMPLES[name].command}")
    return 0


def _copy(example: Example, source: Path, target: Path) -> None:
    first = source / example.paths[0]
    base = first if first.is_dir() and len(example.paths) == 1 else source
    for path in example.paths:
        if (source / path).is_dir():
            shutil.copytree(
                source / path,
                target / (source / path).relative_to(base),
                ignore=shutil.ignore_patterns("__pycache__"),
                dirs_exist_ok=True,
            )
        else:
            (target / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source / path, target / path)


def new(arguments: argparse.Namespace) -> int:
    """Make a project; return the exit status."""
    target = Path(arguments.name)
    name = target.name
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        expected = "letters, digits and _ were expected, a letter first"
        raise UsageError(f"{name!r} cannot be the name of an ensemble: {expected}")
    with making(target) as made:
        for file in (folder() / "projects" / arguments.kind).iterdir():
            if file.is_file():
                (made / file.name).write_bytes(file.read_bytes().replace(b"@NAME@", name.encode()))
    run_it = "mdm team up team.toml" if arguments.kind == "team" else "mdm run robot.toml"
    print(
        f"{target}: a project; README.md says what its files are\nRun it there: {run_it}\n"
        "Test it: python -m pytest (which takes pip install pytest)"
    )
    return 0


def folder() -> Path:
    """Return the folder of the examples: within the installed package, or beside it in a clone.

    Raises:
        Error: If they are not there.
    """
    package = Path(mdm.__file__).parent
    for place in (package / "examples", package.parent / "examples"):
        if (place / "first.py").is_file():
            return place
    raise Error(f"the examples are not beside the package in {package}: install the wheel, or work in a clone")


@contextmanager
def making(target: Path) -> Iterator[Path]:
    """Yield a folder to fill; when it is filled, it becomes the target, which is empty or not there before.

    Raises:
        Error: If the target is a file, or a folder that is not empty.
        OSError: If it cannot be made.
    """
    if target.is_dir():
        if any(target.iterdir()):
            raise Error(f"{target}: this folder is not empty; name another one")
    elif target.exists() or target.is_symlink():
        raise Error(f"{target}: this is a file; name a folder")
    parent = target.resolve().parent
    if not parent.is_dir():
        raise Error(f"{target}: there is no folder {parent} to make it in")
    made = Path(tempfile.mkdtemp(prefix=".mdm-", dir=parent))
    try:
        content = made / "content"
        content.mkdir()
        yield content
        content.replace(target.resolve())  # an empty folder is replaced
    finally:
        shutil.rmtree(made, ignore_errors=True)
