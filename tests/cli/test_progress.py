"""How far a solver has come, on a terminal and elsewhere."""

from __future__ import annotations

import io

import pytest

from mdm.cli.interruption import Interruption
from mdm.cli.progress import ProgressLine, bound, counting, to_go, work_shown
from mdm.progress import report_share
from mdm.solvers import Progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


def lines_of(terminal):
    return [line for line in terminal.getvalue().split("\r\x1b[K") if line]


def test_progress_is_a_line_on_a_terminal_and_a_few_lines_elsewhere():
    shown, told = Terminal(), io.StringIO()
    for stream in (shown, told):
        line = ProgressLine(stream, limit=60.0)
        for tenth in range(1, 100):
            line(Progress(tenth / 20, -float("inf"), 7.0, tenth, 3, 10**6))
        line.end()
    assert "\n" not in shown.getvalue()
    assert 20 < shown.getvalue().count("\r") < 40
    assert shown.getvalue().startswith("\r\x1b[K2.0 s ")
    assert lines_of(shown)[0].endswith("MB  at most 58 s to go")
    assert shown.getvalue().endswith("\r\x1b[K")
    lines = told.getvalue().splitlines()
    assert [line.split()[0] for line in lines] == ["1.0", "2.0", "4.0"]
    assert "? to 7 " in lines[0]


def test_episodes_are_counted(monkeypatch, capsys):
    seconds = iter(range(100))
    monkeypatch.setattr("mdm.cli.progress.perf_counter", lambda: float(next(seconds)))
    interruption = Interruption()
    with counting(interruption, "policy 1 of 2  ") as count:
        assert not any(count(ended, 10) for ended in range(10))
        interruption.number = 2
        assert count(10, 10)
    told = capsys.readouterr().err.splitlines()
    assert told[0] == "1.0 s  policy 1 of 2  0 of 10 episodes"
    assert [line.split()[0] for line in told] == ["1.0", "2.0", "4.0", "8.0"]
    assert told[2] == "4.0 s  policy 1 of 2  3 of 10 episodes  about 9 s to go"


def test_work_that_goes_on_takes_as_long_as_this_run_says(capsys, monkeypatch):
    seconds = iter(range(100))
    monkeypatch.setattr("mdm.cli.progress.perf_counter", lambda: float(next(seconds)))
    with counting(Interruption(), noun="point") as count:
        assert not any(count(ended, 10) for ended in range(6, 9))
    assert capsys.readouterr().err.splitlines() == ["1.0 s  6 of 10 points", "2.0 s  7 of 10 points  about 6 s to go"]


def test_work_is_shown_on_a_terminal_after_two_seconds(monkeypatch):
    seconds = iter([10.0, 11.0, 12.5, 15.0, 20.0, 21.0, 30.0])
    monkeypatch.setattr("mdm.cli.progress.perf_counter", lambda: next(seconds))
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    with work_shown():
        for share in (0.0, 0.25, 0.5, 1.0):
            report_share("reading tag.pomdp", share)
        for share in (0.0, 0.5, 0.75):
            report_share("drafting the labels", share)
        assert terminal.getvalue()[-1] != "K"
    assert lines_of(terminal) == [
        "2.5 s  reading tag.pomdp  50%  about 2 s to go",
        "5.0 s  reading tag.pomdp  100%  about 0 s to go",
        "10.0 s  drafting the labels  75%  about 3 s to go",
    ]
    assert terminal.getvalue().endswith("\r\x1b[K")


@pytest.mark.parametrize("stream", [io.StringIO(), None])
def test_work_is_not_shown_elsewhere(monkeypatch, stream):
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setattr("mdm.cli.progress.perf_counter", lambda: pytest.fail("nothing is timed"))
    with work_shown():
        report_share("reading tag.pomdp", 0.5)
    assert stream is None or not stream.getvalue()


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(-3.0, "0 s"), (0.4, "0 s"), (99.4, "99 s"), (100, "1 min 40 s"), (3599, "59 min 59 s"), (7260, "2 h 1 min")],
)
def test_the_time_to_go(seconds, text):
    assert to_go(seconds) == f"{text} to go"


@pytest.mark.parametrize(
    ("value", "text"), [(19.37129999, "19.3713"), (-0.0001, "-0.0001"), (float("inf"), "?"), (float("nan"), "?")]
)
def test_a_bound_that_nothing_is_known_of_is_a_question_mark(value, text):
    assert bound(value) == text


def test_without_standard_error_nothing_is_shown(monkeypatch):
    monkeypatch.setattr("sys.stderr", None)
    line = ProgressLine()
    line(Progress(5.0, 1.0, 2.0, 3, 4, 10**6))
    line.end()


def test_where_the_terminal_has_gone_the_work_goes_on():
    class Gone(Terminal):
        def flush(self):
            raise OSError(5, "Input/output error")

    stream = Gone()
    line = ProgressLine(stream)
    line(Progress(5.0, 1.0, 2.0, 3, 4, 10**6))
    told = stream.getvalue()
    line(Progress(6.0, 1.0, 2.0, 3, 4, 10**6))
    line.end()
    assert stream.getvalue() == told  # it is not tried again
