"""The verbs about projects, examples and shells, and their arguments."""

from __future__ import annotations

from typing import Any

from mdm.cli.usage import Argument, Verb

__all__ = ["SHELLS", "VERBS"]

SHELLS = ("bash", "zsh", "fish")
_KIND: dict[str, Any] = {"action": "store_const", "dest": "kind", "exclusive": True}

VERBS = {
    "new": Verb(
        "Make a folder with a small project: the TOML file of a robot, its functions in Python, its model and policy, "
        "a test in virtual time, and a page that says how to go on. By default the robot decides on the states of an "
        "MDP.",
        "mdm new watchman --pomdp",
        (
            Argument("name NAME", "the folder, which is made; its last part names the project"),
            Argument("--pomdp", "a robot that keeps a belief", const="pomdp", **_KIND),
            Argument("--team", "two robots that decide as one", const="team", **_KIND),
            Argument("--map", "a robot that goes about a floor", const="map", **_KIND),
        ),
        "projects.examples:new",
        settings={"kind": "mdp"},
    ),
    "examples": Verb(
        "List the examples, a line each; or copy one of them, with all files that it needs, to a folder where it runs.",
        "mdm examples patrol -o patrol",
        (
            Argument("name [NAME]", "an example, as they are listed"),
            Argument("-o --output FOLDER", "where to copy it (a folder of its name)"),
        ),
        "projects.examples",
    ),
    "completion": Verb(
        "Print a script that lets a shell complete verbs, options and their values. For bash, add to ~/.bashrc: "
        'eval "$(mdm completion bash)". For zsh, to ~/.zshrc, after compinit: eval "$(mdm completion zsh)". For fish, '
        "write it to ~/.config/fish/completions/mdm.fish.",
        "mdm completion bash",
        (Argument("shell SHELL", f"one of {', '.join(SHELLS)}", choices=SHELLS),),
        "projects.completion",
    ),
    "import-ros1": Verb(
        "Read a package of the original MDM for ROS: its launch files, the literal calls of its C++ programs that make "
        "layers, its map, labels, models and policies. Write them as a TOML file with copies of what it needs, and "
        "what could not be taken over as comments with their places; then check that file.",
        "mdm import-ros1 mdm_example -o patrol",
        (
            Argument("package PACKAGE", "the folder of the package, with its launch files and sources"),
            Argument("-o --output FOLDER", "where to write (a folder of the package's name)"),
            Argument("--launch FILE", "the launch file to begin with, where several make a control layer"),
        ),
        "ros1.package",
    ),
}
