"""The page on ROS 2 and its example: files that fit each other, beside a robot by rclpy itself."""

from __future__ import annotations

import asyncio
import sys
import tomllib
from types import ModuleType, SimpleNamespace

import blocks
import pytest
from patience import PATIENCE
from places import EXAMPLES, ROOT
from ros2.environment import programs

from mdm.cli import main, make_parser
from mdm.config import load_system

HERE = EXAMPLES / "ros2"
PATROL = HERE / "patrol.toml"
PAGE = "docs/ros2.md"


def test_the_page_shows_the_file_of_the_example():
    assert PATROL.read_text() in blocks.texts(PAGE, "toml")


def test_the_robot_has_what_the_file_names():
    document, robot = tomllib.loads(PATROL.read_text()), (HERE / "robot.py").read_text()
    places, top = document["places"], document["ensembles"]["patrol"]
    named = [document["predicates"]["BatteryIsLow"]["topic"], places["pose"]["topic"], top["safe_action"]["publish"]]
    named += [places["navigator"]["ros2"]["action"], top["actions"]["dock"]["action"]]
    assert all(f'"{name}"' in robot for name in named)


def test_the_example_is_checked_without_rclpy(capsys):
    assert main(["check", str(PATROL)]) == 0
    told = capsys.readouterr().out
    assert "no problems" in told
    assert "types are unchecked: rclpy cannot be imported here" in told


def test_the_other_files_of_the_page_are_read(tmp_path):
    """Each block as a part of a file that has what it leaves out."""
    for name in ("floor.xml", "patrol.mdp", "patrol.policy"):
        (tmp_path / name).write_bytes((HERE / name).read_bytes())
    (tmp_path / "robot.py").write_text("def door_is_near(scan): return None\n")
    wholes = [text for text in blocks.texts(PAGE, "toml") if text != PATROL.read_text()]
    for text in wholes:
        given, document = tomllib.loads(text), tomllib.loads(PATROL.read_text())
        own = document["ensembles"]["patrol"]
        document["predicates"]["IsStill"] = {}
        for name, table in given.items():
            if name == "ensembles":
                actions = table["top"].pop("actions", {})
                own.update(table["top"])
                own["actions"] = dict(zip(own["actions"], actions.values(), strict=True)) if actions else own["actions"]
            elif name == "places":
                document[name] |= {key: table[key] for key in ("pose", "navigator", "max_age")}
            else:
                document[name] = document.get(name, {}) | table
        load_system(document, folder=tmp_path, callbacks=False)
    assert len(wholes) == 4


def test_the_launch_file_starts_what_is_there(monkeypatch):
    """The package `launch` is not among the wheels: a stand-in has the names that the file takes."""

    def made(*positional, **named):
        return SimpleNamespace(positional=positional, **named)

    names = {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument", "ExecuteProcess"],
        "launch.conditions": ["IfCondition"],
        "launch.substitutions": ["LaunchConfiguration"],
    }
    for module, content in names.items():
        stand_in = ModuleType(module)
        vars(stand_in).update(dict.fromkeys(content, made))
        monkeypatch.setitem(sys.modules, module, stand_in)
    file = HERE / "patrol.launch.py"
    scope = {"__name__": "patrol", "__file__": str(file)}
    exec(compile(file.read_text(), file, "exec"), scope)
    [argument, robot, patrol] = scope["generate_launch_description"]().positional[0]
    assert argument.positional == robot.condition.positional[0].positional == ("simulated",)
    assert argument.default_value == "false"
    assert robot.cmd == [sys.executable, str(HERE / "robot.py")]
    assert patrol.cmd == [sys.executable, "-m", "mdm", "run", str(PATROL)]
    assert float(patrol.sigterm_timeout) >= 10  # seconds of a safe action


@pytest.mark.slow
def test_the_example_patrols_docks_and_stands_still_at_the_end(ros, nav2, tmp_path):
    async def run():
        async with programs(ros, tmp_path, nav2) as here:
            robot = await here.start(HERE / "robot.py")
            patrol = await here.start("-m", "mdm", "run", PATROL)
            lines = []

            async def hear(wanted):
                async with asyncio.timeout(PATIENCE):
                    while not (line := (await robot.process.stdout.readline()).decode().strip()).startswith(wanted):
                        assert line, robot.said.read_text() + patrol.said.read_text()
                        lines.append(line)

            for room in ("6.0, 3.0", "10.0, 3.0", "2.0, 3.0"):
                await hear(f"is at {room}")
            await hear("is charged")
            await hear("goes to")
            patrol.process.terminate()
            await hear("stands still")
            assert await patrol.end() == 143
            said = patrol.said.read_text()
            assert "Traceback" not in said
            assert "terminate called" not in said

    asyncio.run(run())


def test_the_command_takes_what_the_page_says():
    lines = [line.partition("#")[0] for text in blocks.texts(PAGE, "console") for line in text.splitlines()]
    calls = [line.split()[1:] for whole in lines for line in whole.split("&&") if line.split()[:1] == ["mdm"]]
    for words in calls:
        make_parser().parse_args(words)
    assert len(calls) == 8


def test_the_page_s_files_are_in_the_repository():
    assert (ROOT / PAGE).exists()
    assert {path.name for path in HERE.iterdir()} >= {"robot.py", "patrol.launch.py", "floor.xml", "patrol.policy"}
