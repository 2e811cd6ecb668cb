"""The arguments of the verb that takes over packages of the original MDM for ROS."""

from __future__ import annotations

from typing import Any

from mdm.cli.usage import add_verb, complete

__all__ = ["add_import_ros1"]


def add_import_ros1(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "Read a package of the original MDM for ROS: its launch files, the literal calls of its C++ programs that make "
        "layers, its map, labels, models and policies. Write them as a TOML file with copies of what it needs, and "
        "what could not be taken over as comments with their places; then check that file."
    )
    parser = add_verb(verbs, "import-ros1", line, about, "mdm import-ros1 mdm_example -o patrol")
    parser.add_argument(
        "package", metavar="PACKAGE", help="the folder of the package, with its launch files and sources"
    )
    parser.add_argument("-o", "--output", metavar="FOLDER", help="where to write (a folder of the package's name)")
    parser.add_argument(
        "--launch", metavar="FILE", help="the launch file to begin with, where several make a control layer"
    )
    complete(parser, "import-ros1", "mdm.cli.ros1.package")
