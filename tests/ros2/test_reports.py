"""What ROS sees of a robot: diagnostics, decisions and modes; and the services that command it."""

from __future__ import annotations

import asyncio
import json
from datetime import datetime

import pytest
from places import EXAMPLES
from ros2.environment import programs
from ros2.stand_in import StandIn

import mdm
from mdm.ros2.reports import SERVICES, Reports
from mdm.ros2.wire import Quality
from mdm.testing import run_virtual

OK, WARN, ERROR = [b"\0", b"\1", b"\2"]


class Link(mdm.Extension):
    """Opens the reports as a link does: their wire before them, and closed behind them."""

    def __init__(self, wire, **asked):
        self.wire, self.reports = wire, Reports(wire, "ns/patrol", **asked)

    async def open(self, runtime):
        await self.wire.open(runtime)
        self.reports.open(runtime)

    async def close(self):
        self.reports.close()
        await self.wire.close()


def robot(name="robot", **options):
    predicates = mdm.PredicateManager()
    predicates.sensor("Low", max_age=2.0)
    return mdm.Ensemble(
        name,
        policy=[0, 1],
        predicates=predicates,
        states=[mdm.StateFactor("battery", ["Low"])],
        actions={"patrol": lambda: None, "dock": lambda: None},
        **options,
    )


def run(main, ensemble=None, **asked):
    """Run a robot with reports, in virtual time; return the wire."""
    wire, robot_ = StandIn(), ensemble or robot()

    async def whole(runtime):
        wire.faults = []
        runtime.faults.subscribe(wire.faults.append)
        await runtime.start(robot_)
        await main(wire, robot_)

    run_virtual(whole, extensions=[Link(wire, **asked)])
    return wire


def statuses(wire):
    """Return each status that was published, with its time: of one ensemble, level, message and values."""
    return [
        (time, status.level, status.name, status.message, {value.key: value.value for value in status.values})
        for time, message in wire.published["/diagnostics"]
        for status in message.status
    ]


def test_diagnostics_tell_what_an_ensemble_waits_for_does_and_fears():
    async def main(wire, robot_):
        await asyncio.sleep(0.5)
        robot_.predicates.sense("Low", False)
        await asyncio.sleep(0.7)  # a second is over
        robot_.stop()
        await asyncio.sleep(0.1)

    told = [(level, message, values["mode"]) for _, level, _, message, values in statuses(run(main))]
    assert list(dict.fromkeys(told)) == [
        (WARN, "waits for Low", "deciding"),
        (OK, "patrol", "deciding"),
        (WARN, "stopped", "stopped"),
    ]


def test_a_safe_ensemble_is_an_error_with_its_causes():
    async def main(wire, robot_):
        robot_.predicates.sense("Low", True)
        await asyncio.sleep(3.2)

    wire = run(main, robot(safe_action="dock"))
    name, message, values = next(each[2:] for each in statuses(wire) if each[1] == ERROR)
    assert name == "ns/patrol: robot"
    assert message == f"safe: {values['causes']}"
    assert "Low" in values["causes"]
    assert values["mode"] == "safe"
    assert values["action"] == "dock"
    assert datetime.fromisoformat(values["since"]).tzinfo is not None


def test_diagnostics_come_once_a_second_and_with_each_mode():
    async def main(wire, robot_):
        robot_.predicates.sense("Low", False)
        await asyncio.sleep(0.25)
        robot_.stop()
        await asyncio.sleep(3)

    times = [time for time, *_ in statuses(run(main))]
    began = times[0]
    later = [round(time - began, 2) for time in times if time > began]
    assert later == [0.25, 1.25, 2.25, 3.25, 3.25]  # the last is that of the end


def test_an_ensemble_below_another_that_is_not_chosen_is_no_warning():
    below = robot("below")
    predicates = mdm.PredicateManager()
    predicates.sensor("High")
    above = mdm.Ensemble(
        "above",
        policy=[0, 1],
        predicates=predicates,
        states=[mdm.StateFactor("height", ["High"])],
        actions={"rest": lambda: None, "work": below},
    )

    async def main(wire, robot_):
        predicates.sense("High", False)
        await asyncio.sleep(1.5)

    _, level, name, message, _ = statuses(run(main, above))[-3]  # the last are those of the end
    assert (level, name, message) == (OK, "ns/patrol: above/below", "not chosen")


def test_decisions_and_modes_are_json_where_they_are_asked_for():
    async def main(wire, robot_):
        robot_.predicates.sense("Low", False)
        await asyncio.sleep(0.1)
        robot_.predicates.sense("Low", True)
        await asyncio.sleep(0.1)

    wire = run(main, decisions=True)
    decisions = [json.loads(message.data) for _, message in wire.published["~/decisions"]]
    assert [(one["epoch"], one["state"], one["action_name"]) for one in decisions] == [(0, 0, "patrol"), (1, 1, "dock")]
    assert "belief" not in decisions[0]
    modes = [json.loads(message.data) for _, message in wire.published["~/modes"]]
    assert [mode["mode"] for mode in modes[:2]] == ["deciding", "stopped"]
    assert "~/decisions" not in run(main).published


