"""The records of a team's agents, shown together."""

from __future__ import annotations

import asyncio

import msgspec
import pytest
from sentences import refused

import mdm
from mdm.errors import Error
from mdm.policies import DeterministicPolicy
from mdm.recording import Record
from mdm.snapshots import Event, RecordedRun
from mdm.testing import run_virtual
from mdm.views.web.team import RecordedTeam

AHEAD = 2.5


def recorded(folder, name, seconds):
    """Record an agent that decides each second; return its run."""

    async def main(runtime):
        manager = mdm.PredicateManager("predicates")
        sensor = manager.sensor("On", initial=False)
        robot = mdm.Ensemble(
            name,
            states=[mdm.StateFactor("on", ["On"])],
            policy=DeterministicPolicy([0, 1]),
            actions={0: lambda: None, 1: lambda: asyncio.sleep(0.5)},
            predicates=manager,
        )
        await runtime.start(robot)
        for step in range(seconds):
            await asyncio.sleep(1)
            sensor.set(step % 2 == 0)

    run_virtual(main, record=folder / f"{name}.mcap")
    return RecordedRun(Record(folder / f"{name}.mcap"))


@pytest.fixture
def team(tmp_path, monkeypatch):
    """Return a team of which bob began later, and its runs."""
    runs = {"ada": recorded(tmp_path, "ada", 6), "bob": recorded(tmp_path, "bob", 9)}
    for name, run in runs.items():
        scene = msgspec.structs.replace(run.scene(), began=10**18 + round(1e9 * AHEAD) * (name == "bob"))
        monkeypatch.setattr(run, "scene", lambda scene=scene: scene)
    return RecordedTeam(runs, title="team"), runs


def test_agents_are_shown_as_their_records_show_them_each_by_its_own_clock(team):
    together, runs = team
    scene = together.scene()
    assert ([each.path for each in scene.ensembles], scene.source) == (["ada", "bob"], "record")
    assert together.last == runs["bob"].last + AHEAD
    for time in (0.0, 1.2, 2.6, 4.0, 5.9, together.last):
        frame = together.frame(time, ["ada", "bob"])
        assert frame.time == time
        ada, bob = runs["ada"].frame(time, ["ada"]), runs["bob"].frame(time - AHEAD, ["bob"])
        assert frame.ensembles[0] == ada.ensembles[0]
        assert frame.details["ada"] == ada.details["ada"]
        if time < AHEAD:
            assert frame.ensembles[1].mode == "stopped"
            continue
        assert frame.ensembles[1].action == bob.ensembles[0].action
        assert frame.ensembles[1].since == bob.ensembles[0].since + AHEAD
        assert frame.details["bob"].decided == bob.details["bob"].decided + AHEAD


def test_lanes_events_and_steps_have_the_times_of_the_team(team):
    together, runs = team
    lanes = together.lanes(0.0, together.last, ["ada", "bob"], [], 2000)
    own = runs["bob"].lanes(0.0, runs["bob"].last, ["bob"], [], 2000)
    assert [each.time for each in lanes if each.source == "bob"] == [each.time + AHEAD for each in own]
    events = [msgspec.json.decode(each, type=Event) for each in together.after(0, 10**9)[0]]
    assert [each.time for each in events] == sorted(each.time for each in events)
    assert {each.source for each in events} >= {"ada", "bob"}
    decisions = sorted({each.time for each in lanes if each.kind == "decision"})
    stepped, time = [0.0], 0.0
    while (after := together.step("decision", time)) != time:
        stepped.append(time := after)
    assert stepped == pytest.approx(decisions)
    assert together.step("decision", time, back=True) == pytest.approx(decisions[-2])


def test_an_agent_whose_record_breaks_off_is_stopped_from_there_on(team):
    together, runs = team
    end, paths = 4.2, ["ada", "bob"]
    before = together.lanes(0.0, together.last, paths, [], 2000)
    runs["ada"].breaks, runs["ada"].last = True, end
    assert together.frame(end).ensembles[0].mode == "deciding"
    after = together.frame(end + 1)
    assert (after.ensembles[0].mode, after.ensembles[0].since, after.ensembles[1].mode) == ("stopped", end, "deciding")
    added = [each for each in together.lanes(0.0, together.last, paths, [], 2000) if each not in before]
    assert [(each.time, each.kind, each.source, each.name) for each in added] == [(end, "mode", "ada", "stopped")]
    (unknown,) = [each for each in together.lanes(0.0, together.last, [], ["ada: On"], 9) if each.time == end]
    assert (unknown.name, unknown.status) == ("ada: On", "unknown")
    assert not [each for each in together.lanes(0.0, end - 0.1, paths, [], 2000) if each.name == "stopped"]


def test_a_record_that_was_not_closed_breaks_off(tmp_path):
    run = recorded(tmp_path, "ada", 1)
    (tmp_path / "torn.mcap").write_bytes((tmp_path / "ada.mcap").read_bytes()[:-200])
    assert (run.breaks, RecordedRun(Record(tmp_path / "torn.mcap")).breaks) == (False, True)


def test_the_course_of_an_ensemble_and_why_are_told_by_its_own_record(team):
    together, runs = team

    async def asked():
        return (
            await together.course("bob", AHEAD, together.last),
            await runs["bob"].course("bob", 0.0, runs["bob"].last),
            await together.course("carl", 0.0, 1.0),
            await together.explain("bob", 4.0),
            await together.explain("carl"),
            await together.draw("carl"),
        )

    course, own, nobody, why, no_why, no_picture = asyncio.run(asked())
    assert course.times == pytest.approx([time + AHEAD for time in own.times])
    assert (nobody, no_why, no_picture) == (None, None, ())
    assert why is not None


def test_records_of_robots_that_are_no_team_are_refused(tmp_path):
    run = recorded(tmp_path, "ada", 1)
    with refused(Error):
        RecordedTeam({"ada": run, "eve": run}, title="records")
