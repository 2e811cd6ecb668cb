"""The measurement with a clock of its own: which rows there are, and that no action is called."""

from __future__ import annotations

import itertools
import sys

import blocks
import pytest
from places import EXAMPLES

import mdm
from mdm.latency import measure

TIGER = EXAMPLES / "tiger.pomdp", EXAMPLES / "tiger.vf"
ROWS = ["in the loop", "from a thread", "from another process", "a bare loop", "in the loop, with the recorder"]
ROWS.append("in the loop, with the page at 20 Hz")


def clock(step=1_000_000):
    """A clock that shows so many nanoseconds more whenever it is read."""
    ticks = itertools.count(0, step)
    return lambda: next(ticks)


@pytest.fixture
def without(monkeypatch):
    """Have no package but numpy and the library's own."""
    monkeypatch.setattr(module_in("mdm.latency.measure"), "find_spec", lambda _: None)


def module_in(name):
    """The module, which a function of the same name hides."""
    return sys.modules[name]


def test_rows_that_need_a_package_say_so_and_the_others_are_measured(without):
    report = measure(TIGER, seconds=0.9, clock=clock())
    assert [row.name for row in report.rows] == ROWS
    needs = {row.name: row.needs for row in report.rows if row.needs}
    assert list(needs.values()) == ["eclipse-zenoh", "mcap", "websockets"]
    for row in report.rows:
        assert (row.p50 is None) == bool(row.needs)
    loop = report.row("in the loop")
    # The clock is read before each stimulus, at its begin and in the stamp: a millisecond lies between the last two.
    assert (loop.p50, loop.p99, loop.worst, loop.undecided) == (0.001, 0.001, 0.001, 0)
    assert loop.count == 100  # 0.3 s at 3 readings each
    assert report.row("a bare loop").p50 == 0.001


def test_ensembles_of_a_file_have_rows_and_its_actions_are_not_called(tmp_path, without):
    (tmp_path / "code.py").write_text("raise SystemExit('imported')\n")
    (tmp_path / "robot.toml").write_text(
        """tasks = ["code:sense"]
[predicates]
Low = { initial = false }
Near = { initial = false }
[ensembles.one]
policy = [0, 1]
states = { battery = ["Low"] }
actions = { 0 = "code:work", 1 = "code:charge" }
[ensembles.two]
policy = [0, 1]
states = { place = ["Near"] }
drive = 1000
actions = { 0 = "code:work", 1 = "code:charge" }
"""
    )
    report = measure(tmp_path / "robot.toml", seconds=0.4, burn=1, clock=clock())
    names = [row.name for row in report.rows]
    assert names[:3] == ["in the loop", "in the loop: one", "in the loop: two"]
    assert {"ticks, behind their time", "in the loop, beside 1 busy processes"} < set(names)
    assert (
        report.row("in the loop: one").count + report.row("in the loop: two").count == report.row("in the loop").count
    )


def test_actions_are_called_where_that_is_asked_for(without):
    called = []
    manager = mdm.PredicateManager()
    manager.sensor("A", initial=False)

    def told(action):
        called.append(action.index)

    ensemble = mdm.Ensemble(
        *("robot",),
        policy=[0, 1],
        actions={0: lambda: called.append(0), 1: told},
        predicates=manager,
        states=[mdm.StateFactor("a", ["A"])],
    )
    report = measure(ensemble, seconds=0.3, clock=clock(), with_actions=True)
    assert len(called) >= sum(row.count for row in report.rows[:2])
    assert set(called) == {0, 1}


@pytest.mark.parametrize(
    "options", [*({"seconds": each} for each in (0, -1, float("nan"))), {"burn": -1}, {"burn": 0.5}]
)
def test_wrong_numbers_are_refused(options):
    with pytest.raises(mdm.Error, match="a number of"):
        measure(TIGER, **options)


@pytest.mark.slow
def test_the_program_of_speed_md_measures_all_rows(monkeypatch, capsys):
    for name in ("zenoh", "mcap", "websockets"):
        pytest.importorskip(name)
    monkeypatch.chdir(EXAMPLES.parent)
    (program,) = blocks.texts("docs/speed.md", "python")
    made = {}
    exec(program.replace("seconds=10", "seconds=1.5"), made)
    report = made["report"]
    assert [row.name for row in report.rows] == ROWS
    assert all(row.count and row.p50 <= row.p99 <= row.worst for row in report.rows)
    assert str(report.row("in the loop").p99) in capsys.readouterr().out