def test_services_are_those_that_are_asked_for():
    async def main(wire, robot_):
        pass

    assert not run(main).served
    assert set(run(main, services=SERVICES).served) == {f"~/{name}" for name in SERVICES}
    assert set(run(main, services=["stop"]).served) == {"~/stop"}


def test_services_command_the_robot_and_say_whom():
    said = {}

    async def main(wire, robot_):
        robot_.predicates.sense("Low", False)
        await asyncio.sleep(0.1)
        for name in ("stop", "start", "reset", "release"):
            response = await wire.ask(f"~/{name}")
            await asyncio.sleep(0.1)
            said[name] = (response.success, response.message, robot_.mode, robot_.controller.epoch)

    run(main, services=SERVICES)
    assert said["stop"][:3] == (True, "stop: robot", "stopped")
    assert said["start"][:3] == (True, "start: robot", "deciding")
    assert said["reset"][:3] == (True, "reset: robot", "deciding")
    assert said["release"][:3] == (False, "there is no ensemble to release", "deciding")


def test_a_release_is_of_what_is_safe():
    async def main(wire, robot_):
        robot_.safety.endanger("boot", "a wheel is loose", robot_.runtime.now())
        await asyncio.sleep(0.1)
        assert robot_.mode == "safe"
        response = await wire.ask("~/release")
        assert response.message == "release: robot"
        await asyncio.sleep(0.1)
        assert "boot" not in {cause.kind for cause in robot_.causes}

    run(main, robot(safe_action="dock"), services=SERVICES)


def test_the_log_warns_of_services(capsys):
    wire = StandIn()

    async def main(runtime):
        await runtime.start(robot())

    run_virtual(main, log="json", extensions=[Link(wire, services=["stop"])])
    assert "anybody on the ROS domain may call ~/stop" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["diagnostics", "decisions"])
def test_what_fails_to_be_told_is_one_fault_and_the_robot_goes_on(kind, monkeypatch):
    def fail(*_):
        raise OSError("no room")

    async def main(wire, robot_):
        monkeypatch.setattr(type(wire.publish("/other", "std_msgs/msg/String", Quality())), "__call__", fail)
        robot_.predicates.sense("Low", False)
        await asyncio.sleep(1.8)
        robot_.predicates.sense("Low", True)
        await asyncio.sleep(0.1)
        assert robot_.status().action_name == "dock"

    [fault] = run(main, **{"diagnostics": False, kind: True}).faults
    assert fault.kind == "observer"
    assert "no room" in fault.detail


@pytest.mark.slow
def test_a_node_reads_how_the_robot_does_and_stops_it(ros, nav2, tmp_path):
    for name in ("floor.xml", "patrol.mdp", "patrol.policy"):
        (tmp_path / name).write_bytes((EXAMPLES / "ros2" / name).read_bytes())
    asked = 'node = "patrol"\nnamespace = "/ns"\ndecisions = true\nservices = true'
    text = (EXAMPLES / "ros2" / "patrol.toml").read_text().replace('node = "patrol"', asked)
    (tmp_path / "patrol.toml").write_text(text)

    async def main():
        async with programs(ros, tmp_path, nav2) as here:
            peer = await here.peer()
            peer.tell(echo="/diagnostics", type="diagnostic_msgs/msg/DiagnosticArray")
            peer.tell(echo="/ns/patrol/decisions", type="std_msgs/msg/String")
            await here.start("-m", "mdm", "run", "patrol.toml")

            async def status(level):
                def has(event):
                    return event["message"]["status"] and event["message"]["status"][0]["level"] == level

                told = await peer.hear("heard", where=lambda event: event["heard"] == "/diagnostics" and has(event))
                return told["message"]["status"][0]

            waits = await status(1)
            assert waits["name"] == "ns/patrol: patrol"
            assert "BatteryIsLow" in waits["message"]
            await here.start(EXAMPLES / "ros2" / "robot.py")
            decided = await peer.hear("heard", where=lambda event: event["heard"] == "/ns/patrol/decisions")
            assert json.loads(decided["message"]["data"])["action_name"] == "to-office"
            runs = await status(0)
            assert {value["key"] for value in runs["values"]} == {"mode", "action", "since", "causes"}
            peer.tell(call="/ns/patrol/stop", type="std_srvs/srv/Trigger")
            assert (await peer.hear("response"))["fields"] == {"success": True, "message": "stop: patrol"}
            assert (await status(1))["message"] == "stopped"

    asyncio.run(main())
