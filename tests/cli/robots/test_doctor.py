"""``mdm ros2 doctor`` and ``mdm check --live`` without rclpy; beside a robot by rclpy itself in tests/ros2."""

from __future__ import annotations

import pytest
from places import EXAMPLES

from mdm.cli import main

PATROL = EXAMPLES / "ros2" / "patrol.toml"


@pytest.mark.parametrize(
    "words", [["ros2", "doctor"], ["ros2", "doctor", str(PATROL)], ["check", "--live", str(PATROL)]]
)
def test_without_rclpy_a_sentence_says_how_it_is_had(words, capsys):
    assert main(words) == 1
    told = capsys.readouterr().err
    assert "rclpy cannot be imported" in told
    assert "source" in told


def test_a_file_with_a_wire_of_its_own_needs_no_rclpy(tmp_path, capsys):
    for name in ("floor.xml", "patrol.mdp", "patrol.policy"):
        (tmp_path / name).write_bytes((PATROL.parent / name).read_bytes())
    (tmp_path / "own.py").write_text(
        "from ros2.stand_in import StandIn\n\ndef wire(node, namespace, remap):\n    return StandIn()\n"
    )
    file = tmp_path / "patrol.toml"
    file.write_text(PATROL.read_text().replace('node = "patrol"', 'node = "patrol"\nwire = "own:wire"'))
    assert main(["ros2", "doctor", str(file), "--seconds", "0.1"]) == 1
    said = capsys.readouterr()
    assert "nobody publishes /battery_state" in said.err
    first, *parts = said.out.splitlines()
    assert first == "wire the file's own"
    assert "/battery_state  sensor_msgs/msg/BatteryState" in parts


def test_a_model_is_not_looked_for_in_ros(capsys):
    assert main(["check", "--live", str(EXAMPLES / "ros2" / "patrol.mdp")]) == 2
    assert "--live is for TOML files" in capsys.readouterr().err


def test_of_a_team_one_agent_is_looked_at(capsys):
    assert main(["check", "--live", str(EXAMPLES / "team" / "meeting.toml")]) == 2
    assert "--agent" in capsys.readouterr().err


def test_services_are_a_note_of_the_check(tmp_path, capsys):
    for name in ("floor.xml", "patrol.mdp", "patrol.policy"):
        (tmp_path / name).write_bytes((PATROL.parent / name).read_bytes())
    file = tmp_path / "patrol.toml"
    for services, noted in (("true", True), ('["stop"]', True), ("false", False)):
        file.write_text(PATROL.read_text().replace('node = "patrol"', f'node = "patrol"\nservices = {services}'))
        assert main(["check", str(file)]) == 0
        told = capsys.readouterr().out
        assert ("anybody on the ROS domain may call" in told) == noted


def test_a_name_that_is_remapped_and_that_nothing_has_is_a_note_of_the_check(tmp_path, capsys):
    for name in ("floor.xml", "patrol.mdp", "patrol.policy"):
        (tmp_path / name).write_bytes((PATROL.parent / name).read_bytes())
    file = tmp_path / "patrol.toml"
    remap = '{ "/cmd_vel" = "/base", "/batery_state" = "/battery", "~/decisions" = "/decided" }'
    file.write_text(PATROL.read_text().replace('node = "patrol"', f'node = "patrol"\nremap = {remap}'))
    assert main(["check", str(file)]) == 0
    assert "ros2.remap: nothing in this file uses '/batery_state'\n" in capsys.readouterr().out
