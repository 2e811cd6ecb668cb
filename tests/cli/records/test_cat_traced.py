from __future__ import annotations

import pytest
from records import Writing, decision
from sentences import refused

from mdm.cli.records.cat import traced
from mdm.errors import Error
from mdm.messages import Control
from mdm.recording.reader import Record
from mdm.stimuli import Began, Finished, Said, Stimulus, Ticked


def test_what_trace_does_by_itself_is_left_out_in_silence(tmp_path):
    record = Writing(tmp_path / "run.mcap")
    for stimulus in (
        Began(5, "patrol", "start"),
        Ticked(6, "patrol", 1, 0, 10.0),
        Said(7, "patrol/control", "Control", Control(7, "stop")),
        Finished(8),
    ):
        record.write("stimuli", stimulus, Stimulus)
    others = {}
    found = [*traced(Record(record.close()), None, None, None, others)]
    assert found[0] == {"time": 0.0, "epoch": 5}
    assert found[1:] == [{"time": 2e-9, "control": "stop", "ensemble": "patrol"}]
    assert others == {}


def test_the_last_line_has_the_time_of_the_last_decision(tmp_path):
    record = Writing(tmp_path / "run.mcap")
    record.write("stimuli", Said(2_000_000, "patrol/control", "Control", Control(7, "stop")), Stimulus)
    record.write("decisions", decision(2))
    record.write("decisions", decision(9))
    read = Record(record.close())
    stop = {"time": 0.0, "control": "stop", "ensemble": "patrol"}
    assert [*traced(read, None, None, None, {})] == [stop, {"time": 0.007}]
    assert [*traced(read, None, None, 9_000_000, {})] == [stop]


def test_a_record_without_stimuli_is_told(tmp_path):
    record = Writing(tmp_path / "run.mcap")
    record.write("decisions", decision(1))
    read = Record(record.close())
    with refused(Error):
        next(traced(read, None, None, None, {}))


@pytest.mark.parametrize("message", [{"time": 1, "odd": True}, {"time": 1}])
def test_messages_of_other_shapes_are_counted(tmp_path, message):
    record = Writing(tmp_path / "run.mcap")
    record.write("stimuli", Said(7, "patrol/state", "Odd", message), Stimulus)
    others = {}
    assert [*traced(Record(record.close()), None, None, None, others)] == []
    assert others == {"patrol/state": 1}
