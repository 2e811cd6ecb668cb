"""The arguments of the verbs that begin a project, or set up a shell."""

from __future__ import annotations

from typing import Any

from mdm.cli.usage import add_verb, complete

__all__ = ["SHELLS", "add_completion", "add_examples", "add_new"]

SHELLS = ("bash", "zsh", "fish")


def add_completion(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "Print a script that lets a shell complete verbs, options and their values. For bash, add to ~/.bashrc: "
        'eval "$(mdm completion bash)". For zsh, to ~/.zshrc, after compinit: eval "$(mdm completion zsh)". For '
        "fish, write it to ~/.config/fish/completions/mdm.fish."
    )
    parser = add_verb(verbs, "completion", line, about, "mdm completion bash")
    parser.add_argument("shell", metavar="SHELL", choices=SHELLS, help=f"one of {', '.join(SHELLS)}")
    complete(parser, "completion", "mdm.cli.projects.completion")


def add_examples(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "List the examples, a line each; or copy one of them, with all files that it needs, to a folder where it runs."
    )
    parser = add_verb(verbs, "examples", line, about, "mdm examples patrol -o patrol")
    parser.add_argument("name", metavar="NAME", nargs="?", help="an example, as they are listed")
    parser.add_argument("-o", "--output", metavar="FOLDER", help="where to copy it (a folder of its name)")
    complete(parser, "examples", "mdm.cli.projects.examples")


def add_new(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "Make a folder with a small project: the TOML file of a robot, its functions in Python, its model and policy, "
        "a test in virtual time, and a page that says how to go on. By default the robot decides on the states of an "
        "MDP."
    )
    parser = add_verb(verbs, "new", line, about, "mdm new watchman --pomdp")
    parser.add_argument("name", metavar="NAME", help="the folder, which is made; its last part names the project")
    kinds = parser.add_mutually_exclusive_group()
    kinds.add_argument("--pomdp", action="store_const", const="pomdp", dest="kind", help="a robot that keeps a belief")
    kinds.add_argument("--team", action="store_const", const="team", dest="kind", help="two robots that decide as one")
    kinds.add_argument("--map", action="store_const", const="map", dest="kind", help="a robot that goes about a floor")
    parser.set_defaults(kind="mdp")
    complete(parser, "new", "mdm.cli.projects.new")
