"""``mdm ros2 doctor``: whether ROS has the topics, services and actions of a file."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from mdm.cli.report import as_json
from mdm.ros2.doctor import examine, surroundings

if TYPE_CHECKING:
    import argparse


def run(arguments: argparse.Namespace) -> int:
    """Look, and print the findings; return the exit status."""
    file = arguments.file
    parts = [] if file is None else examine(file, agent=arguments.agent, seconds=arguments.seconds)
    around = surroundings() if file is None or "rclpy" in sys.modules else {"wire": "the file's own"}
    problems = [problem for part in parts for problem in part.problems]
    if arguments.json:
        print(as_json({"ros": around, "parts": parts, "problems": problems}))
        return 1 if problems else 0
    print(", ".join(f"{name} {value}" for name, value in around.items()))
    for part in parts:
        print(f"{part.name}  {part.kind}")
        for peer in part.peers:
            quality = "" if peer.quality is None else f": {peer.quality.reliability}, {peer.quality.durability}"
            print(f"  {part.role} {peer.node}{quality}")
        if part.role == "publisher" and part.peers:
            print("  no message came meanwhile" if part.heard is None else f"  heard {as_json(part.heard)}")
    for problem in problems:
        print(f"mdm ros2 doctor: {problem}", file=sys.stderr)
    if parts and not problems:
        print(f"{file}: nothing is missing")
    return 1 if problems else 0
